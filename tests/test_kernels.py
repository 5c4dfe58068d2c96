"""The elastic kernels: derivatives of every model, invariances, instruction sets, bad input."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp
from kernel_shell import Shell, each_model, irregular_mesh, rates, weave_of

from voile import _kernels
from voile.elastic import evaluate
from voile.errors import InputError
from voile.mesh.grids import grid
from voile.mesh.topology import build_topology


def random_problem(model, seed=1, clamped=False):
    """A shell of several fabrics, partly stretched, partly compressed; returns it, a state, a direction.

    Clamped: three boundary edges, directors held 0.3 from the normal; the direction does not move their ends.
    """
    rest, triangles = irregular_mesh(seed)
    rng = np.random.default_rng(seed + 100)
    current = rest * [1.15, 0.93, 1.0] + 0.02 * rng.normal(size=rest.shape)
    fabric = [base * (1 + 0.5 * rng.random(len(triangles))) for base in (0.1, 2.0, 0.2)]
    clamps, held = [], np.zeros(len(rest), dtype=bool)
    for k, half in enumerate(
        np.flatnonzero(build_topology(triangles).across.ravel() < 0)[[0, 3, 5]] if clamped else ()
    ):
        corner = np.roll(triangles[half // 3], -(half % 3))
        edge, other = current[corner[2]] - current[corner[1]], current[corner[0]] - current[corner[1]]
        normal = np.cross(edge, other) / np.linalg.norm(np.cross(edge, other))
        conormal = np.cross(edge, normal) / np.linalg.norm(edge)
        frame = (normal, conormal) if k < 2 else (conormal, -normal)
        clamps.append((half, k == 2, np.cos(0.3) * frame[0] + np.sin(0.3) * frame[1]))
        held[corner[1:]] = True
    shell = Shell(model, rest, triangles, *fabric, clamps=clamps)
    z = np.concatenate([current.ravel(), 0.2 * rng.normal(size=shell.size - rest.size)])
    direction = rng.normal(size=shell.size)
    direction[: rest.size].reshape(-1, 3)[held] = 0.0
    return shell, z, direction / np.linalg.norm(direction)


@each_model
@pytest.mark.parametrize("clamped", [False, True], ids=["free", "clamped"])
def test_taylor(model, clamped):
    shell, z, d = random_problem(model, clamped=clamped)
    e, g, h = shell.energy(z), shell.gradient(z), shell.hessian(z)
    assert abs(h - h.T).max() < 1e-13 * abs(h).max()
    assert min(rates(lambda s: shell.energy(z + s * d) - e - s * g @ d, 1e-3)) > 1.9
    assert min(rates(lambda s: shell.energy(z + s * d) - e - s * g @ d - s * s / 2 * d @ h @ d, 2e-3)) > 2.9
    assert min(rates(lambda s: shell.gradient(z + s * d) - g - s * h @ d, 2e-4)) > 1.95


@each_model
def test_energy_and_gradient_agree_on_the_energy(model):
    shell, z, _ = random_problem(model)
    u, phi = shell.state(z)
    split = shell.kernel.gradient(u, phi, np.zeros_like(u), np.zeros_like(phi))
    assert split == pytest.approx(shell.kernel.energy(u, phi), rel=1e-14)
    assert split[0] > 0 and (split[1] > 0) == (model[0] != "membrane")


@each_model
def test_taylor_of_rest_shape_and_parameters(model):
    rest, triangles = irregular_mesh(2)
    rng = np.random.default_rng(3)
    current = rest * [1.1, 0.95, 1.0] + 0.02 * rng.normal(size=rest.shape)
    m, edges = len(triangles), len(build_topology(triangles).edges)
    fabric = {
        name: base * (1 + 0.5 * rng.random(m))
        for name, base in (("thickness", 0.1), ("young", 2.0), ("poisson", 0.2))
    }
    angles = 0.2 * rng.normal(size=edges) if model[0] == "koiter" and model[1] != "average" else None
    names = dict(zip(("model", "bending", "material"), model, strict=True))

    def of(rest=rest, mixed=False, **changed):
        return evaluate(
            rest, current, triangles, edge_angles=angles, mixed=mixed, **names, **{**fabric, **changed}
        )

    def force(e):
        return np.concatenate([e.gradient.ravel(), e.edge_gradient])

    e = of(mixed=True)
    step = 1e-3 if model[2] != "tension-field" else 1e-4
    d = rng.normal(size=rest.shape)
    change = e.mixed @ d.ravel()
    assert min(rates(lambda s: force(of(rest + s * d)) - force(e) - s * change, step)) > 1.95
    for name, value in fabric.items():
        d = value * rng.normal(size=m)
        slope, change = e.parameters[name] @ d, e.mixed_parameters[name] @ d
        linear = name == "young" or (model[0] == "membrane" and name == "thickness")
        for f, rate in (
            (lambda s: of(**{name: value + s * d}).energy - e.energy - s * slope, 1.9),  # noqa: B023
            (lambda s: force(of(**{name: value + s * d})) - force(e) - s * change, 1.9),  # noqa: B023
        ):
            if linear:
                assert np.linalg.norm(f(0.01)) < 1e-13 * np.linalg.norm(force(e))
            else:
                assert min(rates(f, 0.02)) > rate


@each_model
def test_mixed_derivative_along_a_rate(model):
    shell, z, _ = random_problem(model)
    rate = np.random.default_rng(5).normal(size=(len(shell.triangles), 6))
    expected = np.einsum("ti,tij->tj", rate, shell.kernel.mixed(*shell.state(z))[0])
    along = shell.kernel.mixed_along(*shell.state(z), rate)
    assert abs(along - expected).max() < 1e-13 * abs(expected).max()


@each_model
def test_safe_hessian(model):
    shell, z, _ = random_problem(model)
    safe = shell.hessian(z, "safe").toarray()
    assert abs(safe - safe.T).max() < 1e-13 * abs(safe).max()
    low, high = np.linalg.eigvalsh(safe)[[0, -1]]
    assert low > -1e-12 * high
    # Equal to the exact one where nothing is stressed, and different where much is compressed.
    at_rest = np.concatenate([shell.rest.ravel(), np.zeros(shell.size - shell.rest.size)])
    exact = shell.hessian(at_rest)
    assert abs(shell.hessian(at_rest, "safe") - exact).max() < 1e-11 * abs(exact).max()
    # A tension field alone is convex: what its stress bears is positive semidefinite as it is.
    apart = abs(safe - shell.hessian(z)).max() / high
    assert apart < 1e-14 if model[0] == "membrane" and model[2] == "tension-field" else apart > 1e-3


def test_a_membrane_couples_neighbours_only():
    shell, _, _ = random_problem(("membrane", "tan", "stvk"))
    assert len(shell.column) == 9 * (len(shell.rest) + 2 * len(shell.topology.edges))


def rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


@each_model
def test_rigid_motion(model):
    shell, z, _ = random_problem(model)
    n = shell.rest.size
    turn, shift = rotation(5), [0.7, -1.1, 0.4]

    def moved(points):
        return np.concatenate([(points.reshape(-1, 3) @ turn.T + shift).ravel(), z[n:]])

    e, scale = shell.energy(z), np.abs(shell.gradient(z)).max()
    assert abs(shell.energy(moved(z[:n])) - e) < 1e-12 * e
    force, turned = (shell.gradient(x)[:n].reshape(-1, 3) for x in (z, moved(z[:n])))
    assert np.abs(turned - force @ turn.T).max() < 1e-12 * scale
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * scale
    torque = np.cross(z[:n].reshape(-1, 3), force).sum(axis=0)
    assert np.abs(torque).max() < 1e-13 * scale
    rest = np.concatenate([shell.rest.ravel(), np.zeros(shell.size - n)])
    assert shell.energy(rest) < 1e-30 and np.abs(shell.gradient(rest)).max() < 1e-15  # against 1e-2 and 1e-1
    z[n:] = 0.0
    assert shell.energy(moved(shell.rest)) < 1e-28 and np.abs(shell.gradient(moved(shell.rest))).max() < 1e-13


@each_model
def test_new_rest_shape_in_place(model):
    """Inverse design moves the rest shape of a kernel that has its fabric already."""
    shell, z, _ = random_problem(model)
    rest = shell.rest * [1.05, 0.98, 1.1]
    shell.kernel.set_rest(rest, shell.triangles, False)
    fabric = [base * np.ones(len(shell.triangles)) for base in (0.1, 2.0, 0.2)]
    shell.kernel.set_fabric(*fabric)
    if model[2] == "orthotropic":
        shell.kernel.set_weave(weave_of(rest, shell.triangles, *fabric[:2]))
    energy, gradient = shell.energy(z), shell.gradient(z)
    shell.kernel.set_rest(shell.rest, shell.triangles, False)
    assert abs(shell.energy(z) - energy) > 1e-3 * energy
    shell.kernel.set_rest(rest, shell.triangles, False)
    assert shell.energy(z) == energy and np.array_equal(shell.gradient(z), gradient)
    fresh = Shell(model, rest, shell.triangles, *fabric)
    assert fresh.energy(z) == pytest.approx(energy, rel=1e-12)


ISA_SCRIPT = """
import json, sys
sys.path.insert(0, sys.argv[1])
import numpy as np
import kernel_shell, test_kernels as t
from voile import _kernels
result = {"isa": _kernels.instruction_set()}
for model in kernel_shell.ALL_MODELS:
    shell, z, d = t.random_problem(model, clamped=True)
    z[shell.rest.size :: 5] += 2 * np.pi
    values = [shell.energy(z), *shell.gradient(z), *(shell.hessian(z) @ d), *(shell.hessian(z, "safe") @ d)]
    result["-".join(model)] = values
