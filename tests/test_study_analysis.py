"""What a study makes of its runs' numbers: limits, rates, chance hits, the front. No run is needed."""

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import refused, voile
from studies import POINT, SCENE

from voile.errors import InputError
from voile.mesh import read_mesh, refine, write_obj
from voile.study import report
from voile.study.analysis import analyse
from voile.study.execute import Record, Runs, _last_line, launcher
from voile.study.measures import figure, mean_weights
from voile.study.plan import read_plan
from voile.study.series import extrapolate, rate_to


@pytest.mark.parametrize("rate", [0.7, 1.0, 2.0, 3.5])
@pytest.mark.parametrize("sizes", [(1.0, 0.5, 0.25), (0.3, 0.2, 0.05)])
def test_limits_of_exact_series(rate, sizes):
    values = tuple(3.0 - 2.0 * h**rate for h in sizes)
    limit, found = extrapolate(sizes, values)
    assert limit == pytest.approx(3.0, abs=1e-9) and found == pytest.approx(rate, abs=1e-8)


def test_what_has_no_limit():
    assert extrapolate((1.0, 0.5), (1.0, 2.0)) == (None, None)
    assert extrapolate((1.0, 0.5, 0.25), (1.0, 2.0, 1.5)) == (None, None)  # to and fro
    assert extrapolate((1.0, 0.5, 0.25), (1.0, 2.0, 4.0)) == (None, None)  # away
    assert extrapolate((1.0, 0.5, 0.25), (1.0, 2.0, 2.0)) == (2.0, None)  # settled


def test_differences_that_residuals_leave_have_no_rate():
    """A sheet that stops has rubbed all of its energy away, whatever the time step."""
    values = (0.08999999999357754, 0.08999999999950829, 0.08999999999977319, 0.08999999999998588)
    assert extrapolate((8.0, 4.0, 2.0, 1.0), values) == (values[-1], None)
    to_and_fro = (0.08999999999098049, 0.08999999998221647, 0.08999999998998765)
    assert extrapolate((4.0, 2.0, 1.0), to_and_fro) == (to_and_fro[-1], None)
    assert rate_to(0.09, (2.0, 1.0), values[-2:]) is None


@pytest.fixture
def findings(tmp_path):
    """findings(study, value, seconds, cpu): of runs whose value and seconds are functions of their settings."""
    from mesh_helpers import generator

    points, triangles = generator("strip").strip(length=1.0, width=0.1, size=0.1)
    write_obj(tmp_path / "strip.obj", points, triangles)
    (tmp_path / "scene.toml").write_text(SCENE)

    def find(text, value, seconds, cpu=lambda s: None):
        (tmp_path / "study.toml").write_text(
            '[study]\nscene = "scene.toml"\nmeasure = "tip"\n' + text + POINT
        )
        plan = read_plan(tmp_path / "study.toml")
        records = [
            Record(
                run.key,
                "converged",
                "",
                {"tip": value(run.effective)},
                seconds(run.effective),
                1,
                cpu(run.effective),
            )
            for run in plan.runs
        ]
        return analyse(plan, records)

    return find


def test_errors_are_told_apart_by_what_causes_them(findings):
    """A value made of a limit and known parts of discretisation, iteration and model."""

    def value(s):
        model = 0.05 if s["shell.model"] == "projective" else 0.0
        return 1.0 + model + 0.2 * 0.25 ** s["refine"] + (0.01 if s["statics.tolerance"] > 1e-6 else 0.0)

    text = """reference = "extrapolate"
[vary]
refine = [0, 1, 2]
"shell.model" = ["koiter", "projective"]
"statics.tolerance" = [1e-2, 1e-9]
"""
    found = findings(text, value, lambda s: 4.0 ** s["refine"])
    assert found.references["tip"] == pytest.approx(1.0, abs=1e-9)
    for row in found.rows:
        s, parts = row.run.effective, row.parts["tip"]
        assert parts["discretisation"] == pytest.approx(0.2 * 0.25 ** s["refine"], abs=1e-8)
        assert parts["iteration"] == pytest.approx(0.01 * (s["statics.tolerance"] == 1e-2), abs=1e-8)
        assert parts["model"] == pytest.approx(0.05 * (s["shell.model"] == "projective"), abs=1e-8)
    assert all(s.rate == pytest.approx(2.0, abs=1e-6) for s in found.series)


