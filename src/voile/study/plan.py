"""From a study file to its runs, each with all that decides its result."""

import dataclasses
import hashlib
import itertools
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from voile.errors import InputError
from voile.keys import Rejected, Table
from voile.scene import Scene, read_scene, unsupported
from voile.scene.reader import KeyPath, read_source, refusal
from voile.study.measures import Measure, find_measures
from voile.study.problems import KEYS, Problem, find_problem, is_problem
from voile.study.schema import EXTRAPOLATE, Known, Study
from voile.study.settings import (
    COST,
    DISCRETE,
    RANKS,
    TIME,
    Settings,
    brief,
    changes,
    different,
    full,
    overrides,
    taken,
    told,
    value_of,
)

# Parts of the program that no result depends on.
APART = {"study", "post", "commands"}
NUMBERED = ("%0", "%d")  # in the name of a file that stands for many


@dataclasses.dataclass(frozen=True)
class Run:
    """A variant: its name in tables, settings, and `scene` or problem with them, None where none may be so (refused
    says why).
    key: what decides its result, as a hash. effective: of all settings that the study touches, defaults included."""

    name: str
    settings: Settings
    scene: Scene | Problem | None
    refused: str
    key: str
    effective: Settings

    @property
    def ranks(self) -> int:
        return int(self.settings.get(RANKS, 1))

    @property
    def folder(self) -> str:
        """Name of its folder."""
        words = "".join(c if c.isalnum() or c in "=._+-" else "-" for c in self.name)
        return f"{words[:60].strip('-')}-{self.key[:8]}"


@dataclasses.dataclass(frozen=True)
class Plan:
    """A study: file, file of the scene or friction problem, runs without doubles, and the number of the reference's
    among them, None where it is a value or extrapolated."""

    path: Path
    study: Study
    scene: Path
    runs: tuple[Run, ...]
    measures: tuple[Measure, ...]
    reference: int | None

    @property
    def varied(self) -> list[str]:
        """The settings that differ between runs."""
        names = list(dict.fromkeys(name for run in self.runs for name in run.effective))
        return [n for n in names if len({repr(run.effective[n]) for run in self.runs}) > 1]


def read_plan(path: Path) -> Plan:
    """A study file's plan. Raises InputError that names file, line and key, what is wrong and what is allowed."""
    source = read_source(path, "a study file")
    try:
        study = Table(Study).read(source.tree)
    except Rejected as error:
        raise refusal(path, source.places, error.problem, error.path) from None
    scene_path = path.parent / study.study.scene
    base = find_problem(scene_path, {}) if is_problem(scene_path) else read_scene(scene_path)
    measures = find_measures(study, base, lambda problem, at: refusal(path, source.places, problem, at))
    given = list(_given(study))
    for name in study.vary:
        if _lacks(base, name):
            where = next((k for k in source.places if brief(".".join(map(str, k[1:]))) == name), ("vary",))
            raise refusal(path, source.places, f"{scene_path} has no {_lacks(base, name)}", where)
    names = list(dict.fromkeys(full(name) for _, settings in given for name in settings))
    runs: dict[str, Run] = {}
    keys = []
    for name, settings in given:
        run = _run(name, settings, scene_path, names)
        runs.setdefault(run.key, run)
        keys.append(run.key)
    found = tuple(runs.values())
    if all(run.scene is None for run in found):
        raise InputError(f"{path}: no combination can be run; the first, {found[0].name}: {found[0].refused}")
    reference = None
    if isinstance(study.study.reference, dict):
        reference = list(runs).index(keys[-1])
        if found[reference].scene is None:
            at: KeyPath = ("study", "reference")
            raise refusal(path, source.places, found[reference].refused, at)
    if study.study.reference == EXTRAPOLATE:
        _check_levels(study, path, source.places)
    return Plan(path, study, scene_path, found, measures, reference)


def _given(study: Study) -> Iterator[tuple[str, Settings]]:
    """Name and settings of every run, the reference's last."""
    if study.vary:
        for values in itertools.product(*study.vary.values()):
            settings = dict(zip(study.vary, values, strict=True))
            yield told(settings), settings
    for case in study.case:
        yield case.name, case.set
    reference = study.study.reference
    if not isinstance(reference, Known | str):
        yield f"reference {told(reference)}", reference