print(json.dumps(result))
"""


def test_instruction_sets_agree():
    results = {}
    for isa in ("baseline", "avx2", "avx512"):
        run = subprocess.run(
            [sys.executable, "-c", ISA_SCRIPT, os.path.dirname(__file__)],
            env={**os.environ, "VOILE_ISA": isa, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
        )
        if f"VOILE_ISA={isa} is not available" in run.stderr:
            continue
        assert run.returncode == 0, run.stderr
        results[isa] = json.loads(run.stdout)
        assert results[isa].pop("isa") == isa
    assert "baseline" in results
    for isa, values in results.items():
        for model, value in values.items():
            expected = np.array(results["baseline"][model])
            assert np.abs(value - expected).max() < 1e-10 * np.abs(expected).max(), (isa, model)


def test_director_angles_of_any_size():
    """The kernels' own sine and cosine: a director turned by whole turns is the same director."""
    shell, z, _ = random_problem(("koiter", "sin", "stvk"))
    n = shell.rest.size
    turns = np.random.default_rng(14).integers(-3, 4, size=shell.size - n)
    for factor, tolerance in ((1, 1e-13), (1000, 1e-11), (100_000, 1e-9)):
        turned = np.concatenate([z[:n], z[n:] + 2 * np.pi * factor * turns])
        assert shell.energy(turned) == pytest.approx(shell.energy(z), rel=tolerance)


