"""Wavefront OBJ with groups, texture coordinates and `stitch i j k w` records: x_i = (1 - w) x_j + w x_k.

Faces count vertices from 1, as OBJ does; stitches count them from 0, as in the panel files that have them
(Codimensional IPC's garments: only so do the stitched vertices lie on borders and meet when draped).
"""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from voile.arrays import Array, Ints, Reals
from voile.errors import InputError
from voile.files import replace
from voile.mesh.raw import RawMesh, fan
from voile.mesh.stitches import Stitches

_Records = dict[bytes, tuple[list[int], list[int], list[bytes]]]
METRES = "unit: metre"  # as a comment in the first line: the scale of a scene does not apply
_ABSENT = 2**62  # stands for the missing texture index of `v//n`: no index of a file can be that large
_CORNER = re.compile(rb"[+-]?\d+(/[+-]?\d+)?$|[+-]?\d+/([+-]?\d+)?/[+-]?\d+$")
_NUMBERS = {b"v": (2, "v x y z"), b"vt": (2, "vt u v"), b"stitch": (4, "stitch i j k w")}  # least, form


def read_obj(path: Path) -> RawMesh:
    """Read an OBJ file: `v`, `vt`, `f` (every index form; polygons become fans), `g`, else `o`, and `stitch`.

    Other keywords are passed over, as OBJ readers do. Raises InputError naming the line.
    """
    records = _scan(path)
    points = _numbers(path, records, b"v")
    texture = _numbers(path, records, b"vt")[:, :2]
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    sewn, weight, stitch_lines = _stitches(path, records, len(points))
    corners, counts, lines = _corners(path, records)
    first = np.cumsum(counts) - counts
    at = np.repeat(lines, counts)
    vertices = _resolve(path, corners[:, 0], "vertex", "v", at, records[b"v"][0])
    triangles, face = fan(counts)
    texture_triangles = None
    notes = []
    absent = corners[:, 1] == _ABSENT
    if not absent.any():
        texture_triangles = _resolve(path, corners[:, 1], "texture", "vt", at, records[b"vt"][0])[triangles]
    elif not absent.all():
        faces = np.count_nonzero(absent[first])
        notes.append(f"texture coordinates ignored: {faces} of {len(counts)} faces have none")
    group, names = _groups(records, lines)
    used, group = np.unique(group[face], return_inverse=True) if len(face) else (np.zeros(0, int), group)
    return RawMesh(
        source=str(path),
        points=points,
        triangles=vertices[triangles],
        group=group.astype(np.int32),
        group_names=tuple(names[i] for i in used),
        texture=None if texture_triangles is None else texture,
        texture_triangles=texture_triangles,
        stitch_vertices=sewn if len(sewn) else None,
        stitch_weight=weight if len(sewn) else None,
        point_lines=np.array(records[b"v"][0], dtype=np.int64),
        triangle_lines=lines[face],
        stitch_lines=stitch_lines if len(sewn) else None,
        notes=tuple(notes),
        in_metres=_first_line(path) == f"# {METRES}",
        polygons=int(np.count_nonzero(counts > 3)),
    )


def _first_line(path: Path) -> str:
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.readline().strip()


def _scan(path: Path) -> _Records:
    """Line numbers, tokens per line (the keyword apart) and all tokens, for each keyword used here."""
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    for i in range(len(lines) - 2, -1, -1):
        if lines[i].endswith((b"\\", b"\\\r")):  # continuation; an empty line keeps the numbering
            lines[i], lines[i + 1] = lines[i].rstrip()[:-1] + b" " + lines[i + 1], b""
    records: _Records = {key: ([], [], []) for key in (b"v", b"vt", b"f", b"g", b"o", b"stitch")}
    for number, line in enumerate(lines, 1):
        if b"#" in line:
            line = re.split(rb"(?:^|\s)#", line, maxsplit=1)[0]
        keyword, *words = line.split() or (b"",)
        if keyword in records:
            numbers, counts, tokens = records[keyword]
            numbers.append(number)
            counts.append(len(words))
            tokens += words
    return records


