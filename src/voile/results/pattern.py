"""`pattern.json` of a result: the sewing pattern (voile.mesh.Pattern) as plain JSON, lengths in metres."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals
from voile.errors import InputError, printable
from voile.files import replace
from voile.mesh import Notches, Pattern, Piece, SewnSeam

FILE = "pattern.json"
VERSION = 2
FARTHEST, SHORTEST = 1e4, 1e-9  # m, of a pattern's coordinates and lengths: no cloth is larger, or smaller
FITS = 0.01  # of a seam's length: by how much the points along it may be off


def write_pattern(folder: str | Path, pattern: Pattern) -> None:
    """Write a pattern to a result's folder. Raises InputError if that cannot be done."""
    text = json.dumps({"version": VERSION, **asdict(pattern)}, default=np.ndarray.tolist)
    replace(Path(folder) / FILE, text.encode("utf-8"))


def read_pattern(result: str | os.PathLike[str]) -> Pattern:
    """The pattern of a result, given its folder or a file in it. InputError where it has none or it is damaged."""
    folder = Path(result) if Path(result).is_dir() else Path(result).parent
    path = folder / FILE
    if not path.is_file():
        raise InputError(
            f"{result}: no {FILE} with a sewing pattern; inverse runs write it where their rest shape can be laid flat"
        )
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        version = data["version"]
        if version not in (1, VERSION):
            raise InputError(f"{path}: version {version!r}, allowed: 1 to {VERSION}")
        return _pattern(_completed(data) if version == 1 else data)
    except _Wrong as wrong:
        raise InputError(f"{path}: damaged pattern file: {wrong}") from None
    except InputError:
        raise
    except (KeyError, IndexError) as error:
        raise InputError(f"{path}: damaged pattern file: {error} is missing") from None
    except (OSError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        why = str(error).splitlines()
        raise InputError(
            f"{path}: damaged pattern file: {type(error).__name__}: {why[0] if why else ''}"
        ) from None


class _Wrong(Exception):
    """What a pattern may not hold."""


def _completed(data: dict[str, Any]) -> dict[str, Any]:
    """A file of version 1, of which the first ones had one allowance for all seams and no wishes."""
    allowance = data["allowance"]
    for seam in data["seams"]:
        seam.setdefault("allowance", allowance)
        seam.setdefault("ease", 0.0)
    for piece in data["pieces"]:
        notches = piece["notches"]
        notches.setdefault("allowance", [allowance] * len(notches["points"]))
    return {"mirrors": [], "symmetrised": 0.0, "fabric": None, **data}


def _pattern(data: dict[str, Any]) -> Pattern:
    pieces = tuple(_piece(f"piece {k}", piece) for k, piece in enumerate(data["pieces"]))
    if not pieces:
        raise _Wrong("no pieces")
    mirrors, fabric = _indices("mirrors", data["mirrors"], len(pieces)), data["fabric"]
    if len(mirrors) not in (0, len(pieces)):
        raise _Wrong(f"mirrors has {len(mirrors)} entries; {len(pieces)} or none expected")
    width, length = _numbers("fabric", [1.0, 1.0] if fabric is None else fabric, (2,), SHORTEST).tolist()
    return Pattern(
        pieces,
        tuple(_seam(f"seam {k}", seam, pieces) for k, seam in enumerate(data["seams"])),
        _number("allowance", data["allowance"], 0.0),
        _number("tolerance", data["tolerance"], 0.0),
        tuple(mirrors.tolist()),
        _number("symmetrised", data["symmetrised"], 0.0),
        None if fabric is None else (width, length),
    )


def _piece(name: str, data: dict[str, Any]) -> Piece:
    points = _numbers(f"{name}: points", data["points"], (-1, 2))
    v, n = len(points), data["notches"]
    if v < 3 or np.ptp(points, axis=0).min() < SHORTEST:
        raise _Wrong(f"{name}: points span no area")
    at = _numbers(f"{name}: notches", n["points"], (-1, 2))
    notches = Notches(
        at,
        _numbers(f"{name}: notches", n["inward"], (len(at), 2)),
        _numbers(f"{name}: notches", n["allowance"], (len(at),), 0.0),
        tuple(_text(f"{name}: notches", label) for label in n["labels"]),
    )
    if len(notches.labels) != len(at):
        raise _Wrong(f"{name}: notches has {len(notches.labels)} labels; {len(at)} expected")
    cut = tuple(_numbers(f"{name}: cut", ring, (-1, 2)) for ring in data["cut"])
    outline = _indices(f"{name}: outline", data["outline"], v)
    if not cut or min(map(len, (outline, *cut))) < 3:
        raise _Wrong(f"{name}: a line around a piece has fewer than 3 points")
    triangles = _indices(f"{name}: triangles", data["triangles"], v, 3)
    if not len(triangles):
        raise _Wrong(f"{name}: no triangles")
    return Piece(
        _text(f"{name}: name", data["name"]),
        points,
        triangles,
        _numbers(f"{name}: stretches", data["stretches"], (len(triangles), 2), 0.0),
        outline,
        cut,
        _indices(f"{name}: turns", data["turns"], v),
        _numbers(f"{name}: grain", data["grain"], (2, 2)),
        notches,
    )


def _seam(name: str, data: dict[str, Any], pieces: tuple[Piece, ...]) -> SewnSeam:
    first, second = _indices(f"{name}: pieces", data["pieces"], len(pieces), expected=2).tolist()
    sides = [
        _indices(f"{name}: sides", side, len(pieces[k].points))
        for k, side in zip((first, second), data["sides"], strict=True)
    ]
    lengths = _numbers(f"{name}: lengths", data["lengths"], (2,), SHORTEST)
    for k, side, length in zip((first, second), sides, lengths, strict=True):
        parts = np.linalg.norm(np.diff(pieces[k].points[side], axis=0), axis=1)
        if not (len(parts) and parts.min() > 0.0 and abs(parts.sum() - length) <= FITS * length):
            raise _Wrong(f"{name}: lengths are not those of its sides")
    return SewnSeam(
        _text(f"{name}: label", data["label"]),
        (first, second),
        (sides[0], sides[1]),
        (float(lengths[0]), float(lengths[1])),
        _number(f"{name}: allowance", data["allowance"], 0.0),
        _number(f"{name}: ease", data["ease"]),
    )


def _numbers(name: str, rows: Any, shape: tuple[int, ...], least: float = -FARTHEST) -> Reals:
    """Numbers of a shape, where -1 stands for any number of rows, none below `least` or beyond what cloth can be."""
    values = np.array(rows)
    if not values.size:
        values = values.reshape(0, *shape[1:]).astype(float)
    fits = values.ndim == len(shape) and all(e in (-1, n) for e, n in zip(shape, values.shape, strict=True))
    if not fits or values.dtype.kind not in "iuf":
        raise _Wrong(f"{name} has {values.dtype} {values.shape}; numbers {shape} expected")
    if not ((values >= least) & (values <= FARTHEST)).all():
        raise _Wrong(f"{name} has numbers outside {least:g} to {FARTHEST:g}")
    return values.astype(float)


def _number(name: str, value: Any, least: float = -FARTHEST) -> float:
    return float(_numbers(name, value, (), least))


def _indices(name: str, rows: Any, count: int, columns: int = 0, expected: int = -1) -> Ints:
    """Integers from 0 to count - 1, in so many columns (0: one for each row)."""
    values = np.array(rows)
    if not values.size:
        values = values.reshape((0, columns) if columns else 0).astype(int)
    if (
        values.dtype.kind not in "iu"
        or values.shape[1:] != ((columns,) if columns else ())
        or not values.ndim
    ):
        raise _Wrong(f"{name} has {values.dtype} {values.shape}; indices expected")
    if values.size and not 0 <= values.min() <= values.max() < count:
        raise _Wrong(f"{name} has indices outside 0 to {count - 1}")
    if expected not in (-1, len(values)):
        raise _Wrong(f"{name} has {len(values)} entries; {expected} expected")
    return values.astype(int)


def _text(name: str, value: Any) -> str:
    if not (isinstance(value, str) and value.strip()):
        raise _Wrong(f"{name}: a text expected")
    return printable(value)
