"""Names, units and shapes of everything a result file may hold: the one table for writer, reader and post."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Field:
    """One quantity: SI unit ("" = none), meaning, numbers per row (0 = scalar), storage type."""

    unit: str
    meaning: str
    components: int = 0
    dtype: type = np.float64

    @property
    def row_shape(self) -> tuple[int, ...]:
        """Of one vertex' or triangle's value: () for a number."""
        return (self.components,) if self.components else ()

    @property
    def row_size(self) -> int:
        """Bytes of a row."""
        return np.dtype(self.dtype).itemsize * max(1, self.components)


POINT_FIELDS = {
    "start": Field("m", "position at the start of the run", 3),
    "rest": Field("m", "rest position (one of them where the rest shape has its own vertices)", 3),
    "input_vertex": Field("", "index of the vertex in the input mesh file", dtype=np.int64),
    "reaction": Field("N", "contact reaction on the shell", 3),
    "gap": Field("m", "distance to the nearest obstacle, negative inside"),
    "contact": Field("", "0 free, 1 stick, 2 slip", dtype=np.uint8),
    "normal_reaction": Field("N", "part of the reaction along the axis of Coulomb's cone", 3),
    "friction": Field("", "coefficient of Coulomb's cone, 0 without active contact"),
    "margin": Field("", "share of friction's bound that is left, 0 where it slips, 1 without active contact"),
    "mode": Field("", "shape of a mode, largest 1", 3),
    "velocity": Field("m/s", "velocity", 3),
    "acceleration": Field("m/s^2", "acceleration", 3),
}

CELL_FIELDS = {
    "group": Field("", "index of the triangle's group in /voile group_names", dtype=np.int32),
    "thickness": Field("m", "rest thickness"),
    "energy_density": Field("J/m^2", "elastic energy per rest area"),
    "stretching_density": Field("J/m^2", "stretching energy per rest area"),
    "bending_density": Field("J/m^2", "bending energy per rest area"),
    "strain": Field("", "largest principal Green strain"),
    "curvature": Field("1/m", "principal curvature of largest magnitude"),
    "membrane_force": Field("N/m", "Cauchy membrane force per length, xx yy zz xy yz xz", 6),
    "principal_membrane_force": Field("N/m", "principal membrane forces, the larger first", 2),
    "bending_moment": Field(
        "N", "bending moment per length, xx yy zz xy yz xz; positive bends the normal side out", 6
    ),
    "principal_bending_moment": Field("N", "principal bending moments per length, the larger first", 2),
    "principal_strain": Field("", "principal Green strains, the larger first", 2),
    "fabric_strain": Field("", "Green strain along the warp, along the weft, and their shear angle", 3),
    "stress_top": Field("Pa", "stress at the surface on the side of the normal, xx yy zz xy yz xz", 6),
    "stress_bottom": Field("Pa", "stress at the other surface, xx yy zz xy yz xz", 6),
    "von_mises": Field("Pa", "von Mises stress, the larger of both surfaces"),
}

EDGE_ANGLES = Field("rad", "director angle of the edge")
PLACEMENT = Field(
    "m", "rigid placement of an obstacle, 4 x 4 by rows: x = matrix (x at load factor 0, 1)", 16
)


def find_field(table: Mapping[str, Field], name: str) -> Field | None:
    """The table's field of that name; `mode_000` and so on are fields `mode`. None where there is none."""
    return table.get(name) or table.get(re.sub(r"_\d{3,}$", "", name))
