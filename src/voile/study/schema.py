"""Every key of a study file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from voile.keys import Array, Choice, File, Integer, Number, Rejected, Table, Tables, Text, key
from voile.keys.kinds import show, wrong_type
from voile.scene.loads import SELECT
from voile.study.settings import Settings, brief, check, flattened, full

EXTRAPOLATE = "extrapolate"


class Given:
    """A table of settings: keys of scenes, their values checked."""

    def read(self, value: Any) -> Settings:
        if not isinstance(value, dict):
            raise wrong_type(value, self)
        found = {}
        for at, entry in flattened(value):
            name = brief(".".join(at))
            try:
                self.check(name, entry)
                if name in found:
                    raise Rejected(f'the key "{full(name)}" is there twice')
            except Rejected as error:
                raise Rejected(error.problem, at) from None
            found[name] = entry
        return found

    def check(self, name: str, entry: Any) -> None:
        """Raises Rejected."""
        check(name, entry)

    def allowed(self) -> str:
        return 'a table of scene keys, such as { "shell.bending" = "tan", refine = 2 }'

    def schema(self) -> dict[str, Any]:
        return {"type": "object"}


class Lists(Given):
    """A table of settings with a list of values each."""

    def check(self, name: str, entry: Any) -> None:
        if not isinstance(entry, list):
            check(name, entry)  # a key that no scene has is the first thing to tell
            raise Rejected(f"{show(entry)}; allowed: an array of values to try, such as [{show(entry)}, ...]")
        if not entry:
            raise Rejected("[]; allowed: an array of one value or more to try")
        for value in entry:
            check(name, value)
        for k, value in enumerate(entry):
            if value in entry[:k]:
                raise Rejected(f"{show(value)} is there twice; allowed: each value once")

    def allowed(self) -> str:
        return "a table of scene keys with an array of values each, such as refine = [0, 1, 2]"


@dataclass(frozen=True)
class Known:
    """A reference value: of all measures, or by measure."""

    values: dict[str, float]
    every: float | None = None

    def of(self, measure: str) -> float | None:
        return self.values.get(measure, self.every)


class Reference:
    """What errors are measured from: Settings of a run, Known values, or EXTRAPOLATE."""

    def read(self, value: Any) -> Settings | Known | str:
        if value == EXTRAPOLATE:
            return EXTRAPOLATE
        if isinstance(value, int | float) and not isinstance(value, bool):
            return Known({}, Number().read(value))
        if not isinstance(value, dict) or not value:
            raise Rejected(f"{show(value)}; allowed: {self.allowed()}")
        if "value" not in value:
            return Given().read(value)
        if len(value) > 1:
            raise Rejected(f"value and {', '.join(k for k in value if k != 'value')} do not go together")
        known = value["value"]
        try:
            if isinstance(known, dict):
                return Known({name: Number().read(v) for name, v in known.items()})
            return Known({}, Number().read(known))
        except Rejected as error:
            raise error.under("value") from None

    def allowed(self) -> str:
        return (
            "settings of a run such as { refine = 4 }, { value = 3.286 }, { value = { NAME = 3.286 } } for measures by "
            f'name, or "{EXTRAPOLATE}"'
        )

    def schema(self) -> dict[str, Any]:
        return {"anyOf": [{"type": "object"}, {"type": "number"}, {"const": EXTRAPOLATE}]}


@dataclass(frozen=True, kw_only=True)
class Heading:
    scene: Path = key(File(), "scene file, or a friction problem's, relative to the study's")
    measure: tuple[str, ...] | str = key(
        Array(Text(filled=True), least=1, lone=True),
        "names of figures of summary.json (dotted: contact.active), of points, max_displacement, or energy, their sum",
    )
    reference: Any = key(Reference(), "what errors are measured from")
    accuracy: tuple[float, ...] = key(
        Array(Number(above=0), least=1),
        "relative errors to recommend settings for",
        default=(0.05, 0.01, 0.001),
    )
    repeats: int = key(Integer(1), "runs under 2 s are run this often; their median seconds count", default=3)
    clock: str = key(
        Choice("wall", "cpu"),
        "seconds that count: on the wall, or of the processors (of all ranks), steadier on a busy machine",
        default="wall",
    )
    max_seconds: float = key(Number("s", least=0), "a run that takes longer is ended; 0: never", default=0.0)
    launcher: str = key(
        Text(), "what starts a run on {ranks} MPI processes; default: mpirun -n {ranks}", default=""
    )

    @property
    def measures(self) -> tuple[str, ...]:
        return (self.measure,) if isinstance(self.measure, str) else self.measure


@dataclass(frozen=True, kw_only=True)
class Point:
    name: str = key(Text(filled=True), "name of the measure")
    select: dict[str, Any] = key(SELECT, "vertices, as in scenes")
    of: str = key(
        Choice("displacement", "position", "velocity", "reaction"),
        "mean over the selected area, line or vertices; of reactions the sum",
        default="displacement",
    )
    axis: str = key(Choice("x", "y", "z", "norm"), "component, or length", default="norm")


@dataclass(frozen=True, kw_only=True)
class Case:
    name: str = key(Text(filled=True), "name in the table")
    set: Settings = key(Given(), "settings")


@dataclass(frozen=True, kw_only=True)
class Study:
    """A study file."""

    study: Heading = key(Table(Heading), "what to study")
    point: tuple[Point, ...] = key(Tables(Point), "measures at selected vertices", default=())
    vary: dict[str, list[Any]] = key(
        Lists(), "settings of which every combination is run", default_factory=dict
    )
    case: tuple[Case, ...] = key(Tables(Case), "named combinations beside them", default=())

    @property
    def names(self) -> set[str]:
        """The settings that it gives."""
        return {*self.vary, *(name for case in self.case for name in case.set)}

    def check(self, given: set[str]) -> None:
        if not (self.vary or self.case):
            raise Rejected("nothing to compare; allowed: [vary] or [[case]], or both")
        for table in ("point", "case"):
            names = [each.name for each in getattr(self, table)]
            for k, name in enumerate(names):
                if name in names[:k]:
                    raise Rejected(f'"{name}" is there twice; allowed: each name once', (table, k, "name"))
        measures = self.study.measures
        for k, name in enumerate(measures):
            if name in measures[:k]:
                raise Rejected(f'"{name}" is there twice; allowed: each measure once', ("study", "measure"))
        known = self.study.reference
        if isinstance(known, Known):
            wrong = [name for name in known.values if name not in measures]
            lacks = [name for name in measures if known.of(name) is None]
            if wrong or lacks:
                problem = f'"{wrong[0]}" is no measure' if wrong else f'no value for "{lacks[0]}"'
                raise Rejected(
                    f"{problem}; allowed: one for each of {', '.join(measures)}", ("study", "reference")
                )
            if known.every is not None and len(measures) > 1:
                raise Rejected(
                    f"one value for {len(measures)} measures; allowed: value = {{ {measures[0]} = ..., ... }}",
                    ("study", "reference"),
                )
