"""What a shell problem is, as arrays: shape, rest shape, fabric, supports, seams, loads. Only rank 0 holds one."""

from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from voile.arrays import Flags, Ints, Reals
from voile.contact.motion import Motion
from voile.mesh.stitches import Stitches, join, sewing_matrix
from voile.mesh.topology import Topology, build_topology
from voile.problem.load import Load
from voile.problem.local_axes import held_along

SAME = 1e-3  # of an edge's length: rest shapes of two that are sewn together lie in one place


def _no_ints() -> Ints:
    return np.zeros(0, dtype=np.int32)


@dataclass
class Shell:
    """A shell of n vertices and m triangles; SI units.

    points (n, 3) start shape; triangles (m, 3); rest_points (r, 3) and rest_triangles (m, 3) the rest shape, flat
    when it has no folds; thickness, young, poisson, density (m,); model: the kernels' name (voile.elastic.model_name).
    fixed (n, 3) marks Dirichlet axes, motion (n, 3) the displacement along them at time 1, the end of a load path.
    axes (n, 3, 3): rows, the local axes that `fixed` marks; None for the global ones.
    clamped_edges: edges (in topology.edges' order) whose directors are held. Seams x_slave = (1 - weight) x_first +
    weight x_second. Loads at time 1: gravity (3,) m/s^2, pressure (Pa, follows the normal), force (n, 3) N,
    moment (3m,) N m per half edge about the edge, turning the triangle's opposite corner against its normal.
    patch_pressure (m,) Pa beside it, None without.
    springs (n, 3): stiffness (N/m) of elastic supports along each axis, to where the vertices start. bars (b, 4): two
    vertices, stiffness (N/m) and length (m) of each. welds (w, 9): six vertices,
    stiffness (N m) and two angles of sheets that join along an edge (mesh.joints). extra_mass (n,) kg beside the
    fabric's.
    moves: further motions of supports, of which vertices, along their Dirichlet axes.
    load_laws in time, by problem.loads.LOADS: in proportion to it where there is none.
    closing (n, 3): displacement that closes the seams of the start shape (solver.sewing), None where they are closed.
    weave (m, 9): of woven fabrics (elastic/weave.py), None without.
    seam_bending: edges that are sewn to one another at both ends bend as one edge; else they turn freely.
    """

    points: Reals
    triangles: Ints
    rest_points: Reals
    rest_triangles: Ints
    flat: bool
    model: str
    thickness: Reals
    young: Reals
    poisson: Reals
    density: Reals
    fixed: Flags
    motion: Reals
    axes: Reals | None = None
    clamped_edges: Ints = field(default_factory=_no_ints)
    slave: Ints = field(default_factory=_no_ints)
    first: Ints = field(default_factory=_no_ints)
    second: Ints = field(default_factory=_no_ints)
    weight: Reals = field(default_factory=lambda: np.zeros(0))
    gravity: Reals = field(default_factory=lambda: np.zeros(3))
    pressure: float = 0.0
    patch_pressure: Reals | None = None
    force: Reals | None = None
    moment: Reals | None = None
    moves: tuple[tuple[Ints, Motion], ...] = ()
    load_laws: dict[str, Load] = field(default_factory=dict)
    closing: Reals | None = None
    seam_bending: bool = False
    weave: Reals | None = None
    springs: Reals | None = None
    bars: Reals | None = None
    welds: Reals | None = None
    extra_mass: Reals | None = None
    topology: Topology = field(default=None)  # type: ignore[assignment]  # built from the triangles

    @property
    def held(self) -> Reals:
        """(n, 3, 3) projections on the directions along which vertices are held."""
        return held_along(self.axes, self.fixed)

    @property
    def stitches(self) -> Stitches:
        """The seams."""
        return Stitches(self.slave, self.first, self.second, self.weight)

    def sewing(self) -> tuple[sp.csr_matrix, Ints]:
        """x = P x[base] for the seams; the identity without."""
        n = len(self.points)
        if not len(self.slave):
            return sp.identity(n, format="csr"), np.arange(n)
        return sewing_matrix(self.stitches, n)

    @property
    def pressed(self) -> bool:
        """Whether there is any pressure."""
        return self.pressure != 0.0 or self.patch_pressure is not None

    def __post_init__(self) -> None:
        self.topology = self.topology or build_topology(self.triangles)
        if len(self.slave):
            label, _ = join(self.stitches, len(self.points))
            if self.seam_bending:
                self.topology, self.clamped_edges = _through_seams(self, label)
            self.topology = _without_pockets(self, label)


