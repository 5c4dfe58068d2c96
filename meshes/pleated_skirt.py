import numpy as np
from patterns import cells, command, even, grid, positive, weld


def pleated_skirt(
    pleats: int = 8,
    depth: float = 0.08,
    height: float = 0.2,
    fold: float = 1.85,
    size: float = 0.008,
    diagonals: str = "alternating",
) -> tuple[np.ndarray, np.ndarray]:
    """Closed tube of round pleats about the y axis, waist at y = height, hem at y = 0, normals outward.

    depth: cloth per pleat; fold: largest angle (rad) of the cloth against the waist line, above pi/2 the pleats lie
    over each other. The plan is a sine-generated curve closed to a ring, of direction
    2 pi s / length + fold cos(2 pi s / depth).
    """
    if pleats < 2:
        raise ValueError(f"pleats = {pleats}, allowed: at least 2, to close the ring")
    positive(depth=depth, height=height, fold=fold, size=size)
    length, around = pleats * depth, pleats * even(cells(depth, size))
    s = np.linspace(0.0, length, 50 * around + 1)
    middle = 0.5 * (s[1:] + s[:-1])
    angle = 2 * np.pi * middle / length + fold * np.cos(2 * np.pi * middle / depth)
    steps = np.column_stack([np.sin(angle), np.cos(angle)]) * s[1]
    plan = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])[::50]
    plan -= plan[:-1].mean(axis=0)
    uv, triangles = grid(around, cells(height, size), diagonals)
    at = np.rint(uv[:, 0] * around).astype(int)
    points = np.column_stack([plan[at, 0], height * uv[:, 1], plan[at, 1]])
    return weld(points, triangles, 1e-6 * size)


if __name__ == "__main__":
    command(pleated_skirt)