@pytest.mark.parametrize(("off", "kind"), [(0.0, "discretisation"), (1e-4, "discretisation"), (0.2, "model")])
def test_normals_are_another_model_where_their_limit_is_another(off, kind, findings):
    """`sin` and `tan` go to one shell; `average` on some meshes only, and no study of two meshes can tell."""

    def value(s):
        return 1.0 + off * (s["shell.bending"] == "average") + 0.2 * 0.25 ** s["refine"]

    text = 'reference = "extrapolate"\n[vary]\nrefine = [%s]\n"shell.bending" = ["tan", "sin", "average"]\n'
    for levels, average in (("0, 1, 2", kind), ("0, 1", "model")):
        found = findings(
            (text % levels).replace('"extrapolate"', '"extrapolate"' if "2" in levels else "1.0"),
            value,
            lambda s: 1.0,
        )
        told = {row.run.name: row.changes for row in found.rows}
        last = levels[-1]
        assert told[f"refine={last} shell.bending=sin"] == {"discretisation": ["shell.bending"]}
        assert told[f"refine={last} shell.bending=average"] == {average: ["shell.bending"]}


@pytest.mark.parametrize(("off", "kind"), [(0.0, "discretisation"), (0.01, "model")])
def test_facets_are_another_shell_where_their_limit_is_another(off, kind, findings):
    """A curved shell's midpoints converge to its facets; a flat one's are the smooth ones."""
    text = 'reference = "extrapolate"\n[vary]\nrefine = [0, 1, 2]\n"shell.refine_smooth" = [true, false]\n'
    found = findings(
        text,
        lambda s: 1.0 + 0.2 * 0.25 ** s["refine"] - off * (not s["shell.refine_smooth"]),
        lambda s: 1.0,
    )
    assert found.rows[-1].changes == {kind: ["shell.refine_smooth"]}


def test_keys_that_a_scene_makes_nothing_of_neither_change_nor_repeat_a_run(findings):
    """Hinges have no mid-edge normals, Newton's method no local and global iterations."""
    text = """reference = 1.0
[vary]
"shell.model" = ["koiter", "discrete-shells"]
"shell.bending" = ["average", "tan"]
"""
    found = findings(text, lambda s: 1.0, lambda s: 1.0)
    assert [row.run.effective["shell.bending"] for row in found.rows] == ["average", "tan", None]
    assert found.rows[2].changes == {"model": ["shell.model"]}
    text = """reference = 1.0
[vary]
"scene.task" = ["dynamics"]
"shell.model" = ["projective"]
"dynamics.solver" = ["newton", "local-global"]
"dynamics.iterations" = [5, 10]
"""
    found = findings(text, lambda s: 1.0, lambda s: 1.0)
    assert [row.run.effective["dynamics.iterations"] for row in found.rows] == [None, 5, 10]


def test_errors_in_the_table_have_the_digits_of_values(findings, tmp_path):
    """Ranks sum in another order each time: what that changes is in no table."""

    def table(noise):
        text = 'reference = "extrapolate"\n[vary]\nrefine = [0, 1, 2]\nranks = [1, 2]\n'
        found = findings(
            text, lambda s: 1.0 + 0.2 * 0.25 ** s["refine"] + noise * (s["ranks"] - 1), lambda s: 1.0
        )
        return report._csv(found, Runs(found.plan, tmp_path))

    assert table(3e-14) == table(1e-14)


@pytest.mark.parametrize(("rate", "guess"), [(2.0, False), (1.0, False), (0.4, True)])
def test_limits_far_off_the_finest_run_are_guesses(rate, guess, findings):
    """At rate 0.4 the limit is three times as far as the last refinement changed the value; not where it is asked for
    no better."""
    text = 'reference = "extrapolate"\naccuracy = [%s]\n[vary]\nrefine = [0, 1, 2]\n'
    for accuracy, told in (("0.01", guess), ("0.5", False)):
        found = findings(text % accuracy, lambda s: 1.0 + 0.3 * 2.0 ** (-rate * s["refine"]), lambda s: 1.0)
        assert found.references["tip"] == pytest.approx(1.0, abs=1e-9)
        assert found.guesses == (["tip"] if told else [])


