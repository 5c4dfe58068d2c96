"""A garment of sewn flat panels with fewer vertices: panels meshed anew, seams and draped positions carried over."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import igl
import numpy as np
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "meshes"))
from patterns import unstructured

SHARP = np.radians(35.0)  # corners of a panel's outline that turn by more stay
CLOSED, MOST_CLOSINGS = 1e-15, 200  # m; chains of stitches take some tens


@dataclass
class Sewn:
    """points (n, 3) and uv (n, 2) in m, triangles (m, 3), stitches: ends (k, 3) and weights (k,) of
    x_i = (1 - w) x_j + w x_k. Panels are what triangles connect."""

    points: np.ndarray
    uv: np.ndarray
    triangles: np.ndarray
    ends: np.ndarray
    weights: np.ndarray

    @property
    def partner(self) -> dict[int, tuple[int, int, float]]:
        """j, k and w of each i; of several stitches of a vertex the last."""
        return {int(i): (int(j), int(k), w) for (i, j, k), w in zip(self.ends, self.weights, strict=True)}


def read(path: Path) -> Sewn:
    """An OBJ file with as many vt as v, and stitch records."""
    lines = [line.split() for line in path.read_text().splitlines() if line.strip()]

    def rows(word: str) -> list[list[str]]:
        return [line[1:] for line in lines if line[0] == word]

    faces = [[int(corner.split("/")[0]) - 1 for corner in row] for row in rows("f")]
    stitches = np.array(rows("stitch"), dtype=float)
    ends = stitches[:, :3].astype(int)
    points, uv = (np.array(rows(word), dtype=float) for word in ("v", "vt"))
    return Sewn(points, uv[:, :2], np.array(faces), ends, stitches[:, 3])


def write(path: Path, dress: Sewn) -> None:
    """As `read` reads it."""
    text = [f"v {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in dress.points]
    text += [f"vt {u:.9g} {v:.9g}\n" for u, v in dress.uv]
    text += ["f " + " ".join(f"{c + 1}/{c + 1}" for c in triangle) + "\n" for triangle in dress.triangles]
    both = zip(dress.ends, dress.weights, strict=True)
    text += [f"stitch {i} {j} {k} {w:.9g}\n" for (i, j, k), w in both]
    path.write_text("".join(text))


class Outline:
    """A panel's boundary: fine vertices in order, how far along each is (m), and which of them stay."""

    def __init__(self, dress: Sewn, triangles: np.ndarray, marked: np.ndarray, size: float):
        self.loop = igl.boundary_loop(triangles)
        p = dress.uv[self.loop]
        way = np.roll(p, -1, axis=0) - p
        length = np.linalg.norm(way, axis=1)
        self.along, self.around = np.cumsum(length) - length, length.sum()
        before = np.roll(way, 1, axis=0)
        cross = before[:, 0] * way[:, 1] - before[:, 1] * way[:, 0]
        turn = np.abs(np.arctan2(cross, (before * way).sum(axis=1)))
        stays = np.flatnonzero((turn > SHARP) | marked[self.loop])
        chosen = set(stays if len(stays) else [0])
        corners = sorted(chosen)
        for a, b in zip(corners, [*corners[1:], corners[0] + len(self.loop)], strict=True):
            at = np.append(self.along, self.along + self.around)[a : b + 1]
            pieces = max(1, round((at[-1] - at[0]) / size))
            goals = at[0] + (at[-1] - at[0]) * np.arange(1, pieces) / pieces
            chosen |= {(a + int(np.argmin(np.abs(at - goal)))) % len(self.loop) for goal in goals}
        self.kept = np.array(sorted(chosen))

    def between(self, at: float) -> tuple[int, int, float]:
        """The two fine vertices that stay around a place along the outline, and its share of the way between."""
        at %= self.around
        places = self.along[self.kept]
        k = int(np.searchsorted(places, at, side="right")) - 1
        first, second = self.kept[k], self.kept[(k + 1) % len(self.kept)]
        way = (self.along[second] - self.along[first]) % self.around
        return self.loop[first], self.loop[second], ((at - self.along[first]) % self.around) / way


