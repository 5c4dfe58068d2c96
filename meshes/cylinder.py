import numpy as np
from patterns import cells, command, even, grid, polygon, positive, unstructured, weld


def cylinder(
    radius: float = 4.953,
    length: float = 10.35,
    sector: float = 360.0,
    size: float = 0.5,
    irregular: bool = False,
    diagonals: str = "alternating",
) -> tuple[np.ndarray, np.ndarray]:
    """Open cylinder about the z axis, 0 <= z <= length, or a sector of it from the x axis on; outward.

    sector: degrees, 360 is closed. Irregular meshes are made in the developed rectangle. The default sizes
    are those of the pull-out of an open cylinder in Sze, Liu & Lo (2004).
    """
    positive(radius=radius, length=length, sector=sector, size=size)
    if sector > 360:
        raise ValueError(f"sector = {sector}, allowed: up to 360 degrees")
    arc, closed = radius * np.radians(sector), sector == 360
    if irregular:
        flat, triangles = unstructured([polygon([(0, 0), (arc, 0), (arc, length), (0, length)], size)], size)
    else:
        around = cells(arc, size)
        uv, triangles = grid(even(around) if closed else around, cells(length, size), diagonals)
        flat = uv * [arc, length]
    angle = flat[:, 0] / radius
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), flat[:, 1]])
    return weld(points, triangles, 1e-6 * size) if closed else (points, triangles)


if __name__ == "__main__":
    command(cylinder)
