"""Sheets that meet along one edge: a stiffener on a strip, a pocket on its cloth."""

from itertools import pairwise

import numpy as np
import pytest
from mpi4py import MPI

import voile
from voile.api import modelled
from voile.errors import InputError
from voile.mesh import read_mesh
from voile.mesh.raw import RawMesh
from voile.problem.problem import Problem

LENGTH, WIDTH, DEPTH, THICKNESS, YOUNG, DENSITY = 0.2, 0.04, 0.03, 1e-3, 1e8, 1000.0
NX, NY, NZ = 24, 4, 3
RIM = {"box": [[-1, -1, -1], [1, 1, -DEPTH + 1e-9]]}
ENDS = {"box": [[-1, -1, -1e-9], [1e-9, 1, 1]]}, {"box": [[LENGTH - 1e-9, -1, -1e-9], [1, 1, 1]]}


def tee(turned: bool = False) -> RawMesh:
    """A strip along x with a fin down from its middle line: edges of three triangles; groups strip and fin. turned:
    every other triangle of the fin runs the other way."""
    x, y, z = np.linspace(0, LENGTH, NX + 1), np.linspace(0, WIDTH, NY + 1), np.linspace(0, -DEPTH, NZ + 1)
    points = [(a, b, 0.0) for a in x for b in y] + [(LENGTH / 2, b, c) for c in z[1:] for b in y]
    strip = [[i * (NY + 1) + j for j in range(NY + 1)] for i in range(NX + 1)]
    start = (NX + 1) * (NY + 1)
    fin = [strip[NX // 2]] + [[start + i * (NY + 1) + j for j in range(NY + 1)] for i in range(NZ)]
    triangles = [*_cells(strip), *(t[::-1] if turned and k % 2 else t for k, t in enumerate(_cells(fin)))]
    group = np.repeat([0, 1], [2 * NX * NY, 2 * NZ * NY])
    return RawMesh("tee", np.array(points), np.array(triangles), group, ("strip", "fin"))


def _cells(rows: list[list[int]]) -> list[list[int]]:
    return [
        t
        for one, other in pairwise(rows)
        for (a, b), (c, d) in zip(pairwise(one), pairwise(other), strict=True)
        for t in ([a, c, d], [a, d, b])
    ]


def scene(**more) -> dict:
    shell = {"young": YOUNG, "poisson": 0.0, "thickness": THICKNESS, "density": DENSITY, "joints": True}
    return {"shell": {"mesh": tee(), **shell}, "loads": {"gravity": [0, 0, 0]}, **more}


@pytest.mark.parametrize("turned", [False, True])
def test_the_strip_stays_whole_and_the_fin_is_sewn_to_it(turned):
    surface = read_mesh(tee(turned), joints=True)
    assert len(surface.points) == len(tee().points) + NY + 1
    assert len(surface.stitches) == NY + 1
    assert np.array_equal(surface.points, tee().points[surface.input_vertex])
    strip = np.unique(surface.triangles[surface.group == 0])
    assert len(strip) == (NX + 1) * (NY + 1)  # not cut along the joint
    assert any("more than two" in note for note in surface.notes)


def test_a_load_on_the_fin_bends_the_strip_as_a_beam():
    """Clamped at both ends, pulled at the fin's lower rim: F L^3 / (192 E I) at the joint, and the fin's stretch."""
    force, inertia = 1e-4, WIDTH * THICKNESS**3 / 12.0
    pull = {"gravity": [0, 0, 0], "force": [{"select": RIM, "value": [0, 0, -force]}]}
    fixes = [{"select": end, "clamp": True} for end in ENDS]
    fixes.append({"select": RIM, "axes": "x"})  # else the fin is free to swing
    result = voile.run(scene(loads=pull, fix=fixes))
    down = (result.start - result.positions)[:, 2]
    joint = (np.abs(result.start[:, 0] - LENGTH / 2) < 1e-9) & (result.start[:, 2] == 0.0)
    assert down[joint].mean() == pytest.approx(
        force * LENGTH**3 / (192.0 * YOUNG * inertia), rel=0.04
    )  # 24 cells
    stretch = down[result.start[:, 2] < -DEPTH + 1e-9].mean() - down[joint].mean()
    assert stretch == pytest.approx(force * DEPTH / (YOUNG * WIDTH * THICKNESS), rel=0.02)


def test_a_stiff_joint_bends_the_strip_as_a_frame():
    """A force F across the rim of a fin of depth d: the strip's middle turns by F d L / (16 E I), the joint by
    F d / (k w), the fin bends by F d^3 / (3 E I). Second order; the joint adds its own turn."""
    force, bends = 1e-4, YOUNG * WIDTH * THICKNESS**3 / 12.0
    exact = force * DEPTH**2 * (LENGTH / 16.0 + DEPTH / 3.0) / bends
    own = 0.01  # N m per m and radian
    errors = []
    for refine, stiffness in ((0, 1e6), (1, 1e6), (1, own)):
        tables = scene(
            loads={"gravity": [0, 0, 0], "force": [{"select": RIM, "value": [force, 0, 0]}]},
            fix=[{"select": end, "clamp": True} for end in ENDS],
        )
        tables["shell"] |= {"refine": refine, "joint_stiffness": stiffness}
        result = voile.run(tables)
        moved = (result.positions - result.start)[result.start[:, 2] < -DEPTH + 1e-9, 0].mean()
        more = force * DEPTH**2 / (stiffness * WIDTH)
        errors.append(moved / (exact + more) - 1.0)
        turned = sum(row["moment"][1] for row in result.summary["supports"])
        assert turned == pytest.approx(-force * DEPTH / 2.0, rel=0.03)  # half of what the joint gets
    assert abs(errors[1]) < 0.015 and errors[0] > 3.5 * errors[1] and abs(errors[2]) < 0.005


def test_stiff_joints_springs_and_ties_have_one_potential():
    """Forces are its derivative, the tangent is theirs; a joint does not feel that all turns."""
    everywhere = {"box": [[-1, -1, -1], [1, 1, 1]]}
    tables = scene(
        loads={"gravity": [0, 0, -9.81]},
        spring=[{"select": everywhere, "stiffness": 3.0}],
        tie=[{"nodes": [0, 60], "stiffness": 2.0, "length": 0.02}],
        fix=[{"select": end} for end in ENDS],
    )
    tables["shell"]["joint_stiffness"] = 0.05
    problem = Problem(modelled(voile.load(tables)).shell, MPI.COMM_SELF)
    random, y, along = np.random.default_rng(0), problem.create_vector(), problem.create_vector()
    y.array[:], along.array[:] = 2e-4 * random.normal(size=(2, y.getSize()))
    ends = [y + share * along for share in (-1e-3, 1e-3)]
    force, matrix = [y.duplicate() for _ in range(3)], problem.create_matrix()
    for at, f in zip([*ends, y], force, strict=True):
        problem.residual(at, f)
    problem.tangent(y, matrix)
    slope = (problem.energy(ends[1]) - problem.energy(ends[0])) / 2e-3
    assert slope == pytest.approx(force[2].dot(along), rel=1e-6)
    change = (force[1] - force[0]) * 500.0
    assert (change - matrix * along).norm() < 1e-6 * change.norm()
    weld = problem.springs[-1]
    x = problem.positions(y)[weld.vertices]
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    assert np.abs(weld._turn(x)).max() > 1e-3
    np.testing.assert_allclose(weld._turn(x @ turn), weld._turn(x), atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"joints": False}, "shell.joint_stiffness: allowed above 0 with shell.joints = true"),
        ({"model": "membrane"}, "and a model that bends"),
        ({"joint_stiffness": -1.0}, "shell.joint_stiffness"),
    ],
)
def test_stiffness_without_a_joint_is_refused(keys, said):
    tables = scene()
    tables["shell"] |= {"joint_stiffness": 1.0, **keys}
    with pytest.raises(InputError, match=said):
        voile.load(tables)


