"""Real garments of ../shared/meshes, draped through the command line (scripts/garments) to 1e-8 of their weight."""

import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from voile.mesh import read_mesh
from voile.problem.problem import Problem
from voile.results import read_result
from voile.scene import read_scene
from voile.solver.sewing import sew
from voile.wiring import build_model

SCRIPT = Path(__file__).parents[1] / "scripts" / "garments"


@pytest.fixture(scope="module")
def garments():
    sys.path.insert(0, str(SCRIPT.parent))
    loader = SourceFileLoader("garments", str(SCRIPT))
    module = module_from_spec(spec_from_loader("garments", loader))
    loader.exec_module(module)
    return module


def test_panels_are_sewn_though_they_lie_through_each_other(garments, shared, tmp_path):
    """Kept from turning through 180 degrees, the hinges of these 14 panels stopped their sewing at 24 J."""
    shell = build_model(read_scene(garments.write_scene("pleated", tmp_path))).shell
    problem = Problem(sew(shell, MPI.COMM_SELF), MPI.COMM_SELF)
    energies = problem.energies(problem.create_vector())
    assert energies["stretching"] + energies["bending"] < 2.0


def test_a_dress_of_fewer_vertices_is_sewn_as_the_whole_one(garments, shared, tmp_path):
    """Seams gape by no more than a chord cuts off, and panels keep their area."""
    import coarse_dress
    from worn_dress import write_meshes

    write_meshes(tmp_path)
    whole = coarse_dress.read(tmp_path / "dress.obj")
    dress = coarse_dress.coarser(whole, 0.02)
    (i, j, k), w = dress.ends.T, dress.weights[:, None]
    gape = np.linalg.norm(dress.points[i] - (1.0 - w) * dress.points[j] - w * dress.points[k], axis=1)
    assert len(dress.points) < 3000 and gape.max() < 5e-3 and np.median(gape) < 5e-4
    areas = [
        np.abs(np.cross(*(d.uv[d.triangles[:, a]] - d.uv[d.triangles[:, 0]] for a in (1, 2)))).sum()
        for d in (whole, dress)
    ]
    assert abs(areas[1] / areas[0] - 1.0) < 0.01


@pytest.mark.parametrize(
    ("name", "skirt"),
    [
        ("skirt", "skirt3448.obj"),
        pytest.param("skirt", "skirt7271.obj", marks=pytest.mark.slow),
        pytest.param("dress", "", marks=pytest.mark.slow),
        pytest.param("pleated", "", marks=pytest.mark.slow),
        pytest.param("worn", "", marks=pytest.mark.study),
    ],
)
def test_garment_hangs_in_a_stable_equilibrium(garments, shared, tmp_path, monkeypatch, name, skirt):
    scene = garments.SCENES[name].replace("skirt7271.obj", skirt)
    monkeypatch.setitem(garments.SCENES, name, scene)
    summary = garments.drape(name, 1, tmp_path)
    assert summary["code"] == 0 and summary["converged"] and summary["stable"]
    assert summary["residual_norm"] <= summary["residual_tolerance"]
    assert summary["energy"]["stretching"] > 0 and summary["energy"]["bending"] > 0
    result = read_result(tmp_path / name)
    points = result.points(-1)
    assert np.isfinite(points).all()
    size = np.linalg.norm(np.ptp(result.start, axis=0))
    assert np.linalg.norm(points - result.start, axis=1).max() < size
    if name == "worn":
        contact, weight = summary["contact"], np.array(summary["contact"]["obstacles"][0]["force"])
        assert contact["friction_error"] < 1e-8 and contact["max_penetration"] < 1e-10
        assert contact["self_contacts"] > 0 and contact["stick"] > 100
        assert np.abs(weight - [0.0, weight[1], 0.0]).max() < 1e-8 * weight[1]
    if name in ("pleated", "worn"):
        s = read_mesh(shared / "meshes" / "pleated-dress-panels.obj").stitches
        w = s.weight[:, None]
        seam = points[s.slave] - (1 - w) * points[s.first] - w * points[s.second]
        assert abs(seam).max() < 1e-14 * size
