import numpy as np
from patterns import cells, command, grid, polygon, positive, unstructured


def plate(
    length: float = 1.0,
    width: float = 1.0,
    size: float = 0.05,
    irregular: bool = False,
    diagonals: str = "alternating",
) -> tuple[np.ndarray, np.ndarray]:
    """Rectangular plate, 0 <= x <= length, 0 <= y <= width, z = 0, normal up. Lengths in metres."""
    positive(length=length, width=width, size=size)
    if irregular:
        plane, triangles = unstructured(
            [polygon([(0, 0), (length, 0), (length, width), (0, width)], size)], size
        )
    else:
        plane, triangles = grid(cells(length, size), cells(width, size), diagonals)
        plane = plane * [length, width]
    return np.column_stack([plane, np.zeros(len(plane))]), triangles


if __name__ == "__main__":
    command(plate)