@pytest.mark.parametrize("refine", [0, 1])
def test_copies_on_a_joint_count_as_one(refine):
    """The joint by its vertices, with a fin of which some triangles come before the strip's, and by a box: held, loaded
    and pressed alike, by its own length."""
    mesh, line = tee(), NX // 2 * (NY + 1) + np.arange(NY + 1)
    order = np.roll(np.arange(len(mesh.triangles)), NY * NZ)
    mixed = RawMesh("tee", mesh.points, mesh.triangles[order], mesh.group[order], mesh.group_names)
    shells = []
    for select in (
        {"nodes": line.tolist()},
        {"box": [[LENGTH / 2, -1, 0.0], [LENGTH / 2, 1, 0.0]]},
    ):
        tables = scene(
            fix=[{"select": select, "axes": "xy", "clamp": True}, *({"select": end} for end in ENDS)],
            loads={"force": [{"select": select, "value": [0, 0, 1.0], "per": "length"}]},
            mass=[{"select": select, "value": 2.0}],
            band=[{"select": select, "stiffness": 3.0}],
        )
        tables["shell"] |= {"mesh": mixed, "refine": refine}
        shells.append(modelled(voile.load(tables)).shell)
    for shell in shells:
        assert shell.force.sum() == pytest.approx(WIDTH)
        assert np.cross(shell.points, shell.force).sum(axis=0) == pytest.approx(
            [WIDTH**2 / 2, -0.1 * WIDTH, 0]
        )
        assert shell.bars[:, 3].sum() == pytest.approx(WIDTH) and shell.extra_mass.sum() == pytest.approx(2.0)
        assert np.array_equal(shell.fixed, shells[0].fixed)
        assert len(shell.clamped_edges) == 2 * NY * 2**refine


