"""The same motion on any number of ranks."""

import numpy as np
import pytest
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
