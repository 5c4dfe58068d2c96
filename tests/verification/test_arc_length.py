"""Paths through limit points and onto bifurcated branches, against published curves, closed forms, a boundary value
problem, and the load path that prescribed displacements find."""

import json
from dataclasses import replace

import numpy as np
import pytest
import roofs
from mpi4py import MPI
from shapes import standing_strip
from shells import pulled_cylinder
from vibrating import own_weight

import voile
from voile.contact.obstacles import Cylinder
from voile.problem.contact import contact_fields, with_obstacles
from voile.problem.problem import Problem
from voile.solver.path import StaticsOptions, require
from voile.solver.statics import solve_statics
from voile.solver.stepping.arc_length import solve_arc
from voile.validate.shells import mapped


def critical(path):
    """Its limit points and bifurcations."""
    return path.found_by("limit point", "bifurcation")


class Curve:
    """A path to the full load: load factors and displacements (steps, 3) of some vertices; `found` what is critical."""

    def __init__(self, shell, vertices, load_steps=None, branch=0):
        self.problem = problem = Problem(shell, MPI.COMM_SELF)
        places = [int(np.flatnonzero(problem.part.vertex == v)[0]) for v in vertices]
        factors, moved = [], []

        def note(step, y):
            factors.append(step.factor)
            moved.append(problem.local(y)[0].reshape(-1, 3)[places])

        options = StaticsOptions(load_steps=load_steps)
        self.path = solve_arc(problem, options, 1.0, branch, note)
        self.found = critical(self.path)
        require(self.path)
        self.factors, self.moved = np.array(factors), np.array(moved)

    def limits(self):
        """Load factors and displacements along the load."""
        found = [(c.factor, c.displacement) for c in self.found if c.method == "limit point"]
        return np.array(found).reshape(-1, 2)


# ---- the hinged roof ----