def test_a_cut_through_a_joint_carries_what_is_beyond_it():
    """The fin hangs in the plane of the cut: the wall carries the half of the strip, and no force along it."""
    cut = {"point": [LENGTH / 2, 0, 0], "normal": [1, 0, 0]}
    tables = scene(loads={"gravity": [0, 0, -9.81]}, fix=[{"select": ENDS[0], "clamp": True}], section=[cut])
    tables["shell"]["young"] = 1e13
    found = voile.run(tables).summary["sections"][0]["force"]
    beyond = DENSITY * THICKNESS * WIDTH * LENGTH / 2 * 9.81
    assert np.allclose(found, [0, 0, beyond], rtol=0.0, atol=1e-6 * beyond)


def test_it_falls_as_one_and_lands():
    """In free fall g t^2 / 2; on a plane its reactions are its weight in the end."""
    clock = {"time_step": 0.005, "duration": 0.05, "scheme": "generalized-alpha"}
    free = voile.run(scene(scene={"task": "dynamics"}, dynamics=clock, loads={"gravity": [0, 0, -9.81]}))
    fall = free.positions[:, 2] - free.start[:, 2]
    assert np.allclose(fall, -0.5 * 9.81 * 0.05**2, rtol=1e-6)
    plane = {"shape": "plane", "point": [0, 0, -DEPTH - 1e-3], "normal": [0, 0, 1], "friction": 0.5}
    ends = [{"select": end} for end in ENDS]
    landed = voile.run(scene(obstacle=[plane], fix=ends, loads={"gravity": [0, 0, -9.81]}))
    weight = 9.81 * DENSITY * THICKNESS * (LENGTH + DEPTH) * WIDTH
    table = landed.summary["supports"]
    contact = landed.summary["contact"]
    assert contact["active"] > 0
    held = sum(row["force"][2] for row in table) + contact["obstacles"][0]["force"][2]
    assert held == pytest.approx(weight, rel=1e-6)


@pytest.mark.parametrize("stiffness", [pytest.param(0.0, marks=pytest.mark.slow), 1e-2])
def test_two_ranks_find_the_same_shape(tmp_path, run_on, stiffness):
    mesh = tee()
    lines = ["v " + " ".join(f"{c:.17g}" for c in x) for x in mesh.points]
    for k, name in enumerate(mesh.group_names):
        lines += [
            f"g {name}",
            *("f " + " ".join(str(i + 1) for i in t) for t in mesh.triangles[mesh.group == k]),
        ]
    (tmp_path / "tee.obj").write_text("\n".join(lines) + "\n")
    text = f"[scene]\ntask = 'statics'\n[shell]\nmesh = 'tee.obj'\njoints = true\nyoung = {YOUNG}\nthickness = 1e-3\n"
    text += f"joint_stiffness = {stiffness}\n"
    text += "density = 1000.0\nrefine = 1\n[statics]\nload_steps = 1\n[loads]\ngravity = [1.0, 0, -9.81]\n"
    for end in ENDS:
        text += f"[[fix]]\nselect = {{ box = {end['box']} }}\nclamp = true\n"
    (tmp_path / "scene.toml").write_text(text)
    shapes = []
    for ranks in (1, 2):
        run_on(ranks, tmp_path / "scene.toml", tmp_path / str(ranks))
        shapes.append(voile.read(tmp_path / str(ranks)).positions)
    assert abs(shapes[0] - shapes[1]).max() < 1e-7 * LENGTH
    tip = shapes[0] - voile.read(tmp_path / "1").start
    assert abs(tip).max() > 1e-3 * LENGTH
