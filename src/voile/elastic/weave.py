"""Woven fabrics: orthotropic about a warp direction per triangle, as the kernels take them (Weave in models.hpp)."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from voile.arrays import Ints, Reals
from voile.errors import InputError
from voile.mesh import Rest, Surface, texture_direction

LENGTH = 9  # numbers of a triangle's weave
STIFFNESSES = ("young_weft", "shear", "bending_warp", "bending_weft", "bending_twist")
ALONG = 1e-6  # of a direction's length: what lies in a triangle's plane at least


@dataclass(frozen=True)
class Woven:
    """A fabric beside Young's modulus along the warp, Poisson's ratio (contraction along the weft over extension along
    the warp) and thickness; per triangle (m,).

    young_weft, shear (Pa): moduli along the weft and in shear. bending_warp, bending_weft (N m): bending stiffness per
    width of strips cut along warp and weft; bending_twist (N m): twisting moment per length over twice the twist. NaN:
    young_weft that of the warp, shear by Huber's rule, bending that of the thickness.
    """

    young_weft: Reals
    shear: Reals
    bending_warp: Reals
    bending_weft: Reals
    bending_twist: Reals


def isotropic(count: int) -> Woven:
    """A fabric of so many triangles that is the same in all directions."""
    return Woven(*(np.full(count, np.nan) for _ in range(5)))


def weave_rows(
    rest: Reals,
    triangles: Ints,
    warp: Reals,
    thickness: Reals,
    young: Reals,
    poisson: Reals,
    *,
    woven: Woven,
) -> Reals:
    """(m, 9) the kernels' weave of rest triangles (m, 3) of points (n, 3) m with the warp along vectors (m, 3), each
    projected on its triangle.

    With nu = sqrt(nu12 nu21), strips B1 and B2 and twist B6 the plate's stiffnesses are D11 = B1/(1 - nu^2), D22 alike,
    D12 = nu sqrt(B1 B2)/(1 - nu^2), D66 = B6; where no twist is given Huber's, sqrt(B1 B2)/(2 (1 + nu)). Raises
    InputError where the energy would not be positive or a warp stands upright on its triangle.
    """
    weft = np.where(np.isnan(woven.young_weft), 1.0, woven.young_weft / young)
    mean = poisson * np.sqrt(weft)
    if not (np.abs(mean) < 1.0).all():
        k = int(np.argmax(np.abs(mean)))
        raise InputError(
            f"poisson = {poisson[k]:g} with young = {young[k]:g} Pa and young_weft = {weft[k] * young[k]:g} Pa; "
            f"allowed: under {1.0 / np.sqrt(weft[k]):.4g}, the root of young over young_weft"
        )
    shear = np.where(np.isnan(woven.shear), np.sqrt(weft) / (2.0 * (1.0 + mean)), woven.shear / young)
    own = ~np.isnan(woven.bending_warp) | ~np.isnan(woven.bending_weft) | ~np.isnan(woven.bending_twist)
    cube = thickness**3 / 12.0
    strips = np.where(np.isnan(woven.bending_warp), cube, woven.bending_warp / young)
    wefts = np.where(np.isnan(woven.bending_weft), weft * cube, woven.bending_weft / young)
    both = np.sqrt(strips * wefts)
    # a sheet twists as it shears; a fabric whose strips are measured alone by Huber's rule
    strips_alone = ~np.isnan(woven.bending_warp) | ~np.isnan(woven.bending_weft)
    twist = np.where(strips_alone, both / (2.0 * (1.0 + mean)), shear * cube)
    twist = np.where(np.isnan(woven.bending_twist), twist, woven.bending_twist / young)
    plate = 1.0 / (1.0 - mean**2)
    c = warp_components(rest, triangles, warp)
    bends = (strips * plate, mean * both * plate, wefts * plate, twist)
    return np.column_stack([c, weft, shear, own.astype(float), *bends])


def stiffnesses(weave: Reals, young: Reals, poisson: Reals) -> dict[str, Reals]:
    """Of weaves (m, 9) the STIFFNESSES (m,) Pa or N m; those of bending where they do not follow the thickness."""
    plate = 1.0 - poisson**2 * weave[:, 2]
    found = {"young_weft": weave[:, 2], "shear": weave[:, 3]}
    if weave[:, 4].all():
        strips = {"bending_warp": weave[:, 5] * plate, "bending_weft": weave[:, 7] * plate}
        found |= {**strips, "bending_twist": weave[:, 8]}
    return {name: young * ratio for name, ratio in found.items()}


def restiffened(
    weave: Reals,
    young: Reals,
    poisson: Reals,
    given: Mapping[str, Reals | float],
    thickness: Reals | float = 0.0,
    ruled: Collection[str] = (),
) -> Reals:
    """Weaves (m, 9) with some of `stiffnesses` (Pa or N m) as given; those that `ruled` names by the rules of
    `weave_rows`, those of strips by the thickness (m); the others keep their ratios to the warp's modulus."""
    new = stiffnesses(weave, young, poisson) | {name: value + 0.0 * young for name, value in given.items()}
    weft = new["young_weft"] / young
    if "shear" in ruled:
        new["shear"] = young * np.sqrt(weft) / (2.0 * (1.0 + poisson * np.sqrt(weft)))
    rows = [*weave[:, :2].T, weft, new["shear"] / young, weave[:, 4]]
    if "bending_warp" not in new:
        return np.column_stack([*rows, weave[:, 5:]])
    for strip, modulus in (("bending_warp", young), ("bending_weft", new["young_weft"])):
        if strip in ruled:
            new[strip] = modulus * thickness**3 / 12.0
    mean, warps, wefts = poisson * np.sqrt(weft), new["bending_warp"] / young, new["bending_weft"] / young
    if "bending_twist" in ruled:
        new["bending_twist"] = young * np.sqrt(warps * wefts) / (2.0 * (1.0 + mean))
    plate = 1.0 / (1.0 - mean**2)
    bends = warps * plate, mean * np.sqrt(warps * wefts) * plate, wefts * plate, new["bending_twist"] / young
    return np.column_stack([*rows, *bends])


