"""Every key of a scene file: kind, unit, range, default and meaning. SI units throughout.

Those of tasks are in tasks.py, those of an obstacle's shape in its class in contact/obstacles.py. What does not go
together is in rules.py.

A table of the file is a frozen dataclass; a key is a field, declared by `key(kind, meaning, default=...)`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from voile.elastic import BENDING, MATERIALS, MODELS
from voile.keys import (
    Boolean,
    Choice,
    Grain,
    Integer,
    MeshFile,
    Number,
    Rejected,
    Table,
    Tables,
    Text,
    Vector3,
    key,
    vector,
)
from voile.mesh import RawMesh
from voile.scene.fix import Fix
from voile.scene.loads import Band, Loads, Mass, Spring, Tie
from voile.scene.obstacles import Body, Obstacle
from voile.scene.pattern import Pattern
from voile.scene.section import Section
from voile.scene.tasks import TASKS, Dynamics, Inverse, Modes, Output, Statics


@dataclass(frozen=True, kw_only=True)
class Heading:
    name: str = key(Text(), "title of the scene", default="")
    task: str = key(Choice(*TASKS), "what to compute", default="statics")


THICKNESS = Number("m", above=0)
YOUNG = Number("Pa", above=0)
POISSON = Number(above=-1, below=0.5)
DENSITY = Number("kg/m^3", above=0)
SHRINK = Number(above=-1, below=1)
BENDS = Number("N m", above=0)
LIBRARY = (
    "orthotropic: name in the library of measured fabrics, whose values hold where no other keys give them"
)
WEFT, SHEAR = "orthotropic: Young's modulus along the weft", "orthotropic: shear modulus"
STRIPS = "orthotropic: bending stiffness per width of strips along the warp"
TWIST = "orthotropic: twisting moment per length over twice the twist"
WARP = "orthotropic: direction of the warp on the rest shape, or the texture coordinate along which it runs"


@dataclass(frozen=True, kw_only=True)
class Shell:
    mesh: Path | RawMesh = key(MeshFile(), "shape at the start (with task = inverse the target)")
    rest: Path | RawMesh | str | None = key(
        MeshFile(("flat",)),
        'rest shape with the same triangles; "flat": the mesh\'s texture coordinates; default: mesh',
        default=None,
    )
    scale: float = key(Number("m", above=0), "metres per unit of the mesh files", default=1.0)
    refine: int = key(
        Integer(),
        "how many times every triangle is split into four, of start and rest shape alike; selected nodes take along "
        "what lies between them",
        default=0,
    )
    refine_smooth: bool = key(
        Boolean(),
        "refine: new vertices on a smooth surface through the old ones, instead of the middles of their edges",
        default=False,
    )
    model: str = key(Choice(*MODELS), "elastic model", default="koiter")
    bending: str = key(Choice(*BENDING), "mid-edge normals of the Koiter model", default="tan")
    material: str = key(Choice(*MATERIALS), "material law", default="stvk")
    young: float = key(YOUNG, "Young's modulus")
    poisson: float = key(POISSON, "Poisson's ratio", default=0.3)
    thickness: float = key(THICKNESS, "thickness")
    density: float = key(DENSITY, "mass density")
    shrink: float = key(SHRINK, "what its edges lose of their rest length; below 0 they grow", default=0.0)
    fabric: str = key(Text(), LIBRARY, default="")
    young_weft: float | None = key(YOUNG, f"{WEFT}; default: that of the warp", default=None)
    shear: float | None = key(YOUNG, f"{SHEAR}; default: by Huber's rule", default=None)
    bending_warp: float | None = key(BENDS, f"{STRIPS}; default: of the thickness", default=None)
    bending_weft: float | None = key(BENDS, "the same along the weft", default=None)
    bending_twist: float | None = key(BENDS, f"{TWIST}; default: by Huber's rule", default=None)
    warp: Vector3 | str | None = key(Grain(), f"{WARP}; default: v", default=None)
    seam_bending: bool = key(
        Boolean(),
        "sewn edges whose ends are sewn vertex to vertex bend like the cloth; false: they turn freely",
        default=False,
    )
    seams: bool = key(Boolean(), "sew the mesh's stitch records", default=True)
    joints: bool = key(
        Boolean(),
        "more than two triangles may share an edge: two of them go on into each other, the other sheets are sewn to "
        "them",
        default=False,
    )
    joint_stiffness: float = key(
        Number("N", least=0),
        "moment per length of such an edge and radian that its sheets turn against each other; 0: they turn freely",
        default=0.0,
    )
    velocity: Vector3 = key(vector("m/s"), "dynamics: velocity at the start", default=(0.0, 0.0, 0.0))
    angular_velocity: Vector3 = key(
        vector("rad/s"), "dynamics: rotation at the start, about angular_center", default=(0.0, 0.0, 0.0)
    )
    angular_center: Vector3 = key(
        vector("m"), "point about which the shell rotates at the start", default=(0.0, 0.0, 0.0)
    )


@dataclass(frozen=True, kw_only=True)
class Fabric:
    group: str = key(Text(filled=True), "group of the mesh made of this fabric")
    young: float | None = key(YOUNG, "Young's modulus; default: the shell's", default=None)
    poisson: float | None = key(POISSON, "Poisson's ratio; default: the shell's", default=None)
    thickness: float | None = key(THICKNESS, "thickness; default: the shell's", default=None)
    density: float | None = key(DENSITY, "mass density; default: the shell's", default=None)
    shrink: float | None = key(
        SHRINK, "what its edges lose of their rest length; default: the shell's", default=None
    )
    fabric: str = key(Text(), LIBRARY, default="")
    young_weft: float | None = key(YOUNG, f"{WEFT}; default: the shell's", default=None)
    shear: float | None = key(YOUNG, f"{SHEAR}; default: the shell's", default=None)
    bending_warp: float | None = key(BENDS, f"{STRIPS}; default: the shell's", default=None)
    bending_weft: float | None = key(BENDS, "the same along the weft", default=None)
    bending_twist: float | None = key(BENDS, f"{TWIST}; default: the shell's", default=None)
    warp: Vector3 | str | None = key(Grain(), f"{WARP}; default: the shell's", default=None)


@dataclass(frozen=True, kw_only=True)
class Contact:
    offset: float | None = key(
        Number("m", least=0),
        "distance from the mid-surface to the surface that touches; default: half the thickness",
        default=None,
    )
    self_contact: bool = key(
        Boolean(), "contact of the shell with itself: mid-surfaces keep twice the offset", default=False
    )
    self_friction: float = key(
        Number(least=0), "Coulomb's coefficient of friction of the shell on itself", default=0.0
    )

    def check(self, given: set[str]) -> None:
        if self.self_contact and self.offset == 0.0:
            raise Rejected("0; allowed with self_contact: above 0, to keep layers apart", ("offset",))
        if self.self_friction > 0.0 and not self.self_contact:
            friction = f"{self.self_friction:g}"
            raise Rejected(f"{friction}; allowed without contact.self_contact = true: 0", ("self_friction",))


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A whole scene; `text` is the file's source with a comment line per override, `path` its path."""

    scene: Heading = key(Table(Heading), "the task", default=Heading())
    shell: Shell = key(Table(Shell), "the shell")
    fabric: tuple[Fabric, ...] = key(Tables(Fabric), "other fabrics, by group of the mesh", default=())
    loads: Loads = key(Table(Loads), "loads", default=Loads())
    fix: tuple[Fix, ...] = key(Tables(Fix), "supports", default=())
    spring: tuple[Spring, ...] = key(Tables(Spring), "elastic supports", default=())
    band: tuple[Band, ...] = key(Tables(Band), "elastic bands along edges", default=())
    tie: tuple[Tie, ...] = key(Tables(Tie), "bars between two vertices", default=())
    mass: tuple[Mass, ...] = key(Tables(Mass), "masses beside the fabric's", default=())
    section: tuple[Section, ...] = key(
        Tables(Section), "cuts whose section forces the summary gives", default=()
    )
    obstacle: tuple[Body, ...] = key(Tables(Obstacle), "bodies the shell touches", default=())
    contact: Contact = key(Table(Contact), "contact", default=Contact())
    statics: Statics = key(Table(Statics), "task = statics", default=Statics())
    dynamics: Dynamics = key(Table(Dynamics), "task = dynamics", default=Dynamics())
    modes: Modes = key(Table(Modes), "task = modes", default=Modes())
    inverse: Inverse = key(Table(Inverse), "task = inverse", default=Inverse())
    pattern: Pattern = key(Table(Pattern), "task = inverse: the sewing pattern", default=Pattern())
    output: Output = key(Table(Output), "results", default=Output())
    text: str = ""
    path: Path = Path()


def homes(name: str) -> list[str]:
    """The tables, as headed in the file, that have a key of this name."""
    found = []
    for table, kind in Table(Scene).keys.items():
        inner = kind.table if isinstance(kind, Tables) else kind
        if isinstance(inner, Table) and name in inner.keys:
            found.append(f"[[{table}]]" if isinstance(kind, Tables) else f"[{table}]")
    return found


def json_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of the scene file."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Voile scene"}
    return head | Table(Scene).schema()


def unsupported(scene: Scene) -> list[str]:
    """What the scene asks for that this version cannot compute yet, by key; empty when it can be run."""
    inverse = scene.scene.task == "inverse"
    asked = {
        f'scene.task = "{scene.scene.task}"': not TASKS[scene.scene.task],
        "contact.self_contact = true with inverse.estimate": inverse
        and scene.contact.self_contact
        and bool(scene.inverse.estimate),
    }
    return [what for what, used in asked.items() if used]
