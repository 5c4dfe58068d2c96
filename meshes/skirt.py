import numpy as np
from patterns import cells, command, even, grid, positive, side, unstructured, weld


def skirt(
    waist: float = 0.70,
    hem: float = 1.60,
    length: float = 0.55,
    top: float = 1.0,
    size: float = 0.02,
    irregular: bool = False,
    diagonals: str = "alternating",
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Flared skirt: a cone about the y axis, waist loop at y = top, normals outward, with its flat pattern.

    waist, hem: circumferences; length: along the slope. Returns points, triangles, texture coordinates and
    their triangles: the texture is the developed cone, a plane sector in metres, cut along the back at x = 0,
    z < 0. Chords of the round skirt are shorter than the pattern's by a share of order (size / waist)^2.
    """
    positive(waist=waist, flare=hem - waist, length=length, size=size)
    radius_waist, radius_hem = waist / (2 * np.pi), hem / (2 * np.pi)
    sine = (radius_hem - radius_waist) / length  # of the cone's half angle
    if sine > 1:
        least = radius_hem - radius_waist
        raise ValueError(
            f"length = {length}, allowed: at least {least:g}, by which the hem's radius is larger"
        )
    short, turn = radius_waist / sine, 2 * np.pi * sine
    if irregular and turn > np.pi and 2 * short * np.sin(turn / 2) < size:
        raise ValueError(
            "the pattern is nearly a full disc, its cut narrower than size: take a structured mesh"
        )
    if irregular:
        pattern, triangles = _sector(short, short + length, turn, size)
    else:
        uv, triangles = grid(even(cells((waist + hem) / 2, size)), cells(length, size), diagonals)
        slant, angle = short + length * (1 - uv[:, 1]), turn * (uv[:, 0] - 0.5)
        pattern = slant[:, None] * np.column_stack([np.sin(angle), -np.cos(angle)])
    slant, angle = np.hypot(*pattern.T), np.arctan2(pattern[:, 0], -pattern[:, 1])
    around, radius = angle / sine, sine * slant
    height = top - np.sqrt(1 - sine**2) * (slant - short)
    points, welded = weld(
        np.column_stack([radius * np.sin(around), height, radius * np.cos(around)]), triangles, 1e-6 * size
    )
    return points, welded, pattern, triangles


def _sector(short: float, long: float, turn: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Irregular mesh of the plane sector between two radii, symmetric about the negative y axis."""

    def at(radius: float, angle: float) -> np.ndarray:
        return radius * np.array([np.sin(angle), -np.cos(angle)])

    def arc(radius: float, start: float, end: float) -> np.ndarray:
        return np.array([at(radius, a) for a in side([start, 0], [end, 0], cells(radius * turn, size))[:, 0]])

    count = cells(long - short, size)
    right = side(at(long, turn / 2), at(short, turn / 2), count)
    left = side(at(short, -turn / 2), at(long, -turn / 2), count)
    outline = np.concatenate([arc(long, -turn / 2, turn / 2), right, arc(short, turn / 2, -turn / 2), left])
    return unstructured([outline], size)


if __name__ == "__main__":
    command(skirt)
