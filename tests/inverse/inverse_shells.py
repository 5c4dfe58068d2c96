"""Small shells for the inverse tests, as arrays."""

import numpy as np

from voile.elastic import model_name
from voile.inverse.objective import nearness
from voile.inverse.reduced import Reduced
from voile.problem.shell import Shell


def grid(nx: int, ny: int, width: float, height: float):
    """Points and triangles of a rectangle in the plane z = 0, diagonals alternating."""
    x, y = np.meshgrid(np.linspace(0, width, nx + 1), np.linspace(0, height, ny + 1), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = np.arange(x.size).reshape(x.shape)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    even = (np.add.outer(np.arange(nx), np.arange(ny)) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    return points, np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)]).astype(np.int32)


def shell(
    points,
    triangles,
    fixed,
    *,
    bending="average",
    young=1e6,
    thickness=1e-3,
    poisson=0.3,
    density=300.0,
    **more,
) -> Shell:
    """A shell of one fabric under gravity along -z whose rest shape is its start shape."""
    each = np.ones(len(triangles))
    return Shell(
        points=points,
        triangles=triangles,
        rest_points=points,
        rest_triangles=triangles,
        flat=False,
        model=model_name("koiter", bending, "stvk"),
        thickness=thickness * each,
        young=young * each,
        poisson=poisson * each,
        density=density * each,
        fixed=fixed,
        motion=np.zeros_like(points),
        **{"gravity": np.array([0.0, 0.0, -9.81]), **more},
    )


def hanging_sheet(**more) -> Shell:
    """A curved sheet held along one edge and the next line of vertices."""
    points, triangles = grid(5, 4, 0.3, 0.2)
    points[:, 2] = 0.05 * np.sin(4.0 * points[:, 0]) * np.cos(3.0 * points[:, 1])
    fixed = np.repeat(points[:, :1] < 0.061, 3, axis=1)
    return shell(points, triangles, fixed, **more)


def clamped_sheet(**more) -> Shell:
    """A curved sheet clamped along one edge, one line of vertices."""
    sheet = hanging_sheet(**more)
    sheet.fixed = np.repeat(sheet.points[:, :1] < 1e-9, 3, axis=1)
    sheet.clamped_edges = held_edges(sheet)
    return sheet


def held_edges(shell: Shell) -> np.ndarray:
    """Edges both of whose ends are held."""
    return np.flatnonzero(shell.fixed[shell.topology.edges].all(axis=(1, 2))).astype(np.int32)


def panels(**more) -> Shell:
    """Two sheets sewn along an edge, held at their far ends."""
    points, triangles = grid(3, 3, 0.15, 0.2)
    points[:, 2] = 0.04 * np.sin(5.0 * points[:, 0] + points[:, 1])
    n = len(points)
    mirrored = points * [-1.0, 1.0, 1.0]
    both = np.concatenate([points, mirrored])
    other = triangles[:, [0, 2, 1]] + n
    seam = np.flatnonzero(points[:, 0] < 1e-9)
    fixed = np.repeat(np.abs(both[:, :1]) > 0.09, 3, axis=1)
    weight = np.zeros(len(seam))
    weight[1:-1] = 0.3
    return shell(
        both,
        np.concatenate([triangles, other]).astype(np.int32),
        fixed,
        slave=(seam + n).astype(np.int32),
        first=seam.astype(np.int32),
        second=np.roll(seam, -1).astype(np.int32),
        weight=weight,
        **more,
    )


def strip(cells: int, length: float, width: float, behind: int = 1, **more) -> Shell:
    """A straight horizontal strip along x, `length` from its clamp at x = 0, behind which so many more cells are
    held."""
    points, triangles = grid(cells + behind, 2, length * (1 + behind / cells), width)
    points[:, 0] -= behind * length / cells
    fixed = np.repeat(points[:, :1] < 0.5 * length / cells, 3, axis=1)
    made = shell(points, triangles, fixed, **more)
    made.clamped_edges = held_edges(made)
    return made


def folded_skirt(around: int = 40, down: int = 6, irregular: float = 0.2, **more) -> Shell:
    """A short skirt with five folds that hangs from its waist; irregular: shift of inner vertices in cells."""
    turn, share = np.meshgrid(2.0 * np.pi * np.arange(around) / around, np.arange(down + 1) / down)
    shift = irregular * np.random.default_rng(1).uniform(-1.0, 1.0, (2, *turn.shape))
    turn[1:] += 2.0 * np.pi / around * shift[0, 1:]
    share[1:-1] += shift[1, 1:-1] / down
    radius = 0.15 + share * (0.10 + 0.04 * np.cos(5.0 * turn))
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), -0.25 * share], axis=-1).reshape(-1, 3)
    a = np.arange(around * down).reshape(down, around)
    b, c, d = np.roll(a, -1, axis=1), np.roll(a, -1, axis=1) + around, a + around
    triangles = np.concatenate([np.stack(corners, -1).reshape(-1, 3) for corners in ((a, d, b), (b, d, c))])
    fixed = np.repeat((np.arange(len(points)) < around)[:, None], 3, axis=1)
    return shell(points, triangles.astype(np.int32), fixed, **more)


def nearest_to(target, design, home, start, regularisation=0.0, accuracy=1e-8) -> Reduced:
    """The adjoint method's objective: the distance from the target, and the rest shape's change from home."""
    return Reduced(target, design, nearness(target, design, home, regularisation), start, accuracy)
