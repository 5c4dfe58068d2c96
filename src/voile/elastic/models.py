"""Names of the elastic models; the functions themselves are in src/cpp/models.hpp and its table in elastic.cpp."""

from voile.errors import InputError

MODELS = ("koiter", "discrete-shells", "membrane")
BENDING = ("average", "sin", "tan", "theta")
MATERIALS = ("stvk", "neo-hookean", "tension-field")


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
    if model == "discrete-shells":
        return "discrete-shells//"
    return f"{model}/{bending if model == 'koiter' else ''}/{material}"
