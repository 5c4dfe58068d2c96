"""The model "projective": quadratic in Biot's strain and in sines of half the hinge angles."""

import numpy as np
import pytest
import scipy.sparse as sp
from kernel_shell import irregular_mesh
from test_problem import make_shell, sheet

from voile.elastic import evaluate
from voile.problem.problem import Problem
from voile.problem.projective import constant_blocks


@pytest.mark.parametrize("poisson", [0.0, 0.3, -0.4])
def test_its_membrane_is_linear_elasticity_of_biot_strain(poisson):
    """h (mu |F - R|^2 + lambda/2 (s1 + s2 - 2)^2), s1 and s2 the principal stretches."""
    points, triangles = sheet(3, 2)
    rng = np.random.default_rng(1)
    for size in (1e-6, 0.1, 1.0):
        deformation = np.eye(3)[:, :2] + size * rng.normal(size=(3, 2))
        stretch = np.linalg.svd(deformation, compute_uv=False)
        h, young = 1e-3, 1e5
        mu, lam = young / (2 * (1 + poisson)), young * poisson / (1 - poisson**2)
        density = h * (mu * ((stretch - 1) ** 2).sum() + lam / 2 * (stretch.sum() - 2) ** 2)
        given = {"thickness": h, "young": young, "poisson": poisson, "model": "projective"}
        e = evaluate(points, points[:, :2] @ deformation.T, triangles, **given)
        assert e.bending_energy < 1e-20
        assert e.stretching_energy == pytest.approx(0.5 * density, rel=1e-9)  # 1 m by 0.5 m


def test_its_membrane_is_koiters_at_small_strains():
    rest, triangles = irregular_mesh(3)
    rest[:, 2] = 0.0
    given = {"thickness": 1e-2, "young": 1e5, "poisson": 0.25}
    wave = 1e-6 * np.sin(5.0 * rest[:, [1, 0, 1]]) * [1.0, 1.0, 0.0]
    ours, koiter = (
        evaluate(rest, rest + wave, triangles, model=m, **given) for m in ("projective", "koiter")
    )
    assert ours.stretching_energy == pytest.approx(koiter.stretching_energy, rel=1e-4)
    assert np.abs(ours.gradient - koiter.gradient).max() < 1e-4 * np.abs(koiter.gradient).max()


def test_a_bent_strip_has_koiters_bending_energy_to_the_meshs_order():
    """A flat strip rolled to a cylinder of radius R, and a cylinder flattened: D/2 1/R^2 per area."""
    radius, h, young, poisson = 0.4, 1e-3, 1e6, 0.3
    exact = young * h**3 / (24 * (1 - poisson**2)) / radius**2 * 0.5
    errors = []
    for cells in (16, 32, 64):
        flat, triangles = sheet(cells, cells // 2)
        angle = flat[:, 0] / radius
        round_ = np.column_stack([radius * np.sin(angle), flat[:, 1], radius * (1 - np.cos(angle))])
        given = {"thickness": h, "young": young, "poisson": poisson}
        for rest, current in ((flat, round_), (round_, flat)):
            ours = evaluate(rest, current, triangles, model="projective", **given).bending_energy
            average = evaluate(rest, current, triangles, bending="average", **given).bending_energy
            assert ours == pytest.approx(average, rel=4.0 / cells**2)
            errors.append(abs(ours / exact - 1))
    assert max(errors[-2:]) < 0.07 and errors[4] < 0.3 * errors[0]


@pytest.mark.parametrize("poisson", [0.3, -0.3])
def test_the_constant_matrix_bounds_the_hessian(poisson):
    """At a flat rest shape its bending is the Hessian's; thickness of no account for stretching shows it."""
    points, triangles = sheet(6, 4)
    for thickness in (0.05, 1e5):
        one = np.ones(len(triangles))
        given = {"thickness": thickness * one, "young": one, "poisson": poisson * one}
        free = {"fixed": np.zeros_like(points, dtype=bool), "clamped_edges": np.zeros(0, dtype=np.int32)}
        problem = Problem(make_shell(points, triangles, "projective//", **given, **free))
        constant, exact = problem.create_matrix(), problem.create_matrix()
        problem.assemble(constant, constant_blocks(problem.part))
        problem.tangent(problem.create_vector(), exact)
        constant, exact = (sp.csr_matrix(m.getValuesCSR()[::-1]).toarray() for m in (constant, exact))
        assert np.linalg.eigvalsh(constant - exact).min() > -1e-12 * np.abs(constant).max()
    normal = problem.layout.axis == 2
    constant, exact = (m[normal][:, normal] for m in (constant, exact))
    assert np.abs(constant - exact).max() < 1e-8 * np.abs(exact).max()
