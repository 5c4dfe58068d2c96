"""`voile study` through the command line: known rates, lists, and refusals."""

import h5py
import numpy as np
import pytest
from command_line import refused, voile
from mesh_helpers import generator
from studies import HEAD, POINT, THREE, TIP, done, place, table

from voile.mesh import write_obj
from voile.solver.friction import solve_friction
from voile.validate.protocols.friction_problems import OWN

PROBLEM = """
[study]
scene = "p.h5"
measure = ["normal_force", "friction_force", "open", "stick", "slip"]
reference = { tolerance = 1e-12 }
repeats = 1
[vary]
tolerance = [1e-2, 1e-5]
"""


def write_rows(path, W, q, mu):
    with h5py.File(path, "w") as file:
        for name in ("data", "indices", "indptr"):
            file[f"W/{name}"] = getattr(W, name)
        file["W/shape"], file["q"], file["mu"] = np.array(W.shape), q, mu


@pytest.fixture
def study(tmp_path):
    """study(text): writes study.toml beside the scene of a coarse strip."""
    return place(tmp_path)


def series_of(report, **settings):
    (found,) = (r for r in report["rates"] if {k: r["settings"].get(k) for k in settings} == settings)
    return found


def test_rates_and_limits_of_the_heavy_cantilever(study, tmp_path):
    """Against the elastica and by Richardson: order 2, the limit nearer than the finest run; bending = average has the
    same limit, discrete shells another model."""
    spec = f"""{HEAD}measure = "tip"
reference = "extrapolate"
[vary]
refine = [0, 1, 2, 3]
"shell.bending" = ["tan", "average"]
[[case]]
name = "hinges"
set = {{ "shell.model" = "discrete-shells", refine = 2 }}
{POINT}"""
    report = done(study(spec), tmp_path / "out", "--jobs", "2")
    for bending in ("tan", "average"):
        found = series_of(report, **{"shell.bending": bending})
        assert found["along"] == "refine" and found["rate"] == pytest.approx(2.0, abs=0.15)
        assert abs(found["extrapolated"] - TIP) < 0.3 * abs(found["values"][-1] - TIP) < 1e-4
    rows = {row["run"]: row for row in table(tmp_path / "out")}
    hinges, fine = rows["hinges"], rows["refine=3 shell.bending=average"]
    assert hinges["changes"] == "discretisation: refine; model: shell.model" and float(hinges["error"]) > 0.03
    assert fine["changes"] == "discretisation: shell.bending"
    assert float(fine["model error tip"]) < 1e-5 < float(fine["discretisation error tip"])
    assert rows["refine=3 shell.bending=tan"]["front"] == "yes"
    best = {choice["accuracy"]: choice["run"] for choice in report["recommended"]}
    assert best[0.05] and best[0.01] and best[0.001]
    assert (tmp_path / "out" / "study.png").stat().st_size > 10_000
    study(spec.replace('"extrapolate"', f"{TIP}"))
    known = done(tmp_path / "study.toml", tmp_path / "out")
    found = series_of(known, **{"shell.bending": "tan"})
    assert found["rate_to_reference"] == pytest.approx(2.0, abs=0.1)
    errors = [abs(v / TIP - 1.0) for v in found["values"]]
    listed = {r["run"]: r["error"] for r in known["runs"]}
    assert [listed[f"refine={n} shell.bending=tan"] for n in range(4)] == pytest.approx(errors, rel=1e-12)


def test_a_finest_run_as_reference(study, tmp_path):
    spec = (
        HEAD
        + 'measure = ["max_displacement", "energy"]\nreference = { refine = 3 }\n[vary]\nrefine = [0, 1]\n'
    )
    report = done(study(spec), tmp_path / "out")
    assert [r["run"] for r in report["runs"]] == ["refine=0", "refine=1", "reference refine=3"]
    assert report["runs"][2]["error"] is None and table(tmp_path / "out")[2]["changes"] == "the reference"
    errors = [r["error"] for r in report["runs"][:2]]
    assert 3.0 < errors[0] / errors[1] < 5.0
    assert {row["run"] for row in report["pareto"]} <= {"refine=0", "refine=1"}


