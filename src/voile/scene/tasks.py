"""Keys of a scene that belong to a task: statics, dynamics, inverse design, and what is written."""

import math
from dataclasses import dataclass
from pathlib import Path

from voile.elastic.stresses import FIELDS
from voile.elastic.weave import STIFFNESSES
from voile.keys import Array, Boolean, Choice, File, Integer, MeshFile, Number, Rejected, Table, key
from voile.mesh import RawMesh

TASKS = {
    "statics": True,
    "dynamics": True,
    "inverse": True,
    "modes": True,
}  # whether this version runs them


@dataclass(frozen=True, kw_only=True)
class Statics:
    load_steps: int | None = key(
        Integer(1),
        "first load step is 1/load_steps; adaptive from there; default: 10, or 1 where there are obstacles and nothing "
        "moves",
        default=None,
    )
    max_steps: int = key(Integer(1), "load steps tried in all", default=1000)
    perturbation: float = key(Number(least=0), "off unstable branches, in thicknesses", default=1.0)
    tolerance: float = key(
        Number(above=0, below=1), "norm of the residual over the norm of the load", default=1e-8
    )
    stability: bool = key(Boolean(), "test whether the end state is stable", default=True)
    eigenvalue: bool = key(Boolean(), "also its smallest eigenvalue", default=False)
    nested: bool = key(
        Boolean(), "coarser levels of the mesh first, where only loads lead the shell", default=True
    )
    load_factors: tuple[float, ...] = key(
        Array(Number(above=0, most=1), least=1),
        "prescribed ends of load steps, ascending, the last one 1; a step that fails is still cut",
        default=(),
    )
    control: str = key(
        Choice("load", "arc-length"),
        "what leads the path; arc-length: its arc, through limit points, while the load factor rises and falls",
        default="load",
    )
    max_load_factor: float = key(
        Number(above=0), "arc-length: the path ends where the load factor is this, or minus this", default=1.0
    )
    branch: int = key(
        Integer(0),
        "arc-length: leaves the path at this bifurcation, counted from 1, onto the branch that meets it there; 0: at "
        "none",
        default=0,
    )

    def check(self, given: set[str]) -> None:
        factors = self.load_factors
        for index, factor in enumerate(factors):
            if index and factor <= factors[index - 1]:
                raise Rejected(f"{factor:g} is not above the one before", ("load_factors", index))
        if factors and factors[-1] != 1.0:
            raise Rejected(f"ends at {factors[-1]:g}; allowed: the last one 1", ("load_factors",))
        if factors and self.load_steps is not None:
            raise Rejected("allowed without statics.load_factors, which say where steps end", ("load_steps",))
        if factors and self.control == "arc-length":
            raise Rejected('allowed with statics.control = "load" only', ("load_factors",))
        for name in ("max_load_factor", "branch"):
            if name in given and self.control != "arc-length":
                raise Rejected('allowed with statics.control = "arc-length" only', (name,))


@dataclass(frozen=True, kw_only=True)
class Damping:
    mass: float = key(Number("1/s", least=0), "force per momentum", default=0.0)
    stiffness: float = key(Number("s", least=0), "force per rate of the elastic force", default=0.0)


@dataclass(frozen=True, kw_only=True)
class Dynamics:
    scheme: str = key(
        Choice("implicit-euler", "bdf2", "generalized-alpha", "moreau-jean"),
        "time scheme",
        default="implicit-euler",
    )
    time_step: float = key(Number("s", least=1e-12), "time step; adaptive: the longest", default=0.01)
    duration: float = key(Number("s", above=0), "simulated time", default=1.0)
    solver: str = key(
        Choice("newton", "local-global"),
        "what solves a step; local-global: Projective Dynamics with dry friction, for shell.model = projective",
        default="newton",
    )
    tolerance: float = key(
        Number(above=0, below=1), "norm of each step's residual over the norm of the load", default=1e-6
    )
    iterations: int = key(Integer(1), "local-global: iterations of a step at most", default=20)
    adaptive: bool = key(Boolean(), "choose steps by their local error", default=False)
    accuracy: float = key(
        Number(above=0, below=1), "adaptive: local error of a step, in sizes of the shell", default=1e-3
    )
    spectral_radius: float = key(
        Number(least=0, most=1), "generalized-alpha: that of its highest frequencies", default=0.8
    )
    theta: float = key(
        Number(least=0.5, most=1), "moreau-jean: weight of the forces at the step's end", default=1.0
    )
    keeps: str = key(
        Choice("energy", "angular-momentum", "nothing"),
        "moreau-jean with theta 1/2, generalized-alpha with spectral_radius 1: what a step keeps to round-off; "
        "nothing: forces at both ends of a step, which strain no stiff sheet that turns",
        default="energy",
    )
    damping: Damping = key(Table(Damping), "Rayleigh damping", default=Damping())
    stop_at_rest: float = key(
        Number("m/s", least=0), "ends the run once nothing is faster; 0: never", default=0.0
    )


