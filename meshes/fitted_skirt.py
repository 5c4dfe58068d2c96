import numpy as np
from dress_form import _profile, _section
from patterns import cells, command, even, grid, positive, weld


def fitted_skirt(
    level: float = 0.26,
    clearance: float = 0.002,
    length: float = 0.40,
    flare: float = 0.25,
    size: float = 0.025,
    diagonals: str = "alternating",
    height: float = 0.80,
    bust: float = 0.88,
    waist: float = 0.68,
    hip: float = 0.94,
) -> tuple[np.ndarray, np.ndarray]:
    """One-piece skirt around a dress form (height, bust, waist, hip as there), normals outward.

    level: height of its upper edge (m), which follows the form's section there at a distance `clearance` (m);
    length: along the slope (m); flare: sine of the slope's angle, the same all around, so the skirt is developable.
    """
    positive(clearance=clearance, length=length, flare=flare, size=size)
    if flare >= 1 or not 0 < level < height:
        raise ValueError(
            f"flare = {flare}, level = {level}, allowed: flare below 1, level between 0 and {height}"
        )
    y, girth, shape = _profile(height, {"bust": bust, "waist": waist, "hip": hip})
    around = float(np.interp(level, y, girth))
    middle = around + np.pi * (2 * clearance + flare * length)  # an offset curve grows by 2 pi
    columns = even(cells(middle, size))
    uv, triangles = grid(columns, cells(length, size), diagonals)
    section = _section(around, shape(level), np.linspace(0, 1, 16 * columns, endpoint=False), level)[
        :, [0, 2]
    ]
    chord = np.roll(section, -8, axis=0) - np.roll(section, 8, axis=0)
    outward = np.column_stack([-chord[:, 1], chord[:, 0]]) / np.linalg.norm(chord, axis=1)[:, None]
    at = np.rint(16 * columns * uv[:, 0]).astype(int) % len(section)
    down = length * (1 - uv[:, 1])
    across = section[at] + (clearance + flare * down)[:, None] * outward[at]
    points = np.column_stack([across[:, 0], level - np.sqrt(1 - flare**2) * down, across[:, 1]])
    return weld(points, triangles, 1e-6 * size)


if __name__ == "__main__":
    command(fitted_skirt)
