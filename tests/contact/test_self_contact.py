"""A shell against itself: distances and their derivatives, the laws' derivatives, stacks with known forces, loops."""

import time
from pathlib import Path

import ipctk
import numpy as np
import pytest
from mesh_helpers import generator
from protocols import UP, held, plate, shell_of
from test_state import taylor_rates

from voile.cli import main
from voile.contact.candidates import Layers, near_along
from voile.contact.closest import closest_of_edges, closest_to_triangle, direction, hessian
from voile.contact.contact import Contact
from voile.contact.interfaces import SelfContact
from voile.contact.obstacles import Plane
from voile.errors import InputError
from voile.mesh import write_obj
from voile.problem.contact import contact_fields, contact_report, shell_layers, with_obstacles
from voile.problem.problem import Problem
from voile.problem.shell import Shell
from voile.results import read_result, read_summary
from voile.solver.methods import pseudo_transient
from voile.solver.path import StaticsOptions
from voile.solver.statics import solve_statics

OFFSET, YOUNG, DENSITY, GRAVITY = 5e-4, 1e6, 300.0, 9.81


def triangle_place(stencil: np.ndarray) -> np.ndarray:
    """The point of a triangle nearest to a vertex, by a fine search over its points."""
    s, t = np.meshgrid(*[np.linspace(0.0, 1.0, 401)] * 2)
    inside = s + t <= 1.0
    s, t = s[inside][:, None], t[inside][:, None]
    points = (1.0 - s - t) * stencil[1] + s * stencil[2] + t * stencil[3]
    return np.linalg.norm(points - stencil[0], axis=1).min()


def edge_place(stencil: np.ndarray) -> np.ndarray:
    s = np.linspace(0.0, 1.0, 801)[:, None]
    one, other = ((1.0 - s) * stencil[k] + s * stencil[k + 1] for k in (0, 2))
    return np.linalg.norm(one[:, None] - other, axis=2).min()


@pytest.mark.parametrize(
    ("measure", "search"), [(closest_to_triangle, triangle_place), (closest_of_edges, edge_place)]
)
def test_distance_is_the_least(measure, search):
    x = np.random.default_rng(1).normal(size=(12, 4, 3))
    found = measure(x).distance
    inside = np.isfinite(found)
    assert inside.sum() > 3
    assert np.allclose(found[inside], [search(stencil) for stencil in x[inside]], atol=5e-3)


@pytest.mark.parametrize("measure", [closest_to_triangle, closest_of_edges])
def test_gradient_and_curvature_of_a_distance(measure):
    """By Taylor tests, one per kind of closest point (inside, on an edge, at a corner)."""
    rng = np.random.default_rng(2)
    x = rng.normal(size=(400, 4, 3))
    x = x[np.isfinite(measure(x).distance)]
    kinds = measure(x).along.any(axis=1).sum(axis=1) + 3 * (measure(x).weight != 0.0).sum(axis=1)
    assert len(np.unique(kinds)) == (3 if measure is closest_to_triangle else 1)
    for kind in np.unique(kinds):
        z, way = x[kinds == kind][:1], rng.normal(size=(1, 12))
        c = measure(z)
        normal, curvature = direction(c, z), hessian(c, z)
        gradient = (c.weight[:, :, None] * normal[:, None]).reshape(1, 12)

        def distance(y):
            return measure(y.reshape(1, 4, 3)).distance

        def slope(y):
            c = measure(y.reshape(1, 4, 3))
            return (c.weight[:, :, None] * direction(c, y.reshape(1, 4, 3))[:, None]).reshape(1, 12)

        small = 0.03 * way
        y = z.reshape(1, 12)
        assert min(taylor_rates(distance, np.sum(gradient * small), y, small)) > 1.8
        assert min(taylor_rates(slope, np.einsum("pij,pj->pi", curvature, small), y, small)) > 1.8


