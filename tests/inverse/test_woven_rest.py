"""Rest shapes of woven cloth, and the warp that another scene gives them."""

import numpy as np
import pytest

import voile
from voile.mesh import write_obj
from voile.validate.shells import mapped

TABLE = {
    "scene": {"task": "inverse"},
    "shell": {
        "young": 4e7,
        "young_weft": 4e6,
        "material": "orthotropic",
        "thickness": 1e-3,
        "density": 300.0,
    },
    "loads": {"gravity": [0.0, 0.0, -9.81]},
    "fix": [{"select": {"box": [[-1.0, -1.0, -1.0], [0.001, 1.0, 1.0]]}, "clamp": True}],
}


@pytest.mark.parametrize("warp", ["v", [1.0, 0.5, 0.0]])
def test_a_warp_of_texture_coordinates_goes_along_and_one_in_space_is_told(warp, tmp_path):
    """A strip, drawn level, whose rest shape bends up: its files give the target back where the warp goes along."""
    u, v, triangles, _ = mapped(16, 4, "crossed")
    points = np.column_stack([0.15 * u, 0.03 * v, 0.0 * u])
    texture = np.column_stack([points[:, 0] - 2.0 * points[:, 1], 2.0 * points[:, 0] + points[:, 1]])
    path = tmp_path / "strip.obj"
    write_obj(path, points, triangles, texture)
    shell = TABLE["shell"] | {"mesh": str(path), "warp": warp}
    found = voile.run(TABLE | {"shell": shell}, tmp_path / "out")
    told = [note for note in found.summary["notes"] if "the warp went along" in note]
    again = shell | {"rest": str(tmp_path / "out" / "rest.obj")}
    hangs = voile.run({**TABLE, "scene": {}, "shell": again}).positions
    off = np.linalg.norm(hangs - points, axis=1).max()
    if warp == "v":
        assert not told and off < 1e-8
    else:
        assert len(told) == 1 and off > 1e-3
