"""A skirt that stands as drawn: inverse design with contact and friction.

Ly, Casati, Bertails-Descoubes, Skouras and Boissieux (2018), "Inverse elastic shell design with contact and friction",
ACM TOG 37(6): given the shape that a garment is to have on a body, which rest shape makes that shape an equilibrium?
The naive answer, to sew the drawn shape itself, sags. Here a skirt of eight gores stands on a dress form, held by
friction alone. The naive rest shape is simulated. Then the inverse problem is solved, which simulates its own answer
twice: from the drawn shape, and from beside it.

    .venv/bin/python examples/drape.py     writes naive.png, drape.png and drape/pattern.svg; 10 seconds
"""

from importlib.resources import files
from pathlib import Path

import numpy as np

import voile

MESHES = Path(str(files("voile") / "templates" / "pattern"))  # of `voile new NAME --template pattern`
FELT = {"young": 1e7, "poisson": 0.3, "thickness": 1e-3, "density": 300.0}


FORM = {"shape": "mesh", "file": str(MESHES / "form.obj"), "friction": 0.3}
SCENE = {"shell": {"mesh": str(MESHES / "skirt.obj"), **FELT}, "obstacle": [FORM]}  # m, y up


def naive() -> tuple[voile.Result, float]:
    """The skirt sewn as it is drawn, and how far it sags over its size."""
    result = voile.run(SCENE)
    moved = np.linalg.norm(result.positions - result.start, axis=1).max()
    return result, float(moved / np.linalg.norm(np.ptp(result.start, axis=0)))


def designed(folder: str | Path) -> voile.Result:
    """The rest shape for which the drawn skirt is in equilibrium, with its pattern, in a folder. The summary's
    `inverse` has the sag of two simulations over the size. NotConverged where friction cannot hold the drawn shape."""
    scene = {"scene": {"task": "inverse"}, "inverse": {"contact_tolerance": 0.002}, **SCENE}
    return voile.run(scene, folder, force=True)


if __name__ == "__main__":
    sewn, sag = naive()
    sewn.render("naive.png", field="displacement")
    print(f"naive rest shape: sags by {sag:.1%} of its size")
    found = designed("drape")
    found.render("drape.png", field="reaction")
    proof = found.summary["inverse"]
    print(
        f"found rest shape: {proof['sag']:.0e}, from beside the target {proof['sag_disturbed']:.0e}; ", end=""
    )
    print("stable" if found.summary["stable"] else "unstable")
    print(f"contact forces carry {found.field('reaction')[:, 1].sum():.4f} N; pattern: drape/pattern.svg")