def two_sheets() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, triangles and edges of two small wavy sheets that touch in places, 2 OFFSET apart on average."""
    rng = np.random.default_rng(3)
    points, triangles = plate(0.01, 0.01, 0.004)
    other = points * 0.8 + np.array([0.0013, 0.0009, 2.0 * OFFSET])
    x = np.concatenate([points, other]) + 0.1 * OFFSET * rng.normal(size=(2 * len(points), 3))
    triangles = np.concatenate([triangles, triangles + len(points)])
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return x, triangles, edges


def pressed_sheets(friction: float) -> tuple[Contact, np.ndarray]:
    """Those sheets with reactions, bounds and planes as after an update, and a place nearby."""
    x, triangles, edges = two_sheets()
    everything = np.ones(len(x), dtype=bool)
    layers = Layers(x, triangles, edges, np.zeros((0, 2), dtype=int), 2.0 * OFFSET, friction)
    itself = SelfContact(layers, lambda rows: rows, np.arange(len(x)), everything, everything)
    contact = Contact([], 0.0, 50.0, everything, everything, 1e-12, itself)
    rng = np.random.default_rng(4)
    contact.begin(x + 0.2 * OFFSET * rng.normal(size=x.shape), 0.0)
    contact.adopt(x, 1.0)
    assert len(contact.history.candidates.code) > 50
    return contact, x + 0.02 * OFFSET * rng.normal(size=x.shape)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_force_and_blocks_derive_from_the_energy(friction):
    contact, x = pressed_sheets(friction)
    direction = 1e-2 * OFFSET * np.random.default_rng(5).normal(size=x.shape)
    force = contact.force(x, 1.0)
    assert np.abs(force).max() > 0.0 and np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()
    assert min(taylor_rates(lambda z: contact.energy(z, 1.0), -np.sum(force * direction), x, direction)) > 1.9
    slope = np.zeros_like(x)
    for vertex, block in contact.blocks(x, 1.0, convex=False):
        moved = np.einsum("pij,pj->pi", block, direction[vertex].reshape(len(vertex), 12))
        np.add.at(slope, vertex, moved.reshape(-1, 4, 3))
    rates = taylor_rates(lambda z: -contact.force(z, 1.0), slope, x, direction)
    assert min(rates) > 1.8
    for _, block in contact.blocks(x, 1.0, convex=True):
        assert np.linalg.eigvalsh(block).min() >= -1e-10 * contact.rho(0)


def test_no_layer_passes_through_another():
    x, triangles, edges = two_sheets()
    layers = Layers(x, triangles, edges, np.zeros((0, 2), dtype=int), 2.0 * OFFSET, 0.0)
    upper = np.arange(len(x)) >= len(x) // 2
    away, through = x.copy(), x.copy()
    away[upper, 2] += 0.01
    through[upper, 2] -= 4.0 * OFFSET
    near = layers.find(x, np.zeros(0, dtype=int))
    assert layers.free_share(x, away, near) == 1.0
    share = layers.free_share(x, through, near)
    assert 0.1 < share < 0.5  # 2 OFFSET of 4 OFFSET, less the waves
    assert (x + share * (through - x))[upper, 2].min() > x[~upper, 2].min()
    far = x + 1e7 * (away - x)  # 1e5 m: no search goes that far
    assert 0.9 < layers.free_share(x, far, near) * 1e5 / np.linalg.norm(np.ptp(x, axis=0)) <= 1.0


def test_a_vertex_in_the_plane_of_a_triangle_takes_no_second():
    """To round-off, on a way of round-off: IPC's search went ten million steps."""
    x = np.array([[0.063, 0.096, 0.005], [0.1, 0.05, 0.005], [0.1, 0.1, 0.005], [0.05, 0.1, 0.005]])
    x[0, 2] += np.spacing(0.005)
    triangles, edges = np.array([[1, 2, 3]]), np.array([[1, 2], [2, 3], [1, 3]])
    layers = Layers(x, triangles, edges, np.zeros((0, 2), dtype=int), 1e-3, 0.0)
    moved = x.copy()
    moved[0] += [-1.1e-16, 1.7e-16, -4.2e-16]
    began = time.process_time()
    assert 0.0 < layers.free_share(x, moved, layers.find(x, np.zeros(0, dtype=int))) <= 1.0
    assert time.process_time() - began < 0.2