def coarser(dress: Sewn, size: float) -> Sewn:
    """Panels of edges of about `size` (m). Corners and ends of seams stay, other boundary vertices are some of those
    that there were, and a sewn one sits at the same place of the partner's outline."""
    part = igl.facet_components(dress.triangles)[1]
    panels = [dress.triangles[part == k] for k in range(part.max() + 1)]
    marked = _seam_ends(dress, [igl.boundary_loop(panel) for panel in panels])
    outlines = [Outline(dress, panel, marked, size) for panel in panels]
    points, uv, triangles, number = [], [], [], {}
    count = 0
    for panel, outline in zip(panels, outlines, strict=True):
        rim = outline.loop[outline.kept]
        flat, corners = unstructured([dress.uv[rim]], size)
        nearest = cKDTree(flat).query(dress.uv[rim])[1]
        number |= {int(i): count + int(k) for i, k in zip(rim, nearest, strict=True)}
        points.append(_carried(dress, panel, flat))
        uv.append(flat)
        triangles.append(corners + count)
        count += len(flat)
    stitches = _stitches(dress, outlines, number)
    return Sewn(np.concatenate(points), np.concatenate(uv), np.concatenate(triangles), *stitches)


def closed(dress: Sewn) -> Sewn:
    """The dress with both sides of each seam moved half the way to each other, again until none gapes."""
    points = dress.points.copy()
    for _ in range(MOST_CLOSINGS):
        widest = 0.0
        for i, (j, k, w) in dress.partner.items():
            gap = (1.0 - w) * points[j] + w * points[k] - points[i]
            widest = max(widest, float(np.linalg.norm(gap)))
            points[i] += 0.5 * gap
            points[j] -= 0.5 * (1.0 - w) * gap
            points[k] -= 0.5 * w * gap
        if widest < CLOSED:
            break
    return replace(dress, points=points)


def _seam_ends(dress: Sewn, loops: list[np.ndarray]) -> np.ndarray:
    """(n,) marks vertices where a seam ends: its partner changes, or jumps by more than an edge or two."""
    partner = dress.partner
    marked = np.zeros(len(dress.points), dtype=bool)
    for loop in loops:
        for here, then in zip(loop, np.roll(loop, -1), strict=True):
            a, b = partner.get(here), partner.get(then)
            ends = (a is None) != (b is None)
            if a and b:
                edge = np.linalg.norm(dress.uv[here] - dress.uv[then])
                ends = np.linalg.norm(dress.uv[a[0]] - dress.uv[b[0]]) > 4.0 * edge
            for vertex, at in ((here, a), (then, b)):
                if ends and at:
                    marked[[vertex, at[0] if at[2] < 0.5 else at[1]]] = True
    return marked


def _stitches(dress: Sewn, outlines: list[Outline], number: dict[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Ends and weights of those of the vertices that stay, by their new numbers."""
    place = {int(i): (o, at) for o in outlines for i, at in zip(o.loop, o.along, strict=True)}
    ends, weights = [], []
    for i, (j, k, w) in dress.partner.items():
        if i not in number:
            continue
        outline, first = place[j]
        step = (place[k][1] - first + 0.5 * outline.around) % outline.around - 0.5 * outline.around
        a, b, share = outline.between(first + w * step)
        if i not in (a, b):  # a dart's end is sewn to itself
            ends.append([number[i], number[int(a)], number[int(b)]])
            weights.append(share)
    return np.array(ends), np.array(weights)


def _carried(dress: Sewn, panel: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Draped positions of points (n, 2) of a panel's plane."""
    lifted, target = (np.column_stack([p, np.zeros(len(p))]) for p in (dress.uv, flat))
    _, triangle, nearest = igl.point_mesh_squared_distance(target, lifted, panel)
    corners = panel[triangle]
    share = igl.barycentric_coordinates(nearest, *(lifted[corners[:, c]] for c in range(3)))
    return np.einsum("nc,nci->ni", share, dress.points[corners])