def _lacks(scene: Scene | Problem, name: str) -> str:
    """The key of one that is of the other, scene or friction problem; the part of a key that counts a table which the
    scene has not; empty if it has all."""
    if isinstance(scene, Problem) != (name in KEYS):
        return f"{name}; allowed: {', '.join(KEYS) if isinstance(scene, Problem) else 'keys of scenes'}"
    parts = full(name).split(".")
    for k, part in enumerate(parts):
        if part.isdecimal() and value_of(scene, ".".join(parts[: k + 1])) is None:
            return f"[[{'.'.join(parts[:k])}]] of number {part}"
    return ""


def _check_levels(study: Study, path: Path, places: dict[KeyPath, str]) -> None:
    """Raises InputError where nothing can be extrapolated."""
    longest = max((len(v) for n, v in study.vary.items() if changes(n) in (DISCRETE, TIME)), default=0)
    if longest < 3:
        problem = (
            f'"{EXTRAPOLATE}" needs three meshes or time steps; allowed: refine, "shell.mesh" or '
            '"dynamics.time_step" in [vary] with three values or more, or another reference'
        )
        raise refusal(path, places, problem, ("study", "reference"))


def _run(name: str, settings: Settings, path: Path, names: list[str]) -> Run:
    scene, refused = None, ""
    try:
        scene = _varied(path, settings)
    except InputError as error:
        refused = str(error)
    own, bare = {RANKS: settings.get(RANKS, 1)}, scene and taken(scene)
    effective = {
        brief(n): own[n]
        if n in own
        else value_of(bare, n)
        if bare
        else settings.get(brief(n), settings.get(n))
        for n in names
    }
    return Run(name, settings, scene, refused, _key(bare, settings), effective)


def _varied(path: Path, settings: Settings) -> Scene | Problem:
    """A scene, or a friction problem, with settings. Raises InputError."""
    if is_problem(path):
        return find_problem(path, settings)
    scene = read_scene(path, overrides(settings))
    if missing := unsupported(scene):
        raise InputError(f"this version cannot run {'; '.join(missing)}")
    return scene


# ---- what decides a result ----


def _key(scene: Scene | Problem | None, settings: Settings) -> str:
    """Hash of what a scene takes with the contents of its files, of settings beside it, and of the program."""
    parts: list[Any] = [program(), settings.get(RANKS, 1)]
    bare = dataclasses.replace(scene, text="", path=Path()) if isinstance(scene, Scene) else scene
    parts.append(contents(bare) if bare else sorted(settings.items()))
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def contents(value: Any) -> Any:
    """A scene's table, or what it holds, with the contents of files for their paths."""
    if isinstance(value, Path):
        return _digest(value)
    if isinstance(value, tuple | list):
        return [contents(each) for each in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value) if field.metadata]
        return [(name, contents(getattr(value, name))) for name in names]
    return value


def _digest(path: Path) -> Any:
    if any(sign in path.name for sign in NUMBERED):
        pattern = path.name.partition("%")[0]
        return [_digest(each) for each in sorted(path.parent.glob(f"{pattern}*"))]
    if not path.is_file():
        return str(path)
    if path.suffix == ".toml":  # another scene (inverse.also)
        return contents(dataclasses.replace(read_scene(path), text="", path=Path()))
    return hashlib.sha256(path.read_bytes()).hexdigest()


@cache
def program() -> str:
    """Hash of the version and of those modules that results depend on."""
    root = Path(__file__).parents[1]
    found = hashlib.sha256(version("voile").encode())
    for path in sorted(root.rglob("*.py")):
        if path.relative_to(root).parts[0] not in APART:
            found.update(path.read_bytes())
    import voile._kernels as kernels  # the compiled modules lie side by side

    for path in sorted(Path(kernels.__file__).parent.glob("_*.so")):
        found.update(path.read_bytes())
    return found.hexdigest()


def changed(run: Run, origin: Run) -> dict[str, list[str]]:
    """What a run changes of another: kind of change -> settings, cost last."""
    found: dict[str, list[str]] = {}
    for name in different(run.effective, origin.effective):
        kind = changes(name, run.effective[name], origin.effective[name])
        found.setdefault(kind, []).append(name)
    return dict(sorted(found.items(), key=lambda item: item[0] == COST))