TWO = np.array([[0, 1, 2], [2, 1, 3]])
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
BAD_INPUT = [
    ({"rest": POINTS[:, :2]}, "rest has shape"),
    ({"current": POINTS[:3]}, "current"),
    ({"current": POINTS * np.nan}, "current: vertex 0 is not finite"),
    ({"triangles": TWO[:, :2]}, "triangles have shape"),
    ({"triangles": TWO[:0]}, "triangles have shape"),
    ({"triangles": TWO + 1}, "outside 0..3"),
    ({"triangles": TWO[:, ::1] * 0 - 1}, "outside 0..3"),
    ({"triangles": np.array([[0, 1, 2], [1, 2, 3]])}, "opposite orientation"),
    ({"triangles": np.array([[0, 1, 2], [2, 1, 3], [1, 2, 0]])}, "more than two triangles"),
    ({"triangles": np.array(TWO) + 0.5}, "triangles are not all integers"),
    ({"triangles": np.array(TWO) + 2**32}, "triangles are not all integers"),
    ({"thickness": 0.0}, "thickness"),
    ({"thickness": [1e-3, -1e-3]}, "thickness"),
    ({"thickness": [1e-3] * 3}, "thickness has shape"),
    ({"young": np.nan}, "young"),
    ({"poisson": 0.5}, "poisson"),
    ({"poisson": -1.0}, "poisson"),
    ({"bending": "cubic"}, "bending = 'cubic' is not known; allowed: average, sin, tan, theta"),
    ({"material": "steel"}, "material = 'steel'"),
    ({"model": "reissner"}, "model = 'reissner'"),
    ({"edge_angles": np.zeros(4)}, "edge_angles have shape"),
    ({"edge_angles": np.ones(5), "bending": "average"}, "no director angles"),
]