def test_what_is_near_along_the_cloth():
    """A chain of edges 1 m long: within 2.5 m are neighbours and their neighbours."""
    edges = np.column_stack([np.arange(5), np.arange(1, 6)])
    pairs = near_along(edges, np.ones(5), 6, 2.5)
    assert sorted((j - i, i) for i, j in pairs.tolist()) == [
        *((1, i) for i in range(5)),
        *((2, i) for i in range(4)),
    ]
    assert len(near_along(edges, np.ones(5), 6, 0.5)) == 0


def stack(friction: float = 0.0, angle: float = 0.0, size: float = 0.125, drag: float = 0.0):
    """Path, problem and the upper vertices of two patches, one on the other on a plane; gravity inclined by angle, or
    the upper patch's edge dragged along x (m) over the lower one, which is held."""
    lower, one = plate(1.0, 1.0, size)
    upper, two = plate(0.6, 0.6, 0.83 * size)
    points = np.concatenate([lower + OFFSET * UP, upper + np.array([0.23, 0.22, 3.0 * OFFSET])])
    above = np.arange(len(points)) >= len(lower)
    fixed, motion = np.zeros(points.shape, dtype=bool), np.zeros_like(points)
    if drag:
        edge = above & (points[:, 0] == points[above, 0].min())
        fixed[~above], fixed[edge, 0], motion[edge, 0] = True, True, drag
        fixed[np.argmax(edge), 1] = True
    elif angle == 0.0:  # what no friction holds
        for part in (np.flatnonzero(~above), np.flatnonzero(above)):
            x, y = points[part, :2].T
            fixed[part[np.argmin(x + y)], :2] = True
            fixed[part[np.argmax(x - y)], 1] = True
    shell = shell_of(
        points, np.concatenate([one, two + len(lower)]), young=YOUNG, thickness=1e-3, density=DENSITY, fixed=fixed,
        motion=motion, gravity=GRAVITY * np.array([np.sin(angle), 0.0, -np.cos(angle)]),
    )  # fmt: skip
    problem = Problem(shell)
    floor = Plane(name="floor", friction=3.0 * np.tan(angle), point=np.zeros(3), normal=UP)
    problem = with_obstacles(problem, [floor], OFFSET, shell_layers(shell, OFFSET, friction))
    steps = 4 if drag else 1
    return solve_statics(problem, StaticsOptions(load_steps=steps)), problem, above


def test_a_patch_rests_on_another():
    path, problem, above = stack()
    assert path.converged and path.stable
    weight = GRAVITY * DENSITY * 1e-3 * np.array([1.0, 0.36])
    force = contact_fields(problem, path.state)["reaction"]
    assert np.abs(force[above].sum(axis=0) - [0.0, 0.0, weight[1]]).max() < 1e-8 * weight[1]
    report = contact_report(problem, path.state)
    assert report["obstacles"][0]["force"][2] == pytest.approx(weight.sum(), rel=1e-8)
    assert report["self_contacts"] > above.sum() and report["friction_error"] < 1e-8
    assert report["max_penetration"] < 1e-12


@pytest.mark.parametrize("angle", [5.0, 20.0, 45.0])
def test_a_patch_sticks_to_another_on_an_incline(angle):
    """At mu = 1.001 tan(angle) nothing drifts."""
    path, problem, above = stack(1.001 * np.tan(np.radians(angle)), np.radians(angle))
    assert path.converged
    report, fields = contact_report(problem, path.state), contact_fields(problem, path.state)
    assert report["stick"] > above.sum() and report["friction_error"] < 1e-8
    assert fields["margin"].min() >= 0.0 and fields["margin"][above].max() < 1.0
    assert np.abs(problem.motion(path.state)).max() < 1e-12


def test_a_patch_slides_off_another(monkeypatch):
    """At mu = 0.999 tan(angle) no equilibrium: it creeps down, however little."""
    monkeypatch.setattr(pseudo_transient, "GONE", 2e-4)  # sizes
    path, _, _ = stack(0.999 * np.tan(np.radians(20.0)), np.radians(20.0))
    assert not path.converged and "it moves along (1.000, " in path.reason
    assert "itself (friction 0.363606)" in path.reason


