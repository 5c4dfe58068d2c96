"""What a strip's width adds to the load at which it buckles sideways, clamped on edge: von Karman's plate.

By scripts/plate-strip on 2026-11-29: NGSolve 6.2.2608, C^0 interior penalty of order 5, cells of a quarter of the
width; order 4 differs by 1e-4 at most.
"""

# (load, Poisson's ratio) -> width over length -> critical load over a narrow strip's.
WIDENED = {
    ("weight", 0.0): {0.1: 1.06439, 0.05: 1.03122, 0.025: 1.01535},
    ("weight", 0.3): {0.1: 1.07989, 0.05: 1.03822, 0.025: 1.01865},
    ("tip load", 0.0): {0.1: 1.04232, 0.05: 1.02064, 0.025: 1.01019},
    ("tip load", 0.3): {0.1: 1.05215, 0.05: 1.02516, 0.025: 1.01236},
}
