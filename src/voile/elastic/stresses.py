"""Names of what can be told of a shell's stresses, per triangle, and which shells have them not."""

# What output.fields may name, and the cell fields that each writes.
FIELDS = {
    "membrane_force": ("membrane_force", "principal_membrane_force"),
    "bending_moment": ("bending_moment", "principal_bending_moment"),
    "strain": ("principal_strain",),
    "stress": ("stress_top", "stress_bottom"),
    "von_mises": ("von_mises",),
    "fabric_strain": ("fabric_strain",),
    "energy_density": ("energy_density", "stretching_density", "bending_density"),
}


def lacking(model: str, material: str) -> dict[str, str]:
    """Those of FIELDS that a shell of a model and material (shell.model, shell.material) has not, and why."""
    found = {}
    if model == "membrane":
        found["bending_moment"] = "a membrane has none"
    if material != "orthotropic":
        found["fabric_strain"] = 'allowed with shell.material = "orthotropic"'
    return found
