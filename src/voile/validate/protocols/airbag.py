"""A square airbag inflated from flat."""

from voile.validate.bench import Bench
from voile.validate.protocol import Check, Curve, Findings, Plot, close
from voile.validate.shells import AIRBAG, airbag

TEXT = "square airbag inflated from flat: height of its centre, with wrinkles as tension field"
SOURCE = (
    "0.217 m with a tension field; 0.205 to 0.218 m in the literature (Contri & Schrefler 1988 and later)"
)
PRESSURE, WRINKLED = 5e3, 0.217
MESHES = (8, 16, 32)


def height(bench: Bench, cells: int, model: str, material: str) -> float:
    """Of the centre (m)."""
    case = airbag(cells)
    if model == "membrane":
        case.clamped = []
    scene = case.scene(model=model, material=material)
    scene["loads"]["pressure"] = PRESSURE
    result = bench.run(f"{model}-{material}-{cells}", scene).result
    return float(result.points()[case.marks["centre"], 2])


def run(bench: Bench) -> Findings:
    checks: list[Check] = []
    curves = []
    meshes = MESHES[:2] if bench.quick else MESHES
    for model in ("membrane", "koiter"):
        found = [height(bench, cells, model, "tension-field") for cells in meshes]
        checks.append(
            close(f"height [m], {model}, tension field, {meshes[-1]}x{meshes[-1]}", found[-1], WRINKLED, 0.01)
        )
        curves.append(
            Curve(f"{model}, tension field", [AIRBAG / 2 / cells for cells in meshes], found, points=True)
        )
    if not bench.quick:  # no check: without a tension field the folds are as wide as cells
        folded = [height(bench, cells, "koiter", "stvk") for cells in meshes]
        curves.append(
            Curve("koiter, folds mesh by mesh", [AIRBAG / 2 / cells for cells in meshes], folded, points=True)
        )
    curves.append(Curve("published, tension field", [0.0, AIRBAG / 16], [WRINKLED, WRINKLED]))
    return Findings(checks, Plot("cell [m]", "height of the centre [m]", curves))