def test_a_list_with_a_poor_first_value_names_a_surer_one(findings):
    """Its limit would be the reference, and recommendations say of what they are."""
    rates = {"average": 0.4, "tan": 2.0, "sin": 0.5}
    text = """reference = "extrapolate"\n[vary]\nrefine = [0, 1, 2]\n"shell.bending" = ["average", "tan", "sin"]\n"""

    def value(s):
        return 1.0 + 0.3 * 2.0 ** (-rates[s["shell.bending"]] * s["refine"])

    found = findings(text, value, lambda s: 1.0)
    told = report.text(found)
    assert found.guesses == ["tip"] and [s.settings["shell.bending"] for s in found.surer] == ["tan"]
    assert "tip of shell.bending=tan goes to 1, no guess: first in its list it is the reference" in told
    assert "error 0.05 over a guess: " in told
    found = findings(text.replace('"average", "tan"', '"tan", "average"'), value, lambda s: 1.0)
    assert not found.guesses and not found.surer and "guess" not in report.text(found)


def test_measures_without_a_reference_are_named(findings):
    """Values that go to and fro have no limit."""
    text = 'reference = "extrapolate"\n[vary]\nrefine = [0, 1, 2]\n'
    found = findings(text, lambda s: [1.0, 2.0, 1.5][s["refine"]], lambda s: 1.0)
    assert not found.references and all(row.error is None for row in found.rows)
    assert "no reference of tip: no error counts it" in report.text(found)
    steady = findings(text, lambda s: 1.0 + 0.25 ** s["refine"], lambda s: 1.0)
    assert "no reference" not in report.text(steady)


def test_small_by_chance_is_not_recommended(findings):
    """The second mesh crosses the reference by chance; finer ones are further off."""
    values = {0: 1.3, 1: 1.00001, 2: 0.94, 3: 0.985}
    text = "reference = 1.0\naccuracy = [0.1, 0.02, 0.001]\n[vary]\nrefine = [0, 1, 2, 3]\n"
    found = findings(text, lambda s: values[s["refine"]], lambda s: 4.0 ** s["refine"])
    assert [row.trusted for row in found.rows] == pytest.approx([0.3, 0.06, 0.06, 0.015])
    chosen = [choice.row and choice.row.run.effective["refine"] for choice in found.choices]
    assert chosen == [1, 3, None]
    assert [row.run.effective["refine"] for row in found.front] == [0, 1, 3]


def test_the_front_takes_no_heed_of_what_clocks_cannot_tell(findings):
    text = "reference = 1.0\n[vary]\nrefine = [0, 1, 2, 3]\n"
    errors, seconds = {0: 0.3, 1: 0.1, 2: 0.03, 3: 0.01}, {0: 0.50, 1: 0.55, 2: 9.0, 3: 10.0}
    fronts = []
    for noise in (0.9, 1.0, 1.1):
        found = findings(
            text, lambda s: 1.0 + errors[s["refine"]], lambda s, f=noise: f * seconds[s["refine"]]
        )
        fronts.append([row.run.effective["refine"] for row in found.front])
    assert fronts == [[1, 3]] * 3
    best = [choice.row and choice.row.run.effective["refine"] for choice in found.choices]
    assert best == [3, None, None]


def test_what_is_recommended_lies_on_the_front(findings):
    """The third is alike to the second in time, and that to the first, but the third not to the first: which is the one
    to choose for 0.1, and by the second's time."""
    errors, seconds = {0: 0.07, 1: 0.01, 2: 0.001}, {0: 10.0, 1: 11.0, 2: 13.5}
    text = "reference = 1.0\naccuracy = [0.1, 0.005]\n[vary]\nrefine = [0, 1, 2]\n"
    found = findings(text, lambda s: 1.0 + errors[s["refine"]], lambda s: seconds[s["refine"]])
    assert [row.run.effective["refine"] for row in found.front] == [1, 2]
    assert [choice.row for choice in found.choices] == found.front


def test_of_runs_as_exact_the_first_is_recommended(findings):
    """Round-off does not choose among them."""
    text = "reference = 1.0\naccuracy = [0.1]\n[vary]\nranks = [1, 2, 4]\n"
    found = findings(text, lambda s: 1.01 - 1e-13 * s["ranks"], lambda s: 1.0 + 0.1 * s["ranks"])
    assert [row.run.effective["ranks"] for row in found.front] == [1]
    assert found.choices[0].row is found.front[0]