def _lines(records: _Records, key: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Line number and tokens of each record of a keyword."""
    numbers, counts, tokens = records[key]
    stop = 0
    for number, count in zip(numbers, counts, strict=True):
        yield number, tokens[stop : stop + count]
        stop += count


def _numbers(path: Path, records: _Records, key: bytes) -> Reals:
    """The values of all records of one keyword: (count, 2 to 4) float64."""
    _, counts, tokens = records[key]
    least, form = _NUMBERS[key]
    width = 3 if key == b"v" and max(counts, default=3) > 2 else least  # two coordinates only if all have two
    if counts and (min(counts), max(counts)) != (
        width,
        width,
    ):  # a weight or colours follow, or some are short
        tokens = [token for _, row in _lines(records, key) for token in row[:width]]
    values = _parse(tokens, float)
    if values is not None and min(counts, default=width) >= width:
        return values.reshape(-1, width)
    for number, row in _lines(records, key):
        if len(row) < width or _parse(row[:width], float) is None:
            found = b" ".join([key, *row]).decode(errors="replace")
            raise InputError(f"{path}, line {number}: '{found}', allowed: '{form}' with numbers")
    raise AssertionError("every record parses by itself, but not together")


def _parse(tokens: list[bytes], dtype: type) -> Array | None:
    """Tokens as numbers, None if any is not one."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            values: Array = np.fromstring(b" ".join(tokens), dtype=dtype, sep=" ")
        except (DeprecationWarning, ValueError):
            return None
    return values if len(values) == len(tokens) else None


def _corners(path: Path, records: _Records) -> tuple[Ints, Ints, Ints]:
    """Vertex and texture index of every face corner (c, 2) as in the file; corners and line of each face."""
    numbers, per_line, tokens = records[b"f"]
    lines, counts = np.array(numbers, dtype=np.int64), np.array(per_line, dtype=np.int64)
    if (counts < 3).any():
        line = lines[counts < 3][0]
        raise InputError(
            f"{path}, line {line}: a face with {counts[counts < 3][0]} corners, at least 3 are needed"
        )
    slashes = np.fromiter((t.count(b"/") for t in tokens), dtype=np.int64, count=len(tokens))
    corners = np.full((len(tokens), 2), _ABSENT, dtype=np.int64)
    for form in np.unique(slashes):
        where = np.flatnonzero(slashes == form)
        text = b" ".join(tokens if len(where) == len(tokens) else [tokens[i] for i in where])
        pieces = text.replace(b"//", b"/%d/" % _ABSENT).replace(b"/", b" ").split()
        indices = _parse(pieces, np.int64) if form <= 2 else None
        if indices is None or len(indices) != len(where) * (form + 1):
            break
        corners[where, : min(2, form + 1)] = indices.reshape(len(where), form + 1)[:, :2]
    else:
        return corners, counts, lines
    for number, row in _lines(records, b"f"):
        for token in row:
            if not _CORNER.match(token):
                raise InputError(
                    f"{path}, line {number}: face corner '{token.decode(errors='replace')}', "
                    "allowed: v, v/vt, v//vn or v/vt/vn with integer indices"
                )
    raise InputError(f"{path}: face indices too large")


def _resolve(path: Path, index: Ints, what: str, key: str, at: Ints, defined: list[int]) -> Ints:
    """Indices from 0 out of OBJ's, which count from 1 or, if negative, back from the last record so far."""
    resolved = index - 1
    negative = np.flatnonzero(index < 0)
    if len(negative):
        resolved[negative] = index[negative] + np.searchsorted(np.array(defined), at[negative])
    bad = np.flatnonzero((resolved < 0) | (resolved >= len(defined)) | (index == 0))
    if len(bad):
        raise InputError(
            f"{path}, line {at[bad[0]]}: {what} index {index[bad[0]]} is out of range, "
            f"the file has {len(defined)} '{key}' records, counted from 1"
        )
    return resolved


def _stitches(path: Path, records: _Records, count: int) -> tuple[Ints, Reals, Ints]:
    """Slave, first, second (s, 3) from 0, weight (s,) and line (s,) of the stitch records."""
    values = _numbers(path, records, b"stitch")
    lines = np.array(records[b"stitch"][0], dtype=np.int64)
    indices = values[:, :3]
    bad = np.flatnonzero(~((indices >= 0) & (indices < count) & (indices == np.floor(indices))).all(axis=1))
    if len(bad):
        found = ", ".join(f"{value:g}" for value in indices[bad[0]])
        raise InputError(
            f"{path}, line {lines[bad[0]]}: stitch of vertices {found}, allowed: integers "
            f"from 0 to {count - 1} (stitches count vertices from 0, unlike faces)"
        )
    return indices.astype(np.int64), values[:, 3], lines


def _groups(records: _Records, lines: Ints) -> tuple[Ints, list[str]]:
    """Group of each face, an index into the list of names in order of appearance."""
    key = b"g" if records[b"g"][0] else b"o"
    names = ["default"]
    of_record = [0]
    for _, row in _lines(records, key):
        name = b" ".join(row).decode(errors="replace") or "default"
        if name not in names:
            names.append(name)
        of_record.append(names.index(name))
    return np.array(of_record)[np.searchsorted(np.array(records[key][0], dtype=np.int64), lines)], names


def write_obj(
    path: str | Path,
    points: Reals,
    triangles: Ints,
    texture: Reals | None = None,
    texture_triangles: Ints | None = None,
    groups: tuple[Ints, tuple[str, ...]] | None = None,
    stitches: Stitches | None = None,
    comment: str = "",
) -> None:
    """Write an OBJ that reads back to the same numbers, in place only once complete.

    points (n, 3) in metres; triangles (m, 3); texture (nt, 2) with texture_triangles (m, 3), by default the
    triangles; groups: (m,) index and the names; stitches in the numbering of `points`.
    Raises InputError if the file cannot be written.
    """
    texture_triangles = triangles if texture_triangles is None else texture_triangles
    parts = [f"# {line}" for line in comment.splitlines()]
    parts += [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(points, dtype=float).tolist()]
    one = np.asarray(triangles, dtype=np.int64) + 1
    if texture is None:
        faces = [f"f {i} {j} {k}" for i, j, k in one.tolist()]
    else:
        parts += [f"vt {u!r} {v!r}" for u, v in np.asarray(texture, dtype=float).tolist()]
        both = np.column_stack([one, np.asarray(texture_triangles, dtype=np.int64) + 1]).tolist()
        faces = [f"f {i}/{a} {j}/{b} {k}/{c}" for i, j, k, a, b, c in both]
    if groups is not None:
        index, names = np.asarray(groups[0]), groups[1]
        change = np.flatnonzero(np.diff(index, prepend=-1))
        for t in change[::-1].tolist():
            faces[t] = f"g {names[index[t]]}\n{faces[t]}"
    parts += faces
    if stitches is not None:
        rows = zip(
            *(a.tolist() for a in (stitches.slave, stitches.first, stitches.second, stitches.weight)),
            strict=True,
        )
        parts += [f"stitch {i} {j} {k} {w!r}" for i, j, k, w in rows]
    replace(path, ("\n".join(parts) + "\n").encode())