def _without_pockets(shell: Shell, label: Ints) -> Topology:
    """The topology with hinges opened whose two opposite vertices are sewn together (the tip of a dart): they stay
    folded flat whatever the shape, so they carry no bending."""
    topology = shell.topology
    across = topology.across.ravel()
    opposite = shell.triangles.ravel()
    closed = (across >= 0) & (label[opposite] == label[opposite[np.maximum(across, 0)]])
    return replace(
        topology, across=np.where(closed, -1, across).astype(np.int32).reshape(topology.across.shape)
    )


def _through_seams(shell: Shell, label: Ints) -> tuple[Topology, Ints]:
    """The topology in which boundary edges that are sewn to one another at both ends are one, with one director, and
    the clamped edges in its order. Where the rest shape is no plane pattern it must have them in one place, too. label
    (n,): what each vertex is joined to."""
    topology, n = shell.topology, len(shell.points)
    half = np.flatnonzero(topology.across.ravel() < 0)
    ends = [(half // 3, (half + turn) % 3) for turn in (1, 2)]  # triangle and corner where it starts and ends
    start, end = (label[shell.triangles[place]].astype(np.int64) for place in ends)
    there, back = start * n + end, end * n + start
    directed, first, count = np.unique(there, return_index=True, return_counts=True)
    same, met = (
        np.searchsorted(directed, there),
        np.minimum(np.searchsorted(directed, back), max(len(directed) - 1, 0)),
    )
    # one that runs back along it and no second one either way: three layers do not bend as one edge
    pairs = (directed[met] == back) & (count[met] == 1) & (count[same] == 1) & (start != end)
    one = np.flatnonzero(pairs & (np.arange(len(half)) < first[met]))
    other = first[met[one]]
    if not shell.flat:
        begins, stops = (shell.rest_points[shell.rest_triangles[place]] for place in ends)
        apart = np.linalg.norm(np.hstack([begins[one] - stops[other], stops[one] - begins[other]]), axis=1)
        close = apart <= SAME * np.linalg.norm(stops[one] - begins[one], axis=1)
        one, other = one[close], other[close]
    if not len(one):
        return topology, shell.clamped_edges
    across, edge, sign = (
        part.copy().ravel() for part in (topology.across, topology.triangle_edges, topology.signs)
    )
    across[half[one]], across[half[other]] = half[other], half[one]
    stands = np.arange(len(topology.edges))
    stands[edge[half[other]]] = edge[half[one]]
    sign[half[other]] = -sign[half[one]]
    kept, number = np.unique(stands, return_inverse=True)
    shape = topology.across.shape
    merged = Topology(
        edges=topology.edges[kept],
        triangle_edges=number[edge].astype(topology.triangle_edges.dtype).reshape(shape),
        signs=sign.reshape(shape),
        across=across.reshape(shape),
    )
    return merged, np.unique(number[shell.clamped_edges]).astype(np.int32)


def hilbert_order(points: Reals, bits: int = 16) -> Ints:
    """Order of points (n, 3) along a Hilbert curve (Skilling 2004, "Programming the Hilbert curve")."""
    low, high = points.min(axis=0), points.max(axis=0)
    scale = (2**bits - 1) / max(float((high - low).max()), 1e-300)
    x = [((points[:, k] - low[k]) * scale).astype(np.uint64) for k in range(3)]
    q = np.uint64(1 << (bits - 1))
    while q > 1:
        p = q - np.uint64(1)
        for k in range(3):
            on = (x[k] & q) != 0
            t = np.where(on, np.uint64(0), (x[0] ^ x[k]) & p)
            x[0] = np.where(on, x[0] ^ p, x[0] ^ t)
            if k:
                x[k] = x[k] ^ t
        q >>= np.uint64(1)
    x[1] ^= x[0]
    x[2] ^= x[1]
    t = np.zeros(len(points), dtype=np.uint64)
    q = np.uint64(1 << (bits - 1))
    while q > 1:
        t = np.where((x[2] & q) != 0, t ^ (q - np.uint64(1)), t)
        q >>= np.uint64(1)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(bits - 1, -1, -1):
        for k in range(3):
            key = (key << np.uint64(1)) | (((x[k] ^ t) >> np.uint64(bit)) & np.uint64(1))
    return np.argsort(key, kind="stable")


def seam_gaps(shell: Shell) -> Reals:
    """(s,) distance of the start shape's seams (m), for each sewn vertex."""
    x, w = shell.points, shell.weight[:, None]
    apart = x[shell.slave] - (1.0 - w) * x[shell.first] - w * x[shell.second]
    found: Reals = np.linalg.norm(apart, axis=1)
    return found