def test_friction_of_a_dragged_patch():
    """Dragged over half a cell, from triangle to triangle, all slips: mu times its weight against the way."""
    friction = 0.3
    path, problem, above = stack(friction, size=0.25, drag=-0.1)
    assert path.converged
    weight = GRAVITY * DENSITY * 1e-3 * 0.36
    fields = contact_fields(problem, path.state)
    force = fields["reaction"][above].sum(axis=0)
    bears = above & (fields["contact"] > 0)
    assert np.abs(fields["margin"][bears]).max() < 1e-6 and (fields["friction"][bears] == friction).all()
    assert fields["normal_reaction"][above].sum(axis=0) == pytest.approx(
        [0.0, 0.0, weight], abs=1e-8 * weight
    )
    assert force[2] == pytest.approx(weight, rel=1e-8)
    assert force[0] == pytest.approx(friction * weight, rel=1e-6)


def loop_shell() -> tuple[Shell, float]:
    """A ring of a strip, held at its ends, its sides pinched into each other; offset."""
    length, cells, offset = 1.0, 32, 2e-3
    rest, triangles = plate(length, 0.1, length / cells)
    at, radius = rest[:, 0] / length, 0.5 * length / np.pi
    turn = 2.0 * np.pi * (0.97 * at + 0.015)
    points = np.column_stack([radius * np.sin(turn), rest[:, 1], radius * np.cos(turn)])
    ends = (at < 1.5 / cells) | (at > 1.0 - 1.5 / cells)
    sides = [np.abs(at - place) < 0.02 for place in (0.25, 0.75)]
    pinch = [
        (side, np.array([np.copysign(1.5 * offset, x) - x, 0.0, 0.0]))
        for side, x in ((side, points[side, 0].mean()) for side in sides)
    ]
    shell = shell_of(
        points, triangles, rest=rest, young=1e7, thickness=1e-3, density=DENSITY,
        **held(points, (ends, np.zeros(3)), *pinch),
    )  # fmt: skip
    return shell, offset


def loop(self_contact: bool):
    """Path, problem, shell and offset of that ring."""
    shell, offset = loop_shell()
    problem = Problem(shell)
    problem = with_obstacles(problem, [], offset, shell_layers(shell, offset, 0.0) if self_contact else None)
    return solve_statics(problem, StaticsOptions(load_steps=10)), problem, shell, offset


def test_a_pinched_loop_does_not_pass_through_itself():
    path, problem, shell, offset = loop(self_contact=True)
    assert path.converged and path.stable
    report = contact_report(problem, path.state)
    assert report["self_contacts"] > 0 and report["friction_error"] < 1e-8
    least = least_distance(problem.positions(path.state), shell)
    assert least >= 2.0 * offset - 1e-8 * problem.size()
    path, problem, shell, _ = loop(self_contact=False)
    assert least_distance(problem.positions(path.state), shell) < 0.9 * 2.0 * offset


def least_distance(x: np.ndarray, shell) -> float:
    """Of all vertices from all triangles that are not near along the cloth, by brute force."""
    triangles, near = shell.triangles, 0.1
    rest = shell.rest_points
    vertex, triangle = np.meshgrid(np.arange(len(x)), np.arange(len(triangles)), indexing="ij")
    along = np.abs(rest[vertex, 0] - rest[triangles[triangle], 0].mean(axis=-1))
    vertex, triangle = vertex[along > near], triangle[along > near]
    return closest_to_triangle(x[np.column_stack([vertex, triangles[triangle]])]).distance.min()


LOOP = """
[shell]
mesh = "loop.obj"
rest = "strip.obj"
young = 1e7
poisson = 0.0
thickness = 1e-3
density = 300.0
[loads]
gravity = [0.0, 0.0, -9.81]
[contact]
offset = {offset}
self_contact = true
"""


