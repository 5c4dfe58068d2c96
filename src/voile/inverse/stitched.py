"""Seams of panels that come apart already, from their stitch records."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from voile.arrays import Ints, Reals
from voile.inverse.panels import Panels, Seam
from voile.mesh import Stitches

EASE = 3.0  # a seam goes on while its sides advance by lengths that differ by no more than this factor


@dataclass(frozen=True)
class _Outline:
    """A panel's outline: panel vertices (b,), the arc length (b,) up to each and that of the whole, m."""

    vertices: Ints
    arc: Reals
    length: float


@dataclass(frozen=True)
class _Match:
    """Vertex `index` of the outline `panel` is sewn to the outline `other`, `arc` (m) from its start."""

    panel: int
    index: int
    other: int
    arc: float


def add_stitches(panels: Panels, stitches: Stitches) -> Panels:
    """The panels with stitches between surface vertices, and with the seams that these make.

    A seam is a run of stitches along two outlines in opposite directions, its ends rounded to the nearest vertex;
    single stitches, and those inside panels, sew but are no seam.
    """
    first = np.zeros(len(panels.points), dtype=np.int64)
    first[panels.vertex[::-1]] = np.arange(len(panels.vertex))[::-1]  # of several copies the first
    own = Stitches(first[stitches.slave], first[stitches.first], first[stitches.second], stitches.weight)
    seams = _stitched_seams(panels.points[panels.vertex], panels.outlines, own)
    return replace(panels, seams=panels.seams + seams, stitches=own)


def _stitched_seams(points: Reals, outlines: Sequence[Ints], stitches: Stitches) -> tuple[Seam, ...]:
    rings = [_ring(points, outline) for outline in outlines]
    seams: list[Seam] = []
    for chain in _chains(_matches(rings, stitches), rings):
        seam = _seam(chain, rings)
        if not any(_same(seam, known) for known in seams):
            seams.append(seam)
    return tuple(seams)


def _ring(points: Reals, outline: Ints) -> _Outline:
    lengths = np.linalg.norm(points[np.roll(outline, -1)] - points[outline], axis=1)
    return _Outline(outline, np.cumsum(lengths) - lengths, float(lengths.sum()))


def _matches(rings: list[_Outline], stitches: Stitches) -> list[_Match]:
    """The stitches that tie a vertex of an outline to a point of one."""
    place = {int(v): (k, i) for k, ring in enumerate(rings) for i, v in enumerate(ring.vertices)}
    found = []
    for slave, first, second, weight in zip(
        *(a.tolist() for a in (stitches.slave, stitches.first, stitches.second, stitches.weight)),
        strict=True,
    ):
        ends = [(first, 1 - weight), (second, weight)]
        ends = [(place[v], share) for v, share in ends if share > 0 and v in place]
        if slave not in place or abs(sum(share for _, share in ends) - 1) > 1e-12:
            continue
        other, i = ends[0][0]
        arc = rings[other].arc[i]
        if len(ends) == 2:
            (same, j), part = ends[1]
            if same != other:
                continue
            way = (rings[other].arc[j] - arc + 0.5 * rings[other].length) % rings[other].length
            arc = (arc + part * (way - 0.5 * rings[other].length)) % rings[other].length
        found.append(_Match(*place[slave], other, float(arc)))
    return found


def _chains(matches: list[_Match], rings: list[_Outline]) -> Iterator[list[_Match]]:
    """Matches of consecutive vertices with points that go back along the other outline."""
    at = defaultdict(list)
    for k, match in enumerate(matches):
        at[match.panel, match.index, match.other].append(k)
    following: dict[int, int] = {}
    taken: set[int] = set()
    for k, match in enumerate(matches):
        ring, other = rings[match.panel], rings[match.other]
        after = (match.index + 1) % len(ring.vertices)
        step = (ring.arc[after] - ring.arc[match.index]) % ring.length
        for n in at[match.panel, after, match.other]:
            back = (match.arc - matches[n].arc) % other.length
            if step / EASE <= back <= step * EASE and n not in taken:
                following[k] = n
                taken.add(n)
                break
    left = taken.union(following)
    for k in [
        *(k for k in following if k not in taken),
        *following,
    ]:  # closed runs have no begin: they start anywhere
        chain = []
        while k in left:
            left.remove(k)
            chain.append(matches[k])
            k = following.get(k, -1)
        if len(chain) > 1:
            yield chain


def _seam(chain: list[_Match], rings: list[_Outline]) -> Seam:
    one, two = rings[chain[0].panel], rings[chain[0].other]
    first = one.vertices[[match.index for match in chain]]
    along = (one.arc[[match.index for match in chain]] - one.arc[chain[0].index]) % one.length
    back = (chain[0].arc - np.array([match.arc for match in chain])) % two.length
    ends = [int(abs(_turn(two.arc - match.arc, two.length)).argmin()) for match in (chain[0], chain[-1])]
    n = len(two.vertices)
    run = (ends[0] - np.arange((ends[0] - ends[1]) % n + 1)) % n
    at = np.interp(_turn(chain[0].arc - two.arc[run] - back[-1] / 2, two.length) + back[-1] / 2, back, along)
    at[[0, -1]] = 0.0, along[-1]
    sides = (first, two.vertices[run])
    return Seam((chain[0].panel, chain[0].other), sides, (along / along[-1], at / along[-1]))


def _turn(arc: Reals, length: float) -> Reals:
    """Differences of arc lengths on a closed line, from minus to plus half its length."""
    return (arc + 0.5 * length) % length - 0.5 * length


def _same(seam: Seam, known: Seam) -> bool:
    """Whether two seams are one, recorded from either side."""
    if seam.panels != known.panels[::-1]:
        return False
    shares = [np.isin(seam.sides[k], known.sides[1 - k]).mean() for k in (0, 1)]
    return bool(min(shares) > 0.5)