@pytest.mark.parametrize(
    ("thickness", "load", "displacement", "finest"),
    [
        (12.7, 2226.3, 11.293, 24),
        pytest.param(6.35, 585.9, 12.892, 28, marks=pytest.mark.slow),
    ],  # Sze, Liu & Lo 2004, at their first limit points
)
def test_hinged_roof(thickness, load, displacement, finest):
    limits = []
    for n in (finest // 4, finest // 2, finest):
        shell, middle = roofs.hinged_roof(n, n, thickness, 3000.0)
        curve = Curve(shell, [middle])
        limits.append(curve.limits()[:, 0] * 3000.0)
        assert [c.method for c in curve.found] == ["limit point", "limit point"]
    assert abs(limits[-1][0] / load - 1.0) < 0.005
    assert abs(curve.limits()[0, 1] / displacement - 1.0) < 0.06  # the top is flat
    # order 2 in the mesh: differences fall fourfold
    change = np.abs(np.diff(limits, axis=0))
    assert (change[0] / change[1] > 3.0).all()


def test_the_roofs_path_is_that_of_prescribed_displacements():
    shell, middle = roofs.hinged_roof(8, 8, 12.7, 3000.0)
    curve = Curve(shell, [middle], load_steps=40)
    down = -curve.moved[:, 0, 2]
    assert (np.diff(down) > 0.0).all()  # no snap-back at this thickness
    fixed, motion = shell.fixed.copy(), np.zeros_like(shell.points)
    fixed[middle, 2], motion[middle, 2] = True, -28.0
    pushed = replace(shell, fixed=fixed, motion=motion, force=None)
    problem = Problem(pushed, MPI.COMM_SELF)
    place, found = int(np.flatnonzero(problem.part.vertex == middle)[0]), []

    def note(step, y):
        found.append((28.0 * step.factor, -4.0 * problem.at(step.factor).reactions(y)[place, 2] / 3000.0))

    require(solve_statics(problem, StaticsOptions(load_steps=28, stability=False), on_step=note))
    at, factors = np.array(found).T
    np.testing.assert_allclose(np.interp(at, down, curve.factors), factors, atol=0.004)


def test_snap_back():
    """At half the thickness the middle moves back while the load falls, and the path goes below zero."""
    shell, middle = roofs.hinged_roof(12, 12, 6.35, 3000.0)
    curve = Curve(shell, [middle])
    down = -curve.moved[:, 0, 2]
    assert (np.diff(down) < 0.0).any() and curve.factors.min() < 0.0
    assert len(curve.limits()) == 2 and curve.path.stable
    # what lies between the limit points is not stable
    negative = np.array([step.negative for step in curve.path.steps])
    first, last = (next(k for k, f in enumerate(curve.factors) if f == t) for t in curve.limits()[:, 0])
    assert (negative[first + 1 : last] == 1).all()
    assert (negative[:first] == 0).all() and (negative[last + 1 :] == 0).all()


# ---- others ----


def test_dome_under_pressure():
    sags = np.linspace(0.1, 1.5, 57)
    curve = roofs.dome_path(sags)
    top, bottom = curve[:20].max(), curve[20:].min()
    found = []
    for size in (0.14, 0.07):
        shell = roofs.clamped_dome(size, 1.5)
        path = solve_arc(Problem(shell, MPI.COMM_SELF), StaticsOptions(), 1.0, 0)
        require(path)
        found.append([1.5 * c.factor for c in critical(path)])
        assert [c.method for c in critical(path)] == ["limit point", "limit point"]
    error = np.abs(np.array(found) / [top, bottom] - 1.0)
    assert error[-1].max() < 0.004
    assert (error[0] > 2.0 * error[-1]).all()


@pytest.mark.parametrize(
    ("lam", "poisson", "kind", "published", "bound", "sizes"),
    [
        pytest.param(4.0, 0.3, "limit point", 0.563, 5e-3, (0.14, 0.08), marks=pytest.mark.slow),
        (6.0, 1.0 / 3.0, "bifurcation", 0.775, 0.015, (0.1, 0.06)),
    ],
)
def test_dome_under_pressure_as_published(lam, poisson, kind, published, bound, sizes):
    """Over the classical pressure: Teng & Rotter 1989, Comput. Struct. 31, 211-233 (axisymmetric snap); Huang 1964, J.
    Appl. Mech. 31, 447-457 (to two waves round); both as tabulated in the examples of AQUINAS-FE."""
    off = []
    for size in sizes:
        problem = Problem(roofs.clamped_dome(size, 1.0, lam, poisson), MPI.COMM_SELF)
        first = critical(solve_arc(problem, StaticsOptions(), 0.85, 0))[0]
        assert first.method == kind
        off.append(abs(first.factor / published - 1.0))
    assert off[1] < bound and off[1] < 0.7 * off[0]


def test_cylinder_pull_out(shared):
    """Sze, Liu & Lo's whole curve, whose kink their loads in steps of 2.5 to 5 % pass."""
    table = json.loads((shared / "reference" / "sze-2004.json").read_text())["open_cylinder_pull_out"]
    shell, a, b, c = pulled_cylinder(36, 24, "crossed")
    curve = Curve(shell, [a, b, c], load_steps=40)
    assert all(0.5 < factor < 0.56 for factor in curve.limits()[:, 0])  # where the curve has its kink
    rising = curve.factors >= np.maximum.accumulate(curve.factors)
    ours = [curve.moved[:, 0, 0], -curve.moved[:, 1, 1], -curve.moved[:, 2, 1]]
    factors, *published = np.array(table["rows"]).T
    for mine, theirs in zip(ours, published, strict=True):
        away = np.abs(factors - 0.525) > 0.026  # of the kink, past which both curves bend sharply
        difference = np.abs(np.interp(factors, curve.factors[rising], mine[rising]) - theirs)[away]
        assert difference.max() < 0.06 and np.median(difference) < 0.02


def test_the_toggle_is_that_of_beam_columns():
    """Both limit points and the curve between: 33.924 and 31.328 lb."""
    deflections, loads = roofs.toggle_path().T
    kinks = np.flatnonzero(np.diff(np.sign(np.diff(loads)))) + 1
    assert loads[kinks] == pytest.approx([33.924, 31.328], abs=1e-3)
    found = []
    for n in (15, 30, 60):
        shell, middle = roofs.toggle(n, 40.0)
        curve = Curve(shell, [middle], load_steps=40)
        found.append(40.0 * curve.limits()[:, 0])
    np.testing.assert_allclose(found[-1], loads[kinks], rtol=2e-3)
    # order 2 in the mesh
    assert (np.abs(found[0] - found[1]) / np.abs(found[1] - found[2]))[1] > 3.0
    computed = 40.0 * curve.factors
    exact = np.interp(-curve.moved[:, 0, 2], deflections, loads)
    np.testing.assert_allclose(computed, exact, atol=0.1)


def test_the_toggle_comes_down_on_a_rod():
    """A rod under its middle stops it behind the first limit point: the load, which fell, rises, and the rod takes what
    the toggle does not."""
    load, stop = 36.0, 0.15
    shell, middle = roofs.toggle(15, load)
    free = Curve(replace(shell, force=shell.force * 40.0 / load), [middle], load_steps=40)
    carried = 40.0 * np.interp(roofs.TOGGLE[1] - stop, -free.moved[:, 0, 2], free.factors)
    rod = Cylinder(
        center=np.array([shell.points[middle, 0], 0.0, stop - 0.5]),
        axis=np.array([0.0, 1.0, 0.0]),
        radius=0.5,
    )
    on_rod = with_obstacles(Problem(shell, MPI.COMM_SELF), [rod], 0.0)
    path = solve_arc(on_rod, StaticsOptions(load_steps=20), 1.0, 0)
    found = critical(path)
    require(path)
    assert [c.method for c in found] == ["limit point", "limit point"]
    assert load * found[0].factor == pytest.approx(free.limits()[0, 0] * 40.0, rel=1e-6)
    assert load * found[1].factor == pytest.approx(carried, rel=1e-3)
    taken = 2.0 * contact_fields(on_rod, path.state)["reaction"][:, 2].sum()
    assert taken == pytest.approx(load - carried, abs=0.03)


@pytest.mark.parametrize(("rise", "stop"), [(0.01, -0.005), (0.02, -0.005)])
def test_an_arch_snaps_onto_a_plane(rise, stop):
    """Its middle, a line of vertices that touches at once, comes down, the lower one past where it carries anything:
    the load turns round there, and the plane takes what the arch does not. The touch is no bifurcation."""
    u, v, triangles, side = mapped(40, 2, "crossed")
    points, middle = np.column_stack([u, 0.05 * v, rise * np.sin(np.pi * u)]), np.abs(u - 0.5) < 1e-9
    scene = {
        "shell": {"mesh": (points, triangles), "young": 1e9, "poisson": 0.0, "thickness": 2e-3}
        | {"density": 1.0},
        "loads": {
            "gravity": [0.0, 0.0, 0.0],
            "force": [{"select": {"nodes": np.flatnonzero(middle).tolist()}, "value": [0.0, 0.0, -1.0]}],
        },
        "fix": [
            {"select": {"nodes": np.flatnonzero(side.u0 | side.u1).tolist()}},
            {"select": {"all": True}, "axes": "y"},
        ],
        "obstacle": [{"shape": "plane", "point": [0.0, 0.0, stop], "normal": [0.0, 0.0, 1.0]}],
        "contact": {"offset": 0.0},
        "statics": {"control": "arc-length"},
    }
    summary = voile.run(scene).summary
    top, touch = summary["limit_points"]
    assert len(summary["bifurcations"]) == 1
    assert summary["bifurcations"][0]["load_factor"] < top["load_factor"]
    assert touch["displacement"] == pytest.approx(rise - stop, abs=1e-5)
    assert summary["contact"]["active"] == middle.sum()
    assert summary["contact"]["obstacles"][0]["force"][2] == pytest.approx(
        1.0 - touch["load_factor"], abs=2e-4
    )


@pytest.mark.parametrize("n", [40, 80])
def test_a_column_bifurcates_onto_its_elastica(n):
    shell = roofs.pinned_strip(n, 1.2)
    straight = Curve(shell, [])
    (point,) = straight.found
    assert point.method == "bifurcation" and abs(1.2 * point.factor - 1.0) < 2.2 / n**2
    assert straight.path.steps[-1].negative == 1 and straight.path.stable is False
    middle = int(np.flatnonzero(np.abs(shell.points[:, 0] - 0.5) < 1e-9)[0])
    bent = Curve(shell, [middle], load_steps=200, branch=1)
    assert bent.path.stable and bent.path.steps[-1].negative == 0
    loads, sag = 1.2 * bent.factors, np.abs(bent.moved[:, 0, 2])
    for angle in np.radians([20.0, 40.0, 60.0]):
        load, deflection = roofs.elastica(angle)
        assert abs(np.interp(deflection, sag, loads) / load - 1.0) < 0.003


def test_a_strip_on_edge_buckles_sideways():
    """The bifurcation is the load of linear buckling, but for the bending before; its branch is the shape that statics
    find, which may lean to the other side."""
    width, load = 0.1, 1.5
    shell, _ = standing_strip(load, width, 40, 4)
    linear = own_weight(width, 50.0, 40, 4, 0.0) / (12.85376 * np.sqrt(2.0))
    problem = Problem(shell, MPI.COMM_SELF)
    path = solve_arc(problem, StaticsOptions(), 1.0, 1)
    (point,) = critical(path)
    assert require(path).stable and point.method == "bifurcation"
    assert abs(load * point.factor / linear - 1.0) < 0.003
    leaning = np.abs(problem.local(path.state)[0])
    other = Problem(shell, MPI.COMM_SELF)
    bent = np.abs(other.local(require(solve_statics(other)).state)[0])
    np.testing.assert_allclose(leaning, bent, rtol=0, atol=1e-6)


def test_the_branch_of_a_shallow_arch_is_closed():
    """Pinned, under a load like its shape: its sideways branch leaves at rise^2 - a^2 = 4, a^2 = 5, where the load is
    rise + 3 a, and comes round; rise and height a over twice the radius of gyration."""
    rise, size, n = 3.0, 0.01, 24
    gyration = size / np.sqrt(12.0)
    u, v, triangles, _ = mapped(n, 2, "crossed")
    points = np.column_stack([u, 0.05 * v, rise * 2.0 * gyration * np.sin(np.pi * u)])
    unit = 1e9 * 0.05 * size**3 / 12.0 * np.pi**4 * 2.0 * gyration / (2 * n)  # N on each line of vertices
    lines = [np.flatnonzero(np.abs(u - k / (2 * n)) < 1e-9) for k in range(2 * n + 1)]
    force = [
        {
            "select": {"nodes": line.tolist()},
            "share": "vertices",
            "value": [0.0, 0.0, -unit * np.sin(np.pi * u[line[0]])],
        }
        for line in lines[1:-1]
    ]
    scene = {
        "shell": {
            "mesh": (points, triangles),
            "young": 1e9,
            "poisson": 0.0,
            "thickness": size,
            "density": 1.0,
        },
        "loads": {"gravity": [0.0, 0.0, 0.0], "force": force},
        "fix": [
            {"select": {"nodes": [*lines[0].tolist(), *lines[-1].tolist()]}},
            {"select": {"all": True}, "axes": "y"},
        ],
        "statics": {"control": "arc-length", "max_load_factor": 15.0, "branch": 1},
    }
    summary = voile.run(scene).summary
    found = [point["load_factor"] for point in summary["bifurcations"]]
    assert found == pytest.approx([rise + 3.0 * a for a in np.sqrt(5.0) * np.array([1, -1, 1])], rel=5e-3)
    assert found[2] == pytest.approx(found[0], rel=1e-4)
    assert "closed" in summary["reason"] and summary["steps"] < 100
