"""The elastic models: one row each. The functions themselves are in src/cpp/models.hpp, by name in elastic.cpp."""

from dataclasses import dataclass

from voile.errors import InputError


@dataclass(frozen=True)
class Model:
    """bends: has bending stiffness; normals: takes one of BENDING; material: takes one of MATERIALS."""

    bends: bool
    normals: bool
    material: bool


MODELS = {
    "koiter": Model(bends=True, normals=True, material=True),
    "discrete-shells": Model(bends=True, normals=False, material=False),
    "membrane": Model(bends=False, normals=False, material=True),
    "projective": Model(bends=True, normals=False, material=False),
}
BENDING = {"average": False, "sin": True, "tan": True, "theta": True}  # whether edges have director angles
MATERIALS = ("stvk", "neo-hookean", "tension-field", "orthotropic")


def model_name(model: str, bending: str, material: str) -> str:
    """The kernels' name of a model; parts that the model does not use are left out.

    Raises InputError for a name that is not in the tables above.
    """
    for key, value, allowed in (
        ("model", model, MODELS),
        ("bending", bending, BENDING),
        ("material", material, MATERIALS),
    ):
        if value not in allowed:
            raise InputError(f"{key} = {value!r} is not known; allowed: {', '.join(allowed)}")
    row = MODELS[model]
    return f"{model}/{bending if row.normals else ''}/{material if row.material else ''}"


def model_of(name: str) -> Model:
    """The row of a model by its kernels' name."""
    return MODELS[name.partition("/")[0]]


def is_woven(name: str) -> bool:
    """Whether the model of a kernels' name takes a weave (see weave.py)."""
    return name.endswith("/orthotropic")


def has_directors(name: str) -> bool:
    """Whether the model of a kernels' name has a director angle on each edge."""
    return BENDING.get(name.split("/")[1], False)
