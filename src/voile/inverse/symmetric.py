"""Symmetric patterns: which vertex of a surface mirrors which, panels made mirror images of each other exactly, and
rules for one half that hold for the other."""

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from voile.arrays import Array, Flags, Ints, Reals
from voile.errors import InputError
from voile.inverse.ease import wanted_ease
from voile.inverse.panels import Panels
from voile.inverse.rules import PanelRule, Rules, SeamRule
from voile.mesh import is_called

PLACES = 3  # the plane of symmetry: found again with the partners that it gave
FAR = 0.5  # of the mean edge: how far a vertex may be from the mirror image of its partner


def mirror_map(panels: Panels, axis: int) -> Ints:
    """(p,) the panel vertex that mirrors each, over a plane across `axis` amid the surface: triangles mirror triangles.

    The shape may be off its mirror image by half an edge; panels must mirror panels. Raises InputError, naming the
    first vertex or panel without a mirror image.
    """
    points, letter = panels.points, "xyz"[axis]
    edge = np.linalg.norm(points[panels.triangles[:, 0]] - points[panels.triangles[:, 1]], axis=1).mean()
    place, distance, partner = _nearest(points, panels.triangles, axis)
    partner = _layered(panels, partner)
    here = np.unique(panels.triangles)
    lone = here[(partner[partner[here]] != here) | (distance[here] > FAR * edge)]
    if len(lone):
        where = ", ".join(f"{v:.4g}" for v in points[lone[0]])
        raise InputError(
            f"pattern.symmetric: vertex {lone[0]} at ({where}) m has no mirror image over {letter} = {place:.4g} m, "
            f"the nearest vertex is {distance[lone[0]]:.2g} m off ({len(lone)} such vertices); allowed: a mesh whose "
            f"triangles mirror each other ('voile mesh mirror FILE --across {letter}' makes one)"
        )
    return _of_panels(panels, partner, letter)


def middle_of(points: Reals, triangles: Ints, axis: int) -> Flags:
    """(n,) vertices of a surface that are their own mirror images."""
    found: Flags = _nearest(points, triangles, axis)[2] == np.arange(len(points))
    return found


def _nearest(points: Reals, triangles: Ints, axis: int) -> tuple[float, Reals, Ints]:
    """Where the plane of symmetry lies along the axis (m); how far each vertex' mirror image is from the nearest vertex
    (n,) m, and which that is (n,)."""
    along = points[triangles, axis]
    place, tree = 0.5 * (along.min() + along.max()), cKDTree(points)
    for _ in range(PLACES):
        image = points.copy()
        image[:, axis] = 2 * place - image[:, axis]
        distance, partner = tree.query(image)
        place = float(np.median(0.5 * (points[:, axis] + points[partner, axis])))
    return place, distance, partner


def _layered(panels: Panels, partner: Ints) -> Ints:
    """Partners where several vertices are at one place, as along seams of panels that lie apart: those that
    triangles mirror."""
    points = panels.points
    groups = cKDTree(points).query_ball_point(points, 1e-9 * np.ptp(points))
    many = [v for v, group in enumerate(groups) if len(group) > 1]
    if not many:
        return partner
    single = np.array([len(group) == 1 for group in groups])
    found = partner.copy()
    sure = single & single[partner]
    around: dict[frozenset[int], list[int]] = {}
    for corners in panels.triangles.tolist():
        for k in range(3):
            around.setdefault(frozenset((corners[k], corners[k - 1])), []).append(corners[k - 2])
    # from triangle to triangle: the corner across a mirrored edge is that of the mirrored triangle
    front = [tuple(ends) for ends in around if all(sure[v] for v in ends)]
    while front:
        ends = front.pop()
        image = around.get(frozenset(int(found[v]) for v in ends), [])
        for corner in around[frozenset(ends)]:
            if sure[corner]:
                continue
            place = set(groups[int(partner[corner])])
            answer = [v for v in image if v in place]
            if len(answer) == 1:
                found[corner], sure[corner] = answer[0], True
                front += [(corner, v) for v in ends]
    return found


def _of_panels(panels: Panels, partner: Ints, letter: str) -> Ints:
    """(p,) partners of panel vertices, from those of the surface."""
    mirrored = {frozenset(corners): t for t, corners in enumerate(panels.triangles.tolist())}
    found = np.full(len(panels.vertex), -1)
    for t, corners in enumerate(panels.triangles.tolist()):
        other = mirrored.get(frozenset(partner[corners].tolist()))
        if other is None:
            raise InputError(
                f"pattern.symmetric: triangle {t} has no mirror image across {letter}; allowed: a mesh whose triangles "
                "mirror each other"
            )
        images = dict(zip(panels.triangles[other].tolist(), panels.corners[other].tolist(), strict=True))
        for corner, v in zip(panels.corners[t].tolist(), corners, strict=True):
            image = images[int(partner[v])]
            if found[corner] not in (-1, image):
                found[corner] = -2
            elif found[corner] == -1:
                found[corner] = image
    _check_panels(panels, found, letter)
    return found


def _check_panels(panels: Panels, found: Array, letter: str) -> None:
    """InputError at the first panel that is cut otherwise than its mirror image."""
    for k, name in enumerate(panels.names):
        own = found[panels.vertex_panel == k]
        if (own < 0).any() or len(np.unique(panels.vertex_panel[own])) > 1:
            raise InputError(
                f"pattern.symmetric: panel {name!r} is cut otherwise than its mirror image across {letter}; allowed: "
                "groups and inverse.seams that mirror each other"
            )