@dataclass(frozen=True, kw_only=True)
class Modes:
    count: int = key(Integer(1), "how many, the lowest", default=6)
    buckling: bool = key(
        Boolean(),
        "load factors at which the linearised structure buckles; false: natural frequencies",
        default=False,
    )
    load_factor: float | None = key(
        Number(least=0, most=1),
        "of the equilibrium about which the structure is linearised; default: 1, with buckling 0, the unloaded shell",
        default=None,
    )

    @property
    def about(self) -> float:
        """The load factor of the equilibrium."""
        return (0.0 if self.buckling else 1.0) if self.load_factor is None else self.load_factor


@dataclass(frozen=True, kw_only=True)
class Inverse:
    friction: bool = key(
        Boolean(), "reactions in the Coulomb cones; false: along the normal only", default=True
    )
    method: str = key(
        Choice("adjoint", "direct", "tao"),
        "direct; adjoint: goes on to the nearest stable shape where the target is not stable; tao: does so in TAO",
        default="adjoint",
    )
    margin: float = key(
        Number(least=0),
        "adjoint: smallest eigenvalue asked for of that shape, over the weight's rate g/L (more is further from the "
        "target and withstands more); 0: the least, half by half, at which simulations from the target end",
        default=0.0,
    )
    contact_tolerance: float = key(
        Number("m", above=0),
        "target vertices nearer than this to an obstacle, and layers to touching, may carry a reaction",
        default=0.001,
    )
    developable: bool | str = key(
        Choice(False, "constraint", "panels"), "whether and how the rest shape is developable", default=False
    )
    estimate: tuple[str, ...] = key(
        Array(Choice("thickness", "young", "poisson", "density", "friction", *STIFFNESSES)),
        "parameters to find from the mesh, then an observed equilibrium, and shell.rest, its known rest shape; young "
        "alone scales all stiffnesses of a woven fabric, beside others of them it is the warp's",
        default=(),
    )
    observed: Path | RawMesh | None = key(
        MeshFile(),
        "estimate: the observed equilibrium, where the mesh is the shape from which the shell got there, over "
        "statics.load_steps; default: the mesh",
        default=None,
    )
    also: tuple[Path, ...] = key(
        Array(File()),
        "estimate: scenes with further observations of the same fabric; without shell.rest they, of the same "
        "triangles, give the parameters, and this one, without contact, the rest shape",
        default=(),
    )
    seams: tuple[tuple[int, ...], ...] = key(
        Array(Array(Integer(), least=2)),
        "lines along which the surface is cut into panels, beside the borders of groups: each runs through these "
        "vertices (indices in the mesh file, from 0), along the shortest ways over edges",
        default=(),
    )
    seam_allowance: float = key(
        Number("m", least=0, most=math.inf),  # at most the shell's size, as patterns tell
        "pattern: distance of the cut line from the sew line",
        default=0.0,
    )
    regularisation: float = key(
        Number(least=0),
        "in TAO: weight of the rest shape's change beside that of the distance to the target",
        default=1e-3,
    )
    iterations: int = key(Integer(1), "in TAO: of the optimisation at most", default=20)
    tolerance: float = key(
        Number(above=0, below=1),
        "norm of the residual over the norm of the load, of the simulations that prove the rest shape",
        default=1e-8,
    )
    max_seconds: float = key(
        Number("s", least=0),
        "wall time after which the search ends with the best shape so far; its proof ends after as long again; 0: no "
        "limit",
        default=0.0,
    )

    def check(self, given: set[str]) -> None:
        names = self.estimate
        if len(set(names)) < len(names):
            raise Rejected(f"{list(names)}; allowed: each parameter once", ("estimate",))
        for name in ("observed", "also"):
            if name in given and not names:
                raise Rejected("tells of parameters; allowed with inverse.estimate", (name,))


@dataclass(frozen=True, kw_only=True)
class Output:
    every: int = key(Integer(1), "write every so many steps; the last one always", default=1)
    fields: tuple[str, ...] = key(
        Array(Choice(*FIELDS)),
        "what to write per triangle in every step: tensors and principal values of forces (N/m) and moments (N), "
        "strains, stresses at both surfaces",
        default=(),
    )
