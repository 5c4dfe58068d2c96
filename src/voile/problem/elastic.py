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


def has_directors(model: str) -> bool:
    """Whether the model has director angles, one per edge."""
    corners = np.arange(3, dtype=np.int32)[None]
    none = np.full((1, 3), -1, dtype=np.int32)
    return _kernels.Elastic(model, corners, corners, np.ones_like(corners), none, 3, np.eye(3)).directors