@pytest.mark.parametrize(("clock", "front", "best"), [("wall", [1], 1), ("cpu", [0, 1], 0)])
def test_front_and_choice_go_by_the_clock_asked_for(clock, front, best, findings):
    """The exact run is as fast on the wall, by several processors, and slower in all of them together."""
    text = f'reference = 1.0\naccuracy = [0.5]\nclock = "{clock}"\n[vary]\nrefine = [0, 1]\n'
    found = findings(
        text, lambda s: 1.2 - 0.1 * s["refine"], lambda s: 5.0, lambda s: 5.0 + 10.0 * s["refine"]
    )
    assert [row.run.effective["refine"] for row in found.front] == front
    assert found.choices[0].row.run.effective["refine"] == best


def test_figures_of_summaries():
    summary = {
        "energy": {"a": 1.0, "b": 2.0},
        "dynamics": {"momentum": [3.0, 4.0]},
        "stable": True,
        "none": None,
    }
    assert figure(summary, "energy") == 3.0 and figure(summary, "energy.b") == 2.0
    assert figure(summary, "dynamics.momentum") == 5.0 and figure(summary, "dynamics.momentum.1") == 4.0
    assert [figure(summary, name) for name in ("stable", "none", "energy.c", "dynamics.momentum.7")] == [
        None
    ] * 4


def test_means_agree_between_meshes(tmp_path):
    """Of a linear function over a line and an area, on every level; so means converge at the shape's own rate."""
    from test_cli import cells

    (tmp_path / "mesh.obj").write_text(cells())
    for times in range(3):
        surface = refine(read_mesh(tmp_path / "mesh.obj"), times, "shell.refine")
        x = surface.points[:, 0]
        for chosen, mean in (
            (np.abs(surface.points[:, 1]) < 1e-12, 0.05),
            (x < 0.0501, 0.025),
            (x >= 0.0, 0.05),
        ):
            weight = mean_weights(surface, np.flatnonzero(chosen))
            assert weight @ x / weight.sum() == pytest.approx(mean, abs=1e-12)


def test_labels_of_neighbours_on_the_front_do_not_overlap():
    """Two points that lie together, low and at the right, among others."""
    import matplotlib.pyplot as plt

    from voile.study import picture

    rows = [
        SimpleNamespace(seconds=s, error=e, counted=e, run=SimpleNamespace(effective={"shell.refine": k}))
        for k, (s, e) in enumerate([(0.5, 0.1), (4.0, 1.1e-4), (4.2, 1.09e-4), (4.3, 0.02)])
    ]
    found = SimpleNamespace(rows=rows, front=rows[:3], varied=["shell.refine"])
    figure, axes = plt.subplots(layout="constrained")
    axes.set(xscale="log", yscale="log", xlim=(0.4, 5.0), ylim=(1e-4, 1.0))
    picture._name_front(axes, found)
    boxes = [text.get_window_extent() for text in axes.texts]
    plt.close(figure)
    assert len(boxes) == 3
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert all(axes.bbox.contains(*corner) for box in boxes for corner in box.corners())


def test_the_reason_is_what_the_program_said(tmp_path):
    log = tmp_path / "log.txt"
    for text, reason in (
        ("load 1\nvoile: no such thing\n-----\nmpirun has exited\n-----\n", "no such thing"),
        ("mpirun was not given a name\n------\n\n", "mpirun was not given a name"),
        ("---\n", "exit code 1"),
    ):
        log.write_text(text)
        assert _last_line(log, 1) == reason


def test_what_cannot_start_runs_is_refused(monkeypatch):
    """A launcher that is not there or no command; mpirun, which tells its ranks how many they are."""
    for given, words in (
        ("no-such-mpirun -n {ranks}", "is not on the PATH"),
        ("srun '", "No closing quotation"),
        ("env -n {rank}", "{rank} stands for nothing"),
    ):
        with pytest.raises(InputError, match=f"study.launcher: .*{words}"):
            launcher(given, 2)
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    refused(voile("study", "any.toml"), "study: 2 ranks; allowed: one process")
