"""Whether straight ways enter a body: conservative advancement (Mirtich 1996) by distances and by tangent planes.

From a place outside, no point nearer than the gap is in the body. A convex body is behind the plane of its nearest
point as well, so a way is free up to that plane, however near it runs: cloth that hovers or slides takes few places.
Any other body is taken to be behind that plane as far as its finest part reaches.
"""

from collections.abc import Callable

import numpy as np

from voile.arrays import Ints, Reals

MOST = 2000  # places on a way; one that is not decided by then is taken to enter (measured: under 60)

Gap = Callable[[Reals, Ints], tuple[Reals, Reals]]


def entries(begin: Reals, end: Reals, gap: Gap, finest: float, touch: float) -> Reals:
    """(n, 3) unit normals of a body where ways from `begin` to `end` (n, 3) m enter it; zero for those that do not.

    gap(points, rows): (k,) m to the body and its unit normal (k, 3) at points on the ways `rows`. finest (m): the
    body's thinnest part, inf where it is convex; touch (m): a gap that is none.
    """
    way = end - begin
    length = np.linalg.norm(way, axis=1)
    along = way / np.maximum(length, 1e-300)[:, None]
    done, entry = np.zeros(len(begin)), np.zeros_like(begin)
    going = np.arange(len(begin))
    for _ in range(MOST):
        if not len(going):
            return entry
        here, normal = gap(begin[going] + done[going, None] * along[going], going)
        inside = here <= touch
        entry[going[inside]] = normal[inside]
        going, here, normal = going[~inside], here[~inside], normal[~inside]
        closing = -np.einsum("pi,pi->p", normal, along[going])
        plane = np.divide(here, closing, out=np.full_like(here, np.inf), where=closing > 0.0)
        done[going] += np.maximum(here, np.minimum(plane, finest))
        going = going[done[going] < length[going]]
    entry[going] = -along[going]
    return entry