@pytest.mark.parametrize(
    ("changed", "message"), BAD_INPUT, ids=[f"{i}-{m}" for i, (_, m) in enumerate(BAD_INPUT)]
)
def test_bad_input(changed, message):
    arguments = {
        "rest": POINTS,
        "current": POINTS,
        "triangles": TWO,
        "thickness": 1e-3,
        "young": 1e5,
        "poisson": 0.3,
    }
    evaluate(**arguments)
    with pytest.raises(InputError, match=message.replace(".", r"\.")):
        evaluate(**{**arguments, **changed})


@pytest.mark.parametrize("model", [("koiter", "tan", "stvk"), ("membrane", "tan", "neo-hookean")])
def test_threads_change_no_digit_of_the_hessian(model):
    """Each thread has rows of its own, and adds to them in the order of the triangles."""
    rng = np.random.default_rng(3)
    flat, triangles = grid(80, 70)
    points = np.column_stack([flat, np.zeros(len(flat))])
    shell = Shell(model, points, triangles)
    noise = 0.002 * rng.normal(size=shell.size)
    noise[: points.size] += points.ravel()
    state = shell.state(noise)
    tied, between = 3 * 4000, (3 * 20, 3 * 5000)  # a vertex at the mean of two, one of another thread
    matrix = sp.identity(shell.size, format="lil")
    for axis in range(3):
        matrix[tied + axis, tied + axis] = 0.0
        matrix[tied + axis, [vertex + axis for vertex in between]] = 0.5
    constraint = matrix.tocsr()
    constraint.eliminate_zeros()
    dofs = points.size + len(shell.topology.edges)
    start = np.r_[constraint.indptr, np.full(dofs - shell.size, constraint.nnz)].astype(np.int32)
    found = []
    for threads in (1, 2, 5):
        scatter = _kernels.Scatter(
            shell.kernel,
            shell.kernel.directors,
            shell.size,
            start,
            constraint.indices,
            constraint.data,
            threads,
        )
        row, column = scatter.pattern(np.arange(shell.size))
        row, values = row.astype(np.int32), np.full(len(column), np.nan)
        none, nothing = np.zeros(0, dtype=np.int32), np.zeros(0)
        scatter.bind(row, column, values, none, none, nothing, none)
        shell.kernel.hessian(*state, "safe", scatter)
        found.append(values)
    full = shell.hessian(noise, "safe")
    expected = constraint.T @ full @ constraint
    error = sp.csr_matrix((found[0], column, row), shape=expected.shape) - expected
    assert abs(error).max() < 1e-13 * abs(expected).max()
    assert (found[0] == found[1]).all() and (found[0] == found[2]).all()