def loop_scene(folder: Path) -> Path:
    """That ring as a scene for the command line."""
    shell, offset = loop_shell()
    write_obj(folder / "loop.obj", shell.points, shell.triangles)
    write_obj(folder / "strip.obj", shell.rest_points, shell.triangles)
    text = LOOP.format(offset=offset)
    for move in np.unique(shell.motion[shell.fixed[:, 0]], axis=0):
        nodes = np.flatnonzero(shell.fixed[:, 0] & (shell.motion == move).all(axis=1))
        text += f"[[fix]]\nselect.nodes = {nodes.tolist()}\nmove.displacement = {move.tolist()}\n"
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


def test_explain_tells_of_self_contact(tmp_path, capsys):
    path = str(loop_scene(tmp_path))
    assert main(["explain", path]) == 0
    told = capsys.readouterr().out
    assert "+ self-contact     mid-surfaces keep 0.004 m" in told
    assert "- friction         friction 0 on itself" in told
    assert main(["explain", path, "--set", "contact.self_contact=false"]) == 0
    assert "- self-contact     contact.self_contact is false" in capsys.readouterr().out


@pytest.mark.mpi
def test_ranks_agree(tmp_path, run_on):
    path = loop_scene(tmp_path)
    path.write_text(path.read_text() + "[statics]\nload_steps = 5\n")
    found = []
    for ranks in (1, 2):
        out = tmp_path / str(ranks)
        run_on(ranks, path, out)
        summary = read_summary(out / "summary.json")
        assert summary["contact"]["self_contacts"] > 0 and "self-contact" in summary["modelled"]
        with read_result(out) as result:
            found.append((result.points(), summary["contact"]))
    (points, contact), (again, other) = found
    assert np.abs(again - points).max() <= 1e-8 * np.linalg.norm(np.ptp(points, axis=0))
    assert other["active"] == contact["active"]


def test_layers_in_the_same_place_are_refused():
    points, triangles = plate(1.0, 1.0, 0.25)
    shell = shell_of(
        np.concatenate([points, points]), np.concatenate([triangles, triangles + len(points)]),
        young=YOUNG, thickness=1e-3, density=DENSITY,
    )  # fmt: skip
    with pytest.raises(InputError, match="start in the same place at vertex"):
        with_obstacles(Problem(shell), [], OFFSET, shell_layers(shell, OFFSET, 0.0))


def test_a_start_through_itself_is_refused():
    points, triangles = plate(1.0, 1.0, 0.25)
    shell = shell_of(
        np.concatenate([points, points[:, [0, 2, 1]] + [0.1071, 0.4013, -0.4717]]),
        np.concatenate([triangles, triangles + 25]),
        young=YOUNG, thickness=1e-3, density=DENSITY,
    )  # fmt: skip
    with pytest.raises(InputError, match="passing through itself"):
        with_obstacles(Problem(shell), [], OFFSET, shell_layers(shell, OFFSET, 0.0))


def test_supports_that_hold_layers_too_near_are_refused():
    shell, offset = loop_shell()
    with pytest.raises(
        InputError, match="supports hold layers of the shell 0.006.* nearer than twice the offset"
    ):
        with_obstacles(Problem(shell), [], 2.0 * offset, shell_layers(shell, 2.0 * offset, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_pleats_stay_untangled(friction):
    """A skirt of deep pleats held at its waist, swung sideways: without self-contact they tangle."""
    points, triangles = generator("pleated_skirt").pleated_skirt()
    shell = shell_of(
        points, triangles, rest=points, flat=False, young=1e5, thickness=0.5e-3, density=DENSITY,
        gravity=np.array([-4.0, -GRAVITY, 0.0]), **held(points, (points[:, 1] > 0.199, np.zeros(3))),
    )  # fmt: skip
    for layers in (shell_layers(shell, 0.8 * OFFSET, friction), None):
        problem = Problem(shell)
        problem = with_obstacles(problem, [], OFFSET, layers)
        path = solve_statics(problem, StaticsOptions(load_steps=1))
        assert path.converged
        x = problem.positions(path.state)
        tangled = ipctk.has_intersections(ipctk.CollisionMesh(x, shell.topology.edges, shell.triangles), x)
        assert tangled == (layers is None)
        if layers:
            report = contact_report(problem, path.state)
            assert report["self_contacts"] > 10 and report["max_penetration"] < 1e-8 * problem.size()