def warp_of(rest: Rest, surface: Surface, given: list[tuple[Reals, Any, str]]) -> Reals:
    """(m, 3) warp directions on a rest shape: of triangles (m,), later ones over former ones, a direction (3,) or a
    texture coordinate, and the key that gives it."""
    warp, own = np.zeros((len(surface.triangles), 3)), np.zeros(len(surface.triangles), dtype=int)
    for k, (chosen, _, _) in enumerate(given):
        own[chosen] = k
    for k, (_, direction, key) in enumerate(given):
        mine = own == k
        if mine.any() and isinstance(direction, str):
            warp[mine] = texture_direction(rest, surface, direction, key)[mine]
        elif mine.any():
            warp[mine] = direction
    return warp


def warp_directions(rest: Reals, triangles: Ints, weave: Reals) -> Reals:
    """(m, 3) vectors along the warp of rest triangles (m, 3) with a weave (m, 9)."""
    edges = rest[triangles[:, 1:]] - rest[triangles[:, :1]]
    found: Reals = np.einsum("ta,tai->ti", weave[:, :2], edges)
    return found


def turned(rest: Reals, triangles: Ints, weave: Reals, warp: Reals) -> float:
    """The largest angle (rad) on rest triangles (m, 3) between the warp of a weave (m, 9) and the projection of other
    directions (m, 3)."""
    own = warp_directions(rest, triangles, weave)
    other = warp_directions(rest, triangles, warp_components(rest, triangles, warp))
    cross, dot = np.linalg.norm(np.cross(own, other), axis=1), abs(np.einsum("ti,ti->t", own, other))
    return float(np.arctan2(cross, dot).max(initial=0.0))


def warp_components(rest: Reals, triangles: Ints, warp: Reals) -> Reals:
    """(m, 2) components of the warp's projection in the basis of the edges from the first corner, of unit length."""
    edges = rest[triangles[:, 1:]] - rest[triangles[:, :1]]
    metric = np.einsum("tai,tbi->tab", edges, edges)
    c = np.linalg.solve(metric, np.einsum("tai,ti->ta", edges, warp)[..., None])[..., 0]
    length = np.sqrt(np.einsum("ta,tab,tb->t", c, metric, c))
    upright = length <= ALONG * np.linalg.norm(warp, axis=1)
    if upright.any():
        k = int(np.argmax(upright))
        raise InputError(
            f"the warp along ({', '.join(f'{x:g}' for x in warp[k])}) stands upright on rest triangle {k}; allowed: a "
            "direction that lies along every triangle, or texture coordinates"
        )
    found: Reals = c / length[:, None]
    return found
