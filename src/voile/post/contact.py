"""Contact in pictures: the obstacles' surfaces, reactions as arrows, vertices that are free, stick or slip."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from voile.arrays import Array, Ints, Reals
from voile.results import Body, Result

STATES = {"free": "#d3dbe3", "stick": "#2b6ca3", "slip": "#e58a3c"}  # in the order of the field `contact`
ARROWS = ("contact", "gap", "reaction")  # fields whose pictures show the reactions
BODY, MARK, ARROW = "#cfcfca", "#b2b6b8", "#8c1c2e"
LONGEST = 0.12  # of the shape's size: an arrow
FAINT = 0.02  # of the largest: reactions that show no arrow
LARGE = 2.0  # sizes of the shape: bodies larger than this run out of the picture


def surfaces(result: Result, step: int) -> list[tuple[Reals, Ints]]:
    """Points (n, 3) m and triangles (m, 3) of every obstacle where it is at a step."""
    return [
        (body.shape(result.values[step]) @ place[:3, :3].T + place[:3, 3], body.triangles)
        for body, place in zip(result.bodies, result.placements(step), strict=True)
    ]


def framed(points: Reals, bodies: list[tuple[Reals, Ints]]) -> Reals:
    """(k, 3) what a picture shows for certain: the shape `points` (n, 3) and the bodies not much larger than it."""
    most = LARGE * np.ptp(points, axis=0).max()
    return np.concatenate([points, *(p for p, _ in bodies if np.ptp(p, axis=0).max() < most)])


def turning_marks(result: Result, steps: Ints) -> list[Reals | None]:
    """For every obstacle that turns between the steps (k,): (n,) numbers at its points whose sign changes from one
    octant about its middle to the next, so that turning shows. None for the others."""
    turns = np.array([result.placements(step)[:, :3, :3] for step in steps])
    return [
        None
        if np.array_equal(turns[:, k], np.broadcast_to(turns[0, k], turns[:, k].shape))
        else _octants(body)
        for k, body in enumerate(result.bodies)
    ]


def _octants(body: Body) -> Reals:
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    away = (body.points - (low + high) / 2) / np.where(high > low, high - low, 1.0)
    flat = high - low <= 0.0
    found: Reals = np.prod(np.where(flat, 1.0, away), axis=1)
    return found


def draw_bodies(
    plotter: Any,
    bodies: list[tuple[Reals, Ints]],
    marks: Sequence[Reals | None] | None = None,
) -> None:
    """A little further from the eye than they are: where the shape touches it is the shape that shows. Plain but for
    marks: numbers at the points, whose signs have two shades."""
    import pyvista

    for (points, triangles), mark in zip(bodies, marks or [None] * len(bodies), strict=True):
        body = pyvista.PolyData.from_regular_faces(points, triangles)
        look: dict[str, Any] = {"color": BODY}
        if mark is not None:
            body["mark"] = mark
            look = {
                "scalars": "mark", "cmap": [BODY, MARK], "clim": (-1e-9, 1e-9), "interpolate_before_map": True,
                "show_scalar_bar": False,
            }  # fmt: skip
        actor = plotter.add_mesh(
            body, smooth_shading=True, split_sharp_edges=True, feature_angle=40.0, ambient=0.5, diffuse=0.55,
            specular=0.0, **look,
        )  # fmt: skip
        actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
        actor.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(2.0, 400.0)


def draw_reactions(plotter: Any, points: Reals, reaction: Reals) -> None:
    """Arrows along the forces on the shell at its vertices, in proportion; the few largest are cut to LONGEST."""
    import pyvista

    force = np.linalg.norm(reaction, axis=1)
    shown = force > FAINT * force.max(initial=0.0)
    if not shown.any():
        return
    size = LONGEST * np.ptp(points, axis=0).max()
    length = size * np.minimum(force[shown] / np.percentile(force[shown], 95), 1.0)
    tails = pyvista.PolyData(points[shown])
    tails["along"], tails["length"] = reaction[shown] / force[shown, None], length
    arrow = pyvista.Arrow(tip_length=0.3, tip_radius=0.07, shaft_radius=0.022, tip_resolution=12)
    plotter.add_mesh(tails.glyph(orient="along", scale="length", geom=arrow), color=ARROW, ambient=0.4)


def vertex_cells(points: Reals, triangles: Ints, normals: Reals) -> tuple[Array, ...]:
    """The barycentric cells of the vertices: each triangle's three quadrilaterals around its corners, so that a state
    per vertex is drawn without mixing neighbours'. Returns points (7m, 3), normals (7m, 3), quads (3m, 4) and
    their vertex (3m,)."""
    m = len(triangles)

    def seven(values: Reals) -> Reals:
        """Corners, midpoints of the sides 01, 12, 20, centre of each triangle."""
        corner = values[triangles]
        middle = (corner + np.roll(corner, -1, axis=1)) / 2
        found: Reals = np.concatenate([corner, middle, corner.mean(axis=1, keepdims=True)], axis=1).reshape(
            -1, 3
        )
        return found

    around = np.array([[0, 3, 6, 5], [1, 4, 6, 3], [2, 5, 6, 4]])
    quads = (7 * np.arange(m)[:, None, None] + around).reshape(-1, 4)
    return seven(points), seven(normals), quads, triangles.ravel()


def draw_states(
    plotter: Any,
    points: Reals,
    triangles: Ints,
    normals: Reals,
    state: Ints,
    bar: dict[str, Any],
) -> None:
    """The shape with every vertex' cell in its state's colour; bar: PyVista's arguments of the colour bar, which says
    what the colours mean and how many vertices have them."""
    import pyvista

    places, directions, quads, vertex = vertex_cells(points, triangles, normals)
    shape = pyvista.PolyData.from_regular_faces(places, quads)
    shape.point_data.active_normals = directions
    shape.cell_data["shown"] = state[vertex]
    count = np.bincount(state, minlength=len(STATES))
    names = {k: f"{name} {count[k]}" for k, name in enumerate(STATES)}
    plotter.add_mesh(
        shape, scalars="shown", cmap=list(STATES.values()), clim=(-0.5, 2.5), annotations=names,
        scalar_bar_args=bar | {"n_labels": 0}, smooth_shading=True, ambient=0.38, diffuse=0.7, specular=0.05,
    )  # fmt: skip
