"""What campaigns start from: imports, and a result with obstacles, contact and a history."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from voile.results import Pattern

# A program that keeps what it goes on from after every step, not every half second.
OFTEN = (
    "import sys; from voile.results.restart import Restarts; Restarts.PAUSE = Restarts.SHARE = 0.0; "
    "from voile.cli import main; sys.exit(main())"
)
STRIP = "\n".join(
    [f"v {0.04 * i} {0.05 * j} 0" for i in range(6) for j in range(2)]
    + [f"f {2 * i + a} {2 * i + b} {2 * i + c}" for i in range(5) for a, b, c in ((1, 3, 4), (1, 4, 2))]
)
SCENE = """
[scene]
task = "dynamics"
[shell]
mesh = "strip.obj"
young = 1e6
thickness = 1e-3
density = 300.0
[dynamics]
duration = 0.05
time_step = 0.01
[[fix]]
select = { box = [[-0.01, -1, -1], [0.01, 1, 1]] }
clamp = true
[[obstacle]]
shape = "sphere"
center = [0.1, -0.05, 0.025]
radius = 0.045
friction = 0.3
"""


def preload() -> None:
    """Imports what the commands need, once for all forks."""
    import h5py  # noqa: F401
    import matplotlib.pyplot  # noqa: F401
    import meshio  # noqa: F401
    import pyvista.plotting  # noqa: F401
    from PIL import Image

    import voile.api
    import voile.explain
    import voile.post
    import voile.wiring  # noqa: F401
    from voile.commands import all_commands

    Image.preinit()
    all_commands()


def small_result(folder: Path) -> Path:
    """The folder of a short run, made in a process of its own: MPI does not live in forks."""
    import subprocess
    import sys

    folder.mkdir()
    (folder / "strip.obj").write_text(STRIP)
    (folder / "scene.toml").write_text(SCENE)
    command = [sys.executable, "-m", "voile.cli", "run", folder / "scene.toml", "-o", folder / "out"]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "out"


def small_pattern() -> Pattern:
    """Two squares of 0.1 m, sewn along a side."""
    from voile.mesh import Notches, Pattern, Piece, SewnSeam

    square = 0.1 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    triangles, outline = np.array([[0, 1, 2], [0, 2, 3]]), np.arange(4)

    def piece(name: str, at: float, side: float, inward: float) -> Piece:
        notches = Notches(np.array([[side, 0.05]]), np.array([[inward, 0.0]]), np.array([0.01]), ("a",))
        grain = np.array([[0.05, 0.02], [0.05, 0.08]])
        x = square + np.array([at, 0.0])
        cut = (x + 0.2 * (square - 0.05),)
        return Piece(
            name, x, triangles, np.ones((2, 2)), outline, cut, outline, grain + np.array([at, 0.0]), notches
        )

    pieces = piece("front", 0.0, 0.1, -1.0), piece("back", 0.2, 0.2, 1.0)
    seam = SewnSeam("a", (0, 1), (np.array([1, 2]), np.array([0, 3])), (0.1, 0.1), 0.01, 0.0)
    return Pattern(pieces, (seam,), 0.01, 0.005)
