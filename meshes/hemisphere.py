import numpy as np
from patterns import command, positive, spherical


def hemisphere(
    radius: float = 10.0,
    hole: float = 18.0,
    sector: float = 360.0,
    size: float = 1.0,
    irregular: bool = False,
    diagonals: str = "alternating",
) -> tuple[np.ndarray, np.ndarray]:
    """Hemisphere z >= 0 with a circular hole at the pole, or a sector of it from the x axis on; outward.

    hole: degrees from the pole to the hole's edge, 0 for none; sector: degrees, 90 is the usual quarter, 360
    is closed. The default sizes are those of the pinched hemisphere in Sze, Liu & Lo (2004).
    """
    positive(radius=radius, sector=sector, size=size)
    if not 0 <= hole < 90 or sector > 360:
        raise ValueError(
            f"hole = {hole}, sector = {sector}, allowed: 0 <= hole < 90, sector up to 360 degrees"
        )
    return spherical(radius, hole, 90.0, sector, size, irregular, diagonals)


if __name__ == "__main__":
    command(hemisphere)
