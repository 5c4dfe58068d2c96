"""Rest shapes of fabrics that have shrunk or grown: prestrain."""

import numpy as np

from voile.arrays import Reals
from voile.errors import InputError
from voile.mesh.surface import Rest

PLANE = 1e-9  # of the size: points nearer to a plane are in it


def shrunk(rest: Rest, factor: Reals, where: str) -> Rest:
    """The rest shape with each triangle's edges times its factor (m,). Where factors differ each part gets vertices of
    its own, so that the rest shape must have no folds to lose: InputError, naming the keys, of one that has."""
    if (factor == factor[0]).all():
        centre = rest.points.mean(axis=0)
        return Rest(centre + factor[0] * (rest.points - centre), rest.triangles, rest.flat)
    from_centre = rest.points - rest.points.mean(axis=0)
    extent = np.linalg.svd(from_centre, compute_uv=False)
    if not rest.flat and extent[2] > PLANE * extent[0]:
        raise InputError(
            f"{where}: differs from part to part; allowed then: a rest shape in one plane, or flat panels"
        )
    values, kind = np.unique(factor, return_inverse=True)
    corner = rest.triangles.astype(np.int64) * len(values) + kind[:, None]
    used, triangles = np.unique(corner, return_inverse=True)
    points = rest.points[used // len(values)] * values[used % len(values)][:, None]
    return Rest(points, triangles.reshape(-1, 3).astype(np.int32), True)
