import numpy as np
from patterns import command
from plate import plate


def strip(
    length: float = 1.0,
    width: float = 0.1,
    size: float = 0.02,
    irregular: bool = False,
    diagonals: str = "alternating",
) -> tuple[np.ndarray, np.ndarray]:
    """Narrow strip along x, clamped at x = 0 as a cantilever: 0 <= y <= width, z = 0. Lengths in metres."""
    return plate(length, width, size, irregular, diagonals)


if __name__ == "__main__":
    command(strip)
