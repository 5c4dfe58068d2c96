"""Fabrics by name: measured values that `fabric = NAME` puts into [shell] or [[fabric]] where they give no others.

Source: Wang, O'Brien and Ramamoorthi (2011), "Data-driven elastic models for cloth: modeling and measurement", ACM
Transactions on Graphics 30(4); samples "11oz-black-denim", "royal-target", "white-dots-on-blk", "ivory-rib-knit",
"camel-ponte-roma" as distributed with ARCSim, whose second direction (along v) is the warp here. Taken: the smallest
strain and curvature.

Bending there is the k of the hinge energy k l^2 theta^2 / (8 a), l an edge's length, theta its angle, a the area of its
two triangles (Bridson et al. 2003; ARCSim's bending_energy). Of a grid bent to a cylinder of curvature c that is
k c^2 / 8 per area, and B c^2 / 2 of a plate: B = k/4.

Cotton, wool, polyester faille: Matsudaira, Masuda, Wada and Yokura (2015), "Shape factor of flared skirts compared with
that of circular fabrics", Journal of Textile Engineering 61, 69-73, table 1: "cotton broad" and "wool tropical", plain
weaves of one fibre, and "polyester faille", by Kawabata's instruments; read in a copy of the table. It has no moduli:
scenes give `young`.
"""

from typing import Any

from voile.keys import Rejected

# Nominal thickness (not measured there): with it moduli are membrane stiffnesses over thickness.
THICKNESS = {
    "denim": 0.8e-3,
    "cotton-polyester": 0.4e-3,
    "polyester": 0.3e-3,
    "rib-knit": 0.8e-3,
    "double-jersey": 0.9e-3,
}


def _strips(*stiffnesses: float) -> tuple[float, ...]:
    """Bending stiffnesses (N m) of strips from those of the source's hinges (1e-6 N m)."""
    return tuple(1e-6 * k / 4.0 for k in stiffnesses)


# Per area mass (kg/m^2); stretching (N/m): weft, coupling, warp, shear (the energy has half of it times e12^2); bending
# (N m) of strips along the warp, at 45 degrees, along the weft.
MEASURED = {
    "denim": (
        0.324,
        (205.352005, 10.234077, 1013.88629, 53.387184),
        _strips(64.196457, 73.384567, 96.951576),
    ),
    "cotton-polyester": (
        0.220,
        (2016.55456, 9.170511, 2034.97644, 104.759674),
        _strips(125.409805, 107.997696, 125.409805),
    ),
    "polyester": (
        0.128,
        (2002.08618, 0.345588, 2027.48559, 19.189022),
        _strips(51.713814, 40.659470, 31.282822),
    ),
    "rib-knit": (
        0.276,
        (42.871021, -0.234556, 65.166023, 83.175644),
        _strips(46.237591, 30.015930, 32.243889),
    ),
    "double-jersey": (
        0.284,
        (31.146198, -12.802702, 44.028667, 31.896357),
        _strips(36.348366, 33.013252, 37.157593),
    ),
}

# Per area mass (kg/m^2), thickness (m), bending stiffness (gf cm^2/cm, one for both directions)
BENDING = {
    "cotton": (0.1238, 0.497e-3, 0.118),
    "wool": (0.1629, 0.407e-3, 0.067),
    "polyester-faille": (0.1043, 0.226e-3, 0.019),
}
GRAM_FORCE = 9.80665e-5  # N m in a gf cm^2/cm


def fabric(name: str) -> dict[str, float]:
    """The keys of [shell] or [[fabric]] that a fabric of the library stands for."""
    if name in BENDING:
        mass, h, bend = BENDING[name]
        return {
            "thickness": h,
            "density": mass / h,
            "bending_warp": bend * GRAM_FORCE,
            "bending_weft": bend * GRAM_FORCE,
        }
    if name not in MEASURED:
        allowed = ", ".join([*MEASURED, *BENDING])
        raise Rejected(f'no fabric "{name}" in the library; allowed: {allowed}', ("fabric",))
    mass, (weft, coupling, warp, shear), (bend_warp, bend_bias, bend_weft) = MEASURED[name]
    h = THICKNESS[name]
    mean = coupling / (weft * warp) ** 0.5  # the root of both Poisson's ratios' product
    # 4/B at 45 degrees = 1/B1 + 1/B2 - 2 nu/sqrt(B1 B2) + 1/B6
    twist = 1.0 / (
        4.0 / bend_bias - 1.0 / bend_warp - 1.0 / bend_weft + 2.0 * mean / (bend_warp * bend_weft) ** 0.5
    )
    return {
        "thickness": h,
        "density": mass / h,
        "young": (warp - coupling**2 / weft) / h,
        "young_weft": (weft - coupling**2 / warp) / h,
        "poisson": coupling / weft,
        "shear": shear / 4.0 / h,
        "bending_warp": bend_warp,
        "bending_weft": bend_weft,
        "bending_twist": twist,
    }


def expand(tree: dict[str, Any]) -> None:
    """Puts the values of named fabrics into a scene's tree, where its tables give none; raises Rejected for a name that
    is not in the library."""
    shell, others = tree.get("shell"), tree.get("fabric")
    for path, table in ((("shell",), shell), *((("fabric", k), t) for k, t in enumerate(_tables(others)))):
        if not isinstance(table, dict) or not isinstance(table.get("fabric"), str):
            continue
        try:
            values = fabric(table["fabric"])
        except Rejected as error:
            for part in reversed(path):
                error = error.under(part)
            raise error from None
        for key, value in values.items():
            table.setdefault(key, value)
        if path == ("shell",):
            table.setdefault("material", "orthotropic")


def _tables(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
