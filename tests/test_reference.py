"""Energies and derivatives against LibShell (Chen et al. 2018); the values are not part of the project."""

import json
from pathlib import Path

import numpy as np
import pytest

from voile.elastic import evaluate

SHARED = Path(__file__).parents[1].parent / "shared"
MESHES = {"skirt3448": "skirt3448", "dress": "dress-v5k-f10k-v3"}
CASES = [(bending, material) for bending in ("sin", "tan", "theta") for material in ("stvk", "neo-hookean")]


def read_obj(path):
    """Points (n, 3) and triangles (m, 3) of an OBJ file, nothing else of it."""
    lines = [line.split() for line in path.read_text().splitlines() if line[:2] in ("v ", "f ")]
    points = [[float(x) for x in line[1:4]] for line in lines if line[0] == "v"]
    triangles = [[int(x.split("/")[0]) - 1 for x in line[1:4]] for line in lines if line[0] == "f"]
    return np.array(points), np.array(triangles, dtype=np.int32)


@pytest.mark.parametrize("name", MESHES)
def test_libshell(name):
    """The deformation, the vector v and the norms are those that the file describes; 1e-9 relative."""
    files = SHARED / "reference" / f"{name}.json", SHARED / "meshes" / f"{MESHES[name]}.obj"
    for file in files:
        if not file.exists():
            pytest.skip(f"{file} is not there")
    reference = json.loads(files[0].read_text())
    rest, triangles = read_obj(files[1])
    size = reference["diagonal"]
    x, y, z = (rest / size).T
    wave = np.column_stack([np.sin(7 * y + 3 * z), np.cos(5 * x - 2 * z), np.sin(6 * x + 4 * y)])
    v = np.sin(np.arange(rest.size) + 1.0)
    fabric = {key: reference[key] for key in ("thickness", "young", "poisson")}
    assert sorted((value["bending"], value["material"]) for value in reference["values"]) == sorted(CASES)
    for value in reference["values"]:
        e = evaluate(
            rest, rest + 0.02 * size * wave, triangles,
            bending=value["bending"], material=value["material"], hessian=True, **fabric,
        )  # fmt: skip
        hv = (e.hessian @ np.concatenate([v, np.zeros(len(e.edges))]))[: rest.size]
        found = {
            "energy": e.energy,
            "stretching_energy": e.stretching_energy,
            "bending_energy": e.bending_energy,
            "gradient_norm_vertices": np.linalg.norm(e.gradient),
            "hessian_times_v_norm_vertices": np.linalg.norm(hv),
            "v_hessian_v": v @ hv,
        }
        for key, number in found.items():
            assert number == pytest.approx(value[key], rel=1e-9), (value["bending"], value["material"], key)
