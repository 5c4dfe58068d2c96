"""The elastic model of a part of a shell."""

import numpy as np

from voile import _kernels
from voile.problem.partition import Part


def make_kernel(part: Part, model: str, start: np.ndarray, flat: bool) -> _kernels.Elastic:
    """The model with displacements that count from `start` (local vertices, 3) m; flat: its rest shape has no folds."""
    kernel = _kernels.Elastic(
        model,
        part.corners,
        part.triangle_edges,
        part.signs,
        part.across,
        len(part.edge),
        np.ascontiguousarray(start),
    )
    clamp = part.half_edge_clamp
    if len(clamp):
        half_edge, conormal, at_rest = np.ascontiguousarray(clamp[:, :3].astype(np.int32).T)
        kernel.set_clamps(half_edge, conormal, at_rest, np.ascontiguousarray(clamp[:, 3:]))
    kernel.set_rest(part.rest_points, part.rest_corners, flat)
    kernel.set_fabric(*(np.ascontiguousarray(row) for row in part.fabric[:3]))
    kernel.set_weights(part.weight)
    return kernel