def test_what_fails_is_a_row_with_its_reason(study, tmp_path):
    spec = f"""{HEAD}measure = "tip"
reference = {TIP}
max_seconds = 20
[vary]
"statics.max_steps" = [1, 100]
"statics.load_steps" = [1, 4]
[[case]]
name = "no such step"
set = {{ "dynamics.solver" = "local-global", "scene.task" = "dynamics" }}
[[case]]
name = "inside"
set = {{ obstacle = [{{ shape = "sphere", center = [0.5, 0.05, 0.0], radius = 0.2 }}] }}
{POINT}"""
    report = done(study(spec), tmp_path / "out")
    rows = {r["run"]: r for r in report["runs"]}
    stuck = rows["statics.max_steps=1 statics.load_steps=4"]
    assert (
        stuck["status"] == "not converged"
        and "load factor 0.25" in stuck["reason"]
        and stuck["error"] is None
    )
    assert rows["no such step"]["status"] == "refused" and "projective" in rows["no such step"]["reason"]
    assert rows["inside"]["status"] == "refused" and "deep inside" in rows["inside"]["reason"]
    assert sum(r["status"] == "converged" for r in report["runs"]) == 3
    assert len(table(tmp_path / "out")) == 6


def test_all_runs_fail(study, tmp_path):
    case = 'name = "stuck"\nset = { "statics.max_steps" = 1, "statics.load_steps" = 4 }\n'
    spec = f'{HEAD}measure = "tip"\nreference = 1.0\n[[case]]\n{case}{POINT}'
    run = voile("study", study(spec), "-o", tmp_path / "out")
    assert run.returncode == 3 and "load factor 0.25" in run.stdout


def test_ranks_and_meshes_vary_too(study, tmp_path):
    for n, size in enumerate((0.1, 0.05, 0.025)):
        points, triangles = generator("strip").strip(length=1.0, width=0.1, size=size)
        write_obj(tmp_path / f"{n}.obj", points, triangles)
    spec = (
        HEAD
        + f'measure = "tip"\nreference = {TIP}\n[vary]\nranks = [1, 2]\n"shell.mesh" = ["0.obj", "1.obj", "2.obj"]\n'
    )
    report = done(study(spec + POINT), tmp_path / "out")
    one, two = (series_of(report, ranks=n) for n in (1, 2))
    assert one["values"] == pytest.approx(two["values"], abs=1e-8)
    assert one["rate_to_reference"] == pytest.approx(2.0, abs=0.3)
    assert [r["changes"].get("cost only") for r in report["runs"][3:]] in ([["ranks"]] * 3, [None] * 3)


