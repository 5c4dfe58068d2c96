"""Targets as a designer draws them (drawn.py) are scenes that the program reads."""

import pytest
from drawn import KINDS, drawn

from voile.scene import read_scene
from voile.wiring import build_model


@pytest.mark.parametrize("seed", range(len(KINDS)))
def test_a_drawn_target_is_read(seed, tmp_path):
    made = drawn(seed)
    assert made.name.startswith(list(KINDS)[seed])
    model = build_model(read_scene(made.write(tmp_path)))
    assert 90 <= len(model.shell.points) == len(made.mesh[0]) <= 400
    assert model.obstacles or model.shell.fixed.any()
