"""Scenes with absurd values: each ends with a clear message, or works."""

import json

import numpy as np
import pytest

from voile.cli import main
from voile.contact.obstacles import LONGEST, Ellipsoid

SHELL = """
[shell]
mesh = "sheet.obj"
young = {young}
thickness = 1e-3
density = {density}
"""
HELD = "[[fix]]\nselect = { box = [[-0.01, -1, -1], [0.01, 1, 1]] }\nclamp = true\n"
ALL = "[[fix]]\nselect = { all = true }\n"
INVERSE = '[scene]\ntask = "inverse"\n'
CELLS = 6


@pytest.fixture
def voile(tmp_path, capsys):
    """voile(text): runs the scene on a sheet of 0.2 m; exit code, standard error, summary."""
    x, y = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(0.0, 0.2, CELLS + 1)], indexing="ij"))
    first = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)).ravel() + 1
    right, both = first + CELLS + 1, first + CELLS + 2
    faces = [
        f"f {a} {b} {c}"
        for t in ((first, right, both), (first, both, first + 1))
        for a, b, c in zip(*t, strict=True)
    ]
    points = [f"v {a:.17g} {b:.17g} 0" for a, b in zip(x, y, strict=True)]
    (tmp_path / "sheet.obj").write_text("\n".join(points + faces) + "\n")

    def run(text: str):
        (tmp_path / "scene.toml").write_text(text)
        code = main(["run", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out")])
        summary = tmp_path / "out" / "summary.json"
        found = json.loads(summary.read_text()) if summary.exists() else None
        return code, capsys.readouterr().err, found

    return run


@pytest.mark.parametrize("method", ["adjoint", pytest.param("tao", marks=pytest.mark.slow), "direct"])
def test_a_density_that_no_rest_shape_bears(voile, method):
    text = INVERSE + SHELL.format(young=1e6, density=2**31) + HELD + f'[inverse]\nmethod = "{method}"\n'
    code, said, summary = voile(text)
    assert code == 3
    assert "allowed: 0.1 to 10" in said
    assert not summary["converged"] and np.isfinite(summary["smallest_eigenvalue"])


@pytest.mark.parametrize(
    "keys", [{"bending": "average"}, {"model": "membrane"}, {"model": "discrete-shells"}, {}], ids=str
)
def test_supports_that_hold_everything(voile, keys):
    lines = "".join(f'{name} = "{value}"\n' for name, value in keys.items())
    clamp = "" if keys else "clamp = true\n"
    move = "move = { displacement = [0.0, 0.0, 0.1] }\n"
    code, said, _ = voile(SHELL.format(young=1e6, density=300.0) + lines + ALL + clamp + move)
    assert code == 2
    assert "fix holds every vertex and edge; allowed: supports that leave something free" in said


def test_supports_that_leave_the_edges_free(voile):
    code, _, summary = voile(SHELL.format(young=1e6, density=300.0) + ALL)
    assert code == 0 and summary["dofs"] == 3 * CELLS**2 + 2 * CELLS


@pytest.mark.parametrize("radii", [[1e-9, 1.0, 1e9], [1e9, 1e9, 1e-9], [1.0, 2e6, 1.0]])
def test_an_ellipsoid_that_is_a_needle_or_a_leaf(voile, radii):
    body = f'[[obstacle]]\nshape = "ellipsoid"\ncenter = [0.1, 0.1, -0.5]\nradii = {radii}\n'
    code, said, _ = voile(SHELL.format(young=1e6, density=300.0) + HELD + body)
    assert code == 2
    assert f"obstacle.0.radii: {radii}; allowed: the longest at most 1e+06 times the shortest" in said


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_distances_to_the_thinnest_ellipsoids_allowed(size):
    rng = np.random.default_rng(2)
    for radii in size * np.array(
        [[1.0, 1.0, LONGEST], [1.0, LONGEST, LONGEST], [1.0, LONGEST**0.5, LONGEST]]
    ):
        body = Ellipsoid(center=np.zeros(3), radii=radii)
        ball = rng.normal(size=(200, 3))
        ball /= np.linalg.norm(ball, axis=1)[:, None]
        on, normal = ball * radii, ball / radii
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        height = radii.max() * rng.uniform(0.0, 1.0, 200)
        gap, gradient, curvature = body.derivatives(on + height[:, None] * normal)
        assert np.abs(gap - height).max() <= 1e-14 * radii.max()
        assert np.isfinite(gradient).all() and np.isfinite(curvature).all()
        for inside in (0.5 * on, 0.0 * on):
            assert all(np.isfinite(part).all() for part in body.derivatives(inside))


def test_a_seam_allowance_larger_than_the_shell(voile):
    text = INVERSE + SHELL.format(young=1e9, density=300.0) + HELD + "[inverse]\nseam_allowance = 1e200\n"
    code, said, _ = voile(text)
    assert code == 2
    assert "inverse.seam_allowance: 1e+200 m; allowed: at most the shell's size, 0.2828 m" in said


@pytest.mark.mpi
def test_panels_of_a_plane_on_two_ranks(voile, tmp_path, crews):
    """A plane's angle defects depend on its vertices to second order only: their derivative is zero."""
    more = '[inverse]\ndevelopable = "panels"\niterations = 1\n[loads]\ngravity = [0.0, 0.0, -9.81]\n'
    text = INVERSE + SHELL.format(young=1e8, density=300.0) + HELD + more
    (tmp_path / "scene.toml").write_text(text)
    done = crews(2).run("voile", ["run", tmp_path / "scene.toml", "-o", tmp_path / "out"], 120)
    assert done.returncode in (0, 3), done.stderr
    assert (
        "flat panels with a stable equilibrium"
        in json.loads((tmp_path / "out" / "summary.json").read_text())["reason"]
    )