def test_time_steps_and_reactions(study, tmp_path):
    """A strip falls freely, then lies on the floor: positions of first order in the time step; the floor carries it."""
    (tmp_path / "scene.toml").write_text("""
scene = { task = "dynamics" }
shell = { mesh = "strip.obj", young = 1e5, thickness = 1e-3, density = 300.0 }
loads = { gravity = [0.0, 0.0, -9.81] }
obstacle = [{ shape = "plane", point = [0.0, 0.0, -1.0], normal = [0.0, 0.0, 1.0] }]
dynamics = { time_step = 0.02, duration = 0.2 }
""")
    point = '[[point]]\nname = "low"\nselect = { nodes = 0 }\nof = "position"\naxis = "z"\n'
    spec = (
        HEAD
        + 'measure = "low"\nreference = "extrapolate"\n[vary]\n"dynamics.time_step" = [0.04, 0.02, 0.01]\n'
    )
    report = done(study(spec + point), tmp_path / "out")
    (found,) = report["rates"]
    assert found["along"] == "dynamics.time_step" and found["rate"] == pytest.approx(1.0, abs=0.01)
    assert found["extrapolated"] == pytest.approx(-0.5 * 9.81 * 0.2**2, rel=1e-6)
    assert report["runs"][0]["changes"] == {"time step": ["dynamics.time_step"]}
    lie = '[[point]]\nname = "low"\nselect = { all = true }\nof = "reaction"\naxis = "z"\n'
    late = '[[case]]\nname = "late"\nset = { "dynamics.duration" = 1.0 }\n'
    spec = f'{HEAD}measure = "low"\nreference = {300.0 * 1e-4 * 9.81}\n{late}'
    report = done(study(spec + lie), tmp_path / "out")
    assert report["runs"][0]["error"] < 1e-4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[vary]\n"shell.bendin" = ["tan"]', ("line 6: vary.shell.bendin", "no scene has", '"bending"')),
        ("[vary]\nyoung = [1.0]", ("line 6: vary.young", "no scene has", "[shell]")),
        (
            '[vary]\n"shell.bending" = ["tan", 3]',
            ("line 6: vary.shell.bending", "3 is not allowed", '"average"'),
        ),
        ('[vary]\nrefine = [0, "one"]', ("line 6: vary.refine", "'one' is text", "an integer")),
        ("[vary]\nrefine = 2", ("line 6: vary.refine", "an array of values")),
        ("[vary]\nrefine = []", ("line 6: vary.refine", "one value or more")),
        ("[vary]\nrefine = [1, 1]", ("line 6: vary.refine", "twice")),
        ('[vary]\nrefine = [1]\n"shell.refine" = [2]', ("shell.refine", "twice")),
        ("[vary]\nranks = [0]", ("line 6: vary.ranks", "an integer >= 1")),
        ('[vary]\n"obstacle.0.friction" = [0.1]', ("line 6: vary.obstacle.0.friction", "no [[obstacle]]")),
        ("", ("nothing to compare", "[vary] or [[case]]")),
        ('[[case]]\nname = "a"\nset = { "shell.modl" = "koiter" }', ("case.0.set.shell.modl", '"model"')),
        ('[[case]]\nname = "a"\nset = {}\n[[case]]\nname = "a"\nset = {}', ("case.1.name", "twice")),
        (
            '[[point]]\nname = "p"\nselect = { box = [[5,5,5],[6,6,6]] }\n[vary]\nrefine=[0]',
            ("point.0.select", "selects no"),
        ),
        (
            '[[point]]\nname = "p"\nselect = { all = true }\nof = "velocity"\n[vary]\nrefine=[0]',
            ("point.0.of", "dynamics"),
        ),
        (
            '[[point]]\nname = "p"\nselect = { all = true }\nof = "reaction"\n[vary]\nrefine=[0]',
            ("point.0.of", "obstacle"),
        ),
        (
            '[[point]]\nname = "energy"\nselect = { all = true }\n[vary]\nrefine=[0]',
            ("point.0.name", '"energy" is a figure', "another name"),
        ),
        ("[varry]\nrefine = [0]", ("varry", "unknown key", '"vary"')),
    ],
)
def test_bad_studies(text, words, study, tmp_path):
    path = study(HEAD + f'measure = "energy"\nreference = 1.0\n{text}\n'.replace("repeats = 1\n", ""))
    path.write_text(path.read_text().replace("repeats = 1\n", ""))
    refused(voile("study", path, "-o", tmp_path / "out"), *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ('measure = "energy"', ('"reference" is missing', "extrapolate")),
        ('measure = "energy"\nreference = "finest"', ("study.reference", "extrapolate")),
        ('measure = "energy"\nreference = "extrapolate"', ("study.reference", "three meshes")),
        ('measure = "energy"\nreference = { refin = 4 }', ("study.reference.refin", "no scene has")),
        (
            'measure = "energy"\nreference = { value = { energi = 1.0 } }',
            ("study.reference", '"energi" is no measure'),
        ),
        ('measure = ["energy", "dofs"]\nreference = 1.0', ("study.reference", "one value for 2 measures")),
        (
            'measure = "tip"\nreference = 1.0',
            ("line 3: study.measure", 'no run has "tip"', "max_displacement"),
        ),
        (
            'measure = "supports.1.force.2"\nreference = 1.0',
            ("study.measure", "has 1 [[fix]]", "supports.0 to supports.0"),
        ),
        ('measure = "sections.0.force.2"\nreference = 1.0', ("study.measure", "has 0 [[section]]")),
        ('measure = "contact.activ"\nreference = 1.0', ("study.measure", '"contact.active"')),
        ('measure = "dynamics.time"\nreference = 1.0', ("study.measure", "no run has")),
        ("measure = []\nreference = 1.0", ("study.measure", "length 0")),
        ('measure = "energy"\nreference = 1.0\naccuracy = [0.0]', ("study.accuracy", "> 0")),
        ('measure = "energy"\nreference = 1.0\nrepeats = 0', ("study.repeats", ">= 1")),
    ],
)
def test_bad_heads(head, words, study, tmp_path):
    path = study(f'[study]\nscene = "scene.toml"\n{head}\n[vary]\nrefine = [0, 1]\n')
    refused(voile("study", path, "-o", tmp_path / "out"), *words)


def test_forces_of_supports_are_measures(study, tmp_path):
    path = study(
        HEAD + 'measure = "supports.0.force.2"\nreference = 8.333333333333333e-5\n[vary]\nrefine = [0]\n'
    )
    (only,) = done(path, tmp_path / "out")["runs"]
    assert only["error"] < 1e-7  # the clamp carries the weight
    path.write_text(path.read_text().replace("supports", "support"))
    refused(voile("study", path, "-o", tmp_path / "out"), 'no run has "support.0.force.2"', "supports.*")


