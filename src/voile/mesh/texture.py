"""Directions of texture coordinates on a rest shape."""

import numpy as np

from voile.arrays import Reals
from voile.errors import InputError
from voile.mesh.surface import Rest, Surface

FLAT = 1e-12  # of the square of a triangle's edge in the texture: no area


def texture_direction(rest: Rest, surface: Surface, coordinate: str, key: str) -> Reals:
    """(m, 3) unit vectors in the rest triangles' planes along which a texture coordinate, u or v, grows and the other
    stays. Raises InputError, naming the key, without texture coordinates or where a triangle has no area in them."""
    if surface.texture is None or surface.texture_triangles is None:
        raise InputError(
            f'{key} = "{coordinate}": {surface.source} has no texture coordinates; allowed: a direction [x, y, z]'
        )
    flat = surface.texture[surface.texture_triangles]
    du = flat[:, 1:] - flat[:, :1]
    edges = rest.points[rest.triangles[:, 1:]] - rest.points[rest.triangles[:, :1]]
    area = np.abs(np.linalg.det(du))
    none = area <= FLAT * np.square(du).sum(axis=(1, 2))
    if none.any():
        raise InputError(
            f'{key} = "{coordinate}": triangle {np.argmax(none)} of {surface.source} has no area in texture '
            "coordinates; allowed: a direction [x, y, z]"
        )
    along = np.einsum("ta,tai->ti", np.linalg.inv(du)[:, "uv".index(coordinate)], edges)
    found: Reals = along / np.linalg.norm(along, axis=1, keepdims=True)
    return found
