import numpy as np
from patterns import cells, command, even, grid, positive, side, unstructured, weld


def slit_annulus(
    inner: float = 6.0,
    outer: float = 10.0,
    size: float = 0.5,
    irregular: bool = False,
    diagonals: str = "alternating",
) -> tuple[np.ndarray, np.ndarray]:
    """Annular plate in z = 0 cut along the positive x axis: the cut's two sides have vertices of their own.

    inner, outer: radii. The vertices of the side at angle 0 come from triangles above the axis, those of the
    other from below it. The radii of Sze, Liu & Lo (2004), who lift one side, are the default.
    """
    positive(inner=inner, width=outer - inner, size=size)
    if not irregular:
        around = even(cells(np.pi * (inner + outer), size))
        uv, triangles = grid(cells(outer - inner, size), around, diagonals)
        radius, angle = inner + (outer - inner) * uv[:, 0], 2 * np.pi * uv[:, 1]
        plane = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        plane, triangles = _halves(inner, outer, size)
    return np.column_stack([plane, np.zeros(len(plane))]), triangles


def _halves(inner: float, outer: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Two mirrored halves joined along the negative x axis only, so the cut stays open."""

    def arc(radius: float, start: float, end: float) -> np.ndarray:
        angle = side([start, 0], [end, 0], cells(np.pi * radius, size))[:, 0]
        return radius * np.column_stack([np.cos(angle), np.sin(angle)])

    count = cells(outer - inner, size)
    out, back = side([inner, 0], [outer, 0], count), side([-outer, 0], [-inner, 0], count)
    outline = np.concatenate([out, arc(outer, 0, np.pi), back, arc(inner, np.pi, 0)])
    half, triangles = unstructured([outline], size)
    plane = np.concatenate([half, half * [1, -1]])
    both = np.concatenate([triangles, triangles[:, ::-1] + len(half)])
    # a third coordinate keeps the halves apart but for the negative x axis
    middle = (half[:, 0] < 0) & (np.abs(half[:, 1]) < 1e-9 * outer)
    apart = np.concatenate([np.zeros(len(half)), np.where(middle, 0.0, outer)])
    joined, triangles = weld(np.column_stack([plane, apart]), both, 1e-6 * size)
    return joined[:, :2], triangles


if __name__ == "__main__":
    command(slit_annulus)