def partners(panels: Panels, mirror: Ints) -> list[int]:
    """The panel that mirrors each, itself where it is in the middle."""
    first = np.searchsorted(panels.vertex_panel, np.arange(len(panels.names)))
    found: list[int] = panels.vertex_panel[mirror[first]].tolist()
    return found


def symmetrised(panels: Panels, x: Reals, mirror: Ints) -> tuple[Reals, float]:
    """Flat coordinates (p, 2), m, in which panels are mirror images over an upright line each, and the farthest that a
    vertex moved against its panel. x has grain upwards; what mirrors itself stands upright."""
    x, moved = x.copy(), 0.0
    for k, other in enumerate(partners(panels, mirror)):
        own = np.flatnonzero(panels.vertex_panel == k)
        if other < k:
            continue
        image = x[mirror[own]] * [-1.0, 1.0]
        mean = 0.5 * (x[own] + _fitted(image, x[own]))
        if other == k:
            mean = _upright(mean, mirror[own] - own[0])
        moved = max(moved, *(_apart(mean, shape) for shape in (x[own], image)))
        x[own] = mean
        if other != k:
            x[mirror[own]] = mean * [-1.0, 1.0]
    return x, moved


def _fitted(shape: Reals, to: Reals) -> Reals:
    """Points (n, 2) turned and moved as near as can be to others (Kabsch, Acta Cryst. A32, 1976)."""
    one, other = shape - shape.mean(axis=0), to - to.mean(axis=0)
    turn = np.arctan2(np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]), np.sum(one * other))
    cos, sin = np.cos(turn), np.sin(turn)
    found: Reals = one @ np.array([[cos, sin], [-sin, cos]]) + to.mean(axis=0)
    return found


def _apart(one: Reals, other: Reals) -> float:
    return float(np.linalg.norm(_fitted(other, one) - one, axis=1).max())


def _upright(x: Reals, mirror: Ints) -> Reals:
    """A shape (n, 2) that mirrors itself by `mirror` (n,), turned so that its line of symmetry is upright or level,
    whichever is nearer; exactly symmetric."""
    across = x - x[mirror]
    one = across[np.linalg.norm(across, axis=1).argmax()]
    angle = np.arctan2(one[1], one[0])
    turn = angle - 0.5 * np.pi * np.round(angle / (0.5 * np.pi))
    cos, sin = np.cos(turn), np.sin(turn)
    turned = (x - x.mean(axis=0)) @ np.array([[cos, -sin], [sin, cos]])
    sign = [-1.0, 1.0] if abs(one[0]) > abs(one[1]) else [1.0, -1.0]
    found: Reals = 0.5 * (turned + turned[mirror] * sign)
    return found


def mirrored_rules(panels: Panels, rules: Rules) -> Rules:
    """The rules with their mirror images, where they ask for symmetry, each before what it comes from: the last one
    counts. What is said of a panel or seam by its own name counts over what its mirror image says. Raises InputError
    for ease that differs from that of the mirror image, and as `mirror_map`."""
    if rules.symmetric is None:
        return rules
    mirror = mirror_map(panels, rules.symmetric)
    names, others = panels.names, partners(panels, mirror)
    flip = np.where(np.arange(3) == rules.symmetric, -1.0, 1.0)

    def images(name: str) -> list[str]:
        return [names[others[k]] for k, panel in enumerate(names) if is_called(panel, name)]

    own = {rule.panel for rule in rules.panels}
    grains: list[PanelRule] = []
    for rule in rules.panels:
        grain = rule.grain if isinstance(rule.grain, str) else tuple((flip * rule.grain).tolist())
        grains += [*(PanelRule(n, grain) for n in images(rule.panel) if n not in own), rule]
    seams: list[SeamRule] = []
    for wish in rules.seams:
        here = None if wish.vertices is None else np.isin(panels.vertex, wish.vertices)
        vertices = None if here is None else np.unique(panels.vertex[mirror[here]])
        found = (replace(wish, between=n, vertices=vertices) for n in product(*map(images, wish.between)))
        seams += [*(image for image in found if not any(_same(image, r) for r in rules.seams)), wish]
    ease = {}
    for seam, longer in zip(panels.seams, wanted_ease(panels, seams), strict=True):
        ease[seam.panels], ease[seam.panels[::-1]] = longer or 0.0, -(longer or 0.0)
    for (one, other), longer in ease.items():
        image = (others[one], others[other])
        if longer != ease.get(image, longer):
            raise InputError(
                f"pattern.seam: ease of {longer:g} m between {names[one]!r} and {names[other]!r}, of {ease[image]:g} m "
                f"between their mirror images {names[image[0]]!r} and {names[image[1]]!r}; allowed with "
                "pattern.symmetric: one value, and none where left meets right"
            )
    return replace(rules, panels=tuple(grains), seams=tuple(seams))


def _same(one: SeamRule, other: SeamRule) -> bool:
    """Whether two rules name the same panels, and the same part of their border."""
    if set(one.between) != set(other.between):
        return False
    return one.vertices is None or other.vertices is None or bool(np.isin(one.vertices, other.vertices).any())
