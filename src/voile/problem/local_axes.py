"""Directions along which supports hold vertices, and the local axes that part them from the free ones."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from voile.arrays import Flags, Ints, Reals
from voile.errors import InputError

NONE = 1e-12  # of 1: square of the sine under which two directions are one
SAME = 1e-9  # of the largest motion: supports that move a vertex alike


@dataclass(frozen=True)
class Hold:
    """What a [[fix]] holds: vertices (k,) along `directions` (d, 3), orthonormal rows, to a displacement (3,) m along
    them; `clamp`: the edges between them, too."""

    name: str
    vertices: Ints
    directions: Reals
    clamp: bool
    displacement: Reals

    @property
    def projection(self) -> Reals:
        """(3, 3) on the directions."""
        return self.directions.T @ self.directions


def frame_axes(vectors: Sequence[Sequence[float]]) -> Reals:
    """(3, 3) rows x, y, z of a right-handed frame: x along the first vector, y in the plane of x and the second; any at
    right angles to x without a second."""
    x = np.array(vectors[0], dtype=float) / np.linalg.norm(vectors[0])
    second = np.eye(3)[np.argmin(np.abs(x))] if len(vectors) == 1 else np.array(vectors[1], dtype=float)
    z = np.cross(x, second)
    z /= np.linalg.norm(z)
    return np.array([x, np.cross(z, x), z])


def held_along(axes: Reals | None, fixed: Flags) -> Reals:
    """(n, 3, 3) projections on the held ones, `fixed` (n, 3), of local axes (n, 3, 3), rows; of the global ones without
    axes."""
    if axes is None:
        return fixed[:, :, None] * np.eye(3)
    found: Reals = np.einsum("nai,na,naj->nij", axes, fixed.astype(float), axes)
    return found


def principal(forms: Reals) -> tuple[Reals, Flags]:
    """Of sums of projections (n, 3, 3): local axes (n, 3, 3), rows, and which of them are held (n, 3). The global axes
    where the form is diagonal."""
    axes, values = np.tile(np.eye(3), (len(forms), 1, 1)), np.einsum("nii->ni", forms).copy()
    turned = (np.abs(forms) * (1.0 - np.eye(3))).max(axis=(1, 2), initial=0.0) > NONE
    values[turned], vectors = np.linalg.eigh(forms[turned])
    axes[turned] = vectors.transpose(0, 2, 1)
    return axes, values > NONE


def combined(holds: Sequence[Hold], n: int, where: str) -> tuple[Reals | None, Flags, Reals]:
    """Of all holds together: local axes (n, 3, 3), None where they are the global ones, which of them are held (n, 3),
    and displacements (n, 3) m. Raises InputError, naming the key `where`, if two move a vertex differently."""
    forms, goal = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for hold in holds:
        forms[hold.vertices] += hold.projection
        goal[hold.vertices] += hold.displacement
    axes, fixed = principal(forms)
    motion = np.einsum("nij,nj->ni", inverse(forms), goal)  # the one that fits best
    most = np.abs(goal).max(initial=0.0)
    for k, hold in enumerate(holds):
        off = np.abs(motion[hold.vertices] @ hold.projection - hold.displacement)
        if (off > SAME * most).any():
            vertex, axis = np.argwhere(off > SAME * most)[0]
            raise InputError(
                f"{where}.{k}.select: vertex {hold.vertices[vertex]} is moved differently along {'xyz'[axis]} by "
                "another fix"
            )
    return (None if (axes == np.eye(3)).all() else axes), fixed, motion


def inverse(forms: Reals) -> Reals:
    """(n, 3, 3) pseudo-inverses of sums of projections (n, 3, 3)."""
    axes, held = principal(forms)
    values = np.einsum("nai,nij,naj->na", axes, forms, axes)
    found: Reals = np.einsum("nai,na,naj->nij", axes, held / np.where(held, values, 1.0), axes)
    return found
