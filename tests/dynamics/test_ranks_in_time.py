"""The same motion on any number of ranks."""

import numpy as np
import pytest
from test_problem import sheet
from test_runs_in_time import SCENE, scene

from voile.results import read_result, read_summary
from voile.results.history import read_history

__all__ = ["scene"]  # a fixture
FREE = SCENE[: SCENE.index("[[obstacle]]")] + SCENE[SCENE.index("[dynamics]") :]
FREE = FREE.replace("velocity = [", "angular_velocity = [1.0, 2.0, 3.0]\nvelocity = [").replace(
    "0.2\n", "0.3\n"
)  # 60 steps
# a load on one vertex alone, from before as well
PULLED = FREE.replace("-9.81", "0.0").replace(
    "[dynamics]",
    '[[loads.force]]\nselect = { nodes = [3] }\nvalue = [0.0, 0.0, 0.1]\n[dynamics]\nscheme = "generalized-alpha"',
)

# a sphere that lets the sheet out of 1.5 mm
INSIDE = SCENE.replace("-0.12]", "-0.099]").replace("time_step = 0.005", "time_step = 0.01")

# Two sheets on a ball. Where a vertex of one lay on one of the other it would touch six triangles at once: what
# these share of friction is not unique, and which end a step finds is left to round-off, on one rank as well.
LAYERS = SCENE.replace("velocity = [0.2, 0.0, 0.0]\n", "").replace("radius = 0.1", "radius = 0.08")
LAYERS = LAYERS.replace("center = [0.5, 0.25, -0.12]", "center = [0.0, 0.0, -0.085]").split("move")[0] + (
    "[contact]\nself_contact = true\nself_friction = 0.3\n[dynamics]\ntime_step = 0.004\nduration = 0.1\n"
)


@pytest.mark.mpi
def test_ranks_agree_where_layers_rub(tmp_path, run_on, rank_counts):
    lower, triangles = sheet(5, 5, 0.25, 0.25)
    lower -= lower.mean(axis=0)
    c, s = np.cos(0.35), np.sin(0.35)
    upper = lower @ [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]] + [0.0071, 0.0123, 0.004]
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.vstack([lower, upper]).tolist()]
    both = np.vstack([triangles, triangles + len(lower)]) + 1
    lines += [f"f {a} {b} {c}" for a, b, c in both.tolist()]
    (tmp_path / "sheet.obj").write_text("\n".join(lines))
    path = tmp_path / "scene.toml"
    path.write_text(LAYERS)
    for ranks in rank_counts:
        run_on(ranks, path, tmp_path / str(ranks))
    histories = [read_history(tmp_path / str(ranks)) for ranks in rank_counts]
    assert histories[0]["slip"].max() > 5
    for ranks, history in zip(rank_counts[1:], histories[1:], strict=True):
        np.testing.assert_allclose(history["time"], histories[0]["time"])
        with read_result(tmp_path / str(ranks)) as one, read_result(tmp_path / "1") as other:
            np.testing.assert_allclose(one.points(-1), other.points(-1), rtol=0, atol=1e-6)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("text", "within"),
    [pytest.param(FREE, 1e-10, marks=pytest.mark.slow), (PULLED, 1e-10), (SCENE, 1e-6), (INSIDE, 1e-6)],
    ids=["free", "pulled", "contact", "inside"],
)
def test_ranks_agree(scene, tmp_path, run_on, rank_counts, text, within):
    scene.write_text(text)
    ends = []
    for ranks in rank_counts:
        run_on(ranks, scene, tmp_path / str(ranks))
        with read_result(tmp_path / str(ranks)) as result:
            ends.append(np.stack([result.points(-1), 0.1 * result.field("velocity")]))
        assert read_summary(tmp_path / str(ranks) / "summary.json")["ranks"] == ranks
    for other in ends[1:]:
        np.testing.assert_allclose(other, ends[0], rtol=0, atol=within)
    histories = [read_history(tmp_path / str(ranks)) for ranks in (1, rank_counts[-1])]
    for name in ("kinetic", "gravity", "scheme_dissipated", "momentum", "angular_momentum"):
        largest = np.abs(histories[0][name]).max()
        np.testing.assert_allclose(
            histories[1][name], histories[0][name], rtol=0, atol=100.0 * within * largest
        )
