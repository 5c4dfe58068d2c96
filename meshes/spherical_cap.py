import numpy as np
from patterns import command, positive, spherical


def spherical_cap(
    radius: float = 1.0,
    opening: float = 30.0,
    size: float = 0.05,
    irregular: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Cap of a sphere about the z axis, outward, lowered so that its rim lies in z = 0.

    opening: degrees from the pole to the rim. The structured mesh has rings of 6, 12, 18, ... vertices.
    """
    positive(radius=radius, opening=opening, size=size)
    if opening >= 180:
        raise ValueError(f"opening = {opening}, allowed: below 180 degrees")
    points, triangles = spherical(radius, 0.0, opening, 360.0, size, irregular, "alternating")
    return points - [0.0, 0.0, radius * np.cos(np.radians(opening))], triangles


if __name__ == "__main__":
    command(spherical_cap)