def test_tables_of_other_tasks_change_nothing(study, tmp_path):
    """Time steps of a scene at rest are no variants; lines of rates tell their series, also without a reference."""
    vary = (
        '[vary]\n"dynamics.time_step" = [0.1, 0.2, 0.3]\nrefine = [0, 1]\n"shell.bending" = ["tan", "sin"]\n'
    )
    path = study(f'{HEAD}measure = "energy"\nreference = "extrapolate"\n{vary}')
    run = voile("study", path, "-o", tmp_path / "out")
    assert run.returncode == 0 and "energy over refine (shell.bending=sin)" in run.stdout
    rows = table(tmp_path / "out")
    assert len(rows) == 4 and {row["dynamics.time_step"] for row in rows} == {""}
    assert not any("time step" in row["changes"] for row in rows)


def test_facets_that_refinement_keeps_are_told(study, tmp_path):
    """Of a strip bent to an arc; nothing is said of the flat one, nor where they are rounded."""
    path = study(f'{HEAD}measure = "energy"\nreference = 1.0\n[vary]\nrefine = [0, 1]\n')
    assert "the facets" not in voile("study", path, "-o", tmp_path / "flat").stdout
    points, triangles = generator("strip").strip(length=1.0, width=0.1, size=0.1)
    x, y, z = points.T
    write_obj(tmp_path / "strip.obj", np.column_stack([np.sin(x), y, 1.0 - np.cos(x) + z]), triangles)
    assert "refine keeps the facets" in voile("study", path, "-o", tmp_path / "bent").stdout
    path.write_text(path.read_text() + '"shell.refine_smooth" = [true]\n')
    assert "the facets" not in voile("study", path, "-o", tmp_path / "rounded").stdout


def test_a_measure_that_only_runs_can_tell_is_missing(study, tmp_path):
    path = study(HEAD + 'measure = "smallest_eigenvalue"\nreference = 1.0\n[vary]\nrefine = [0]\n')
    run = voile("study", path, "-o", tmp_path / "out")
    assert run.returncode == 2 and "no run has smallest_eigenvalue; allowed: " in run.stderr.splitlines()[-1]
    assert "energy.bending" in run.stderr


def test_other_bad_input(study, tmp_path):
    path = study(THREE)
    refused(voile("study", tmp_path / "none.toml"), "none.toml: no such file")
    refused(voile("study", path, "-o", tmp_path / "out", "--jobs", "0"), "--jobs 0")
    refused(voile("study", path, "-o", tmp_path / "out", "--run", "4"), "--run 4", "1 to 3")
    (tmp_path / "file").write_text("")
    refused(voile("study", path, "-o", tmp_path / "file"), "cannot be written: Not a directory")
    (tmp_path / "scene.toml").unlink()
    refused(voile("study", path, "-o", tmp_path / "out"), "scene.toml: no such file")


def test_a_friction_problem_over_its_tolerance(tmp_path):
    """The finest run is the reference; only the solver's own seconds count."""
    for name, problem in OWN.items():
        write_rows(tmp_path / "p.h5", *problem)
        (tmp_path / "study.toml").write_text(PROBLEM)
        report = done(tmp_path / "study.toml", tmp_path / name)
        *rows, reference = report["runs"]
        contacts = len(problem.mu)
        assert reference["dofs"] == 3 * contacts
        assert sum(reference["values"][state] for state in ("open", "stick", "slip")) == contacts
        r, _ = solve_friction(*problem, tol=1e-12)
        assert reference["values"]["normal_force"] == pytest.approx(r[::3].sum(), rel=1e-9)
        for row in rows:
            assert row["changes"] == {"iteration": ["tolerance"]}
            assert row["wall_seconds"] < 0.1
        assert rows[1]["trusted_error"] < 1e-3 and rows[0]["trusted_error"] >= rows[1]["trusted_error"]
        assert report["pareto"] and report["recommended"][0]["run"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("normal_force", "tip", 'no friction problem has "tip"; allowed: normal_force'),
        ("tolerance = [1e-2", '"shell.young" = [1.0', "p.h5 has no shell.young; allowed: tolerance"),
        ("[1e-2", "[0.0", "vary.tolerance: 0.0 is not allowed"),
        ("p.h5", "scene.toml", "scene.toml has no tolerance; allowed: keys of scenes"),
        ("[vary]", f"{POINT}[vary]", "a friction problem has no points"),
    ],
)
def test_what_friction_problems_have_not(study, tmp_path, old, new, message):
    write_rows(tmp_path / "p.h5", *OWN["block that slides"])
    spec = PROBLEM.replace(old, new)
    if "scene.toml" in new:
        spec = spec.replace('["normal_force", "friction_force", "open", "stick", "slip"]', '"energy"')
    refused(voile("study", study(spec), "-o", tmp_path / "out"), message)
