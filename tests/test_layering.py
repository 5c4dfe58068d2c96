"""The rules on which package may import which, and on the length of files."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "voile"
MAX_LINES = 400

# Package or module of voile -> what of voile it may import beside itself, voile.arrays and voile.errors.
ALLOWED = {
    "arrays": set(),
    "errors": set(),
    "launch": set(),
    "files": set(),
    "signals": {"files"},
    "keys": {"mesh"},
    "blas": {"_petsc"},
    "petsc_options": {"_petsc", "launch"},
    "mesh": {"files"},
    "elastic": {"_kernels", "mesh"},
    "contact": {"_kernels", "_friction", "_projective", "keys", "mesh"},
    "scene": {"keys", "mesh", "elastic", "contact"},
    "problem": {"_kernels", "_petsc", "launch", "mesh", "elastic", "contact"},
    "solver": {
        "_kernels",
        "_friction",
        "_petsc",
        "_projective",
        "launch",
        "mesh",
        "elastic",
        "contact",
        "problem",
    },
    "inverse": {"_kernels", "mesh", "elastic", "contact", "problem", "solver"},
    "results": {"files", "mesh"},
    "post": {"files", "keys", "results"},
    "study": {"_kernels", "files", "keys", "mesh", "elastic", "scene", "results"},
}
# The command line and its helpers, the only ones that see everything.
TOP = {"afterwards", "api", "cli", "commands", "explain", "held", "tasks", "validate", "wiring"}
PETSC = {"problem", "solver", "inverse", "petsc_options"} | TOP


def imports(tree: ast.Module, package: str) -> set[str]:
    """Dotted names imported by a module of the given package, also in functions; `from a import b` as a.b."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parents, base] if base else parents)
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return names


def faults(unit: str, names: set[str]) -> list[str]:
    """What a module of voile.<unit> imports against the rules; `unit` is a key of ALLOWED or in TOP."""
    found = []
    for name in sorted(names):
        root, _, rest = name.partition(".")
        part = rest.partition(".")[0]
        if root in ("petsc4py", "slepc4py") and unit not in PETSC:
            found.append(f"{unit} imports {root}")
        if root == "voile" and unit not in TOP and part not in ALLOWED[unit] | {unit, "errors", "arrays"}:
            found.append(f"{unit} imports voile.{part}")
    return found


def modules() -> list[Path]:
    return sorted(p for p in SOURCE.rglob("*.py") if p != SOURCE / "__init__.py")


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_go_one_way(path):
    inside = path.relative_to(SOURCE)
    unit = inside.parts[0].removesuffix(".py")
    assert unit in ALLOWED.keys() | TOP, f"voile.{unit} has no place in the layers: name it in ALLOWED or TOP"
    package = ".".join(("voile", *inside.parent.parts))
    assert not faults(unit, imports(ast.parse(path.read_text()), package))


@pytest.mark.parametrize(
    ("unit", "text", "fault"),
    [
        ("mesh", "from voile.elastic import evaluate", "mesh imports voile.elastic"),
        ("elastic", "import voile.contact.law", "elastic imports voile.contact"),
        ("contact", "from voile import elastic", "contact imports voile.elastic"),
        ("contact", "def f():\n    from petsc4py import PETSc", "contact imports petsc4py"),
        ("problem", "from voile.scene import Scene", "problem imports voile.scene"),
        ("solver", "from ..results import ResultWriter", "solver imports voile.results"),
        ("post", "from voile import mesh", "post imports voile.mesh"),
        ("results", "import slepc4py", "results imports slepc4py"),
        (
            "problem",
            "from ..elastic import evaluate\nfrom .shell import Shell\nfrom voile.errors import InputError",
            None,
        ),
        ("cli", "import petsc4py\nfrom voile.scene import read_scene", None),
    ],
)
def test_the_rules_catch_what_they_forbid(unit, text, fault):
    found = faults(unit, imports(ast.parse(text), "voile" if unit in TOP else f"voile.{unit}"))
    assert found == ([fault] if fault else [])


def file_circles(needs: dict[str, set[str]]) -> list[list[str]]:
    """Modules that import each other, directly or not: the strongly connected parts of more than one."""
    reached: dict[str, set[str]] = {}
    for name in needs:
        seen, todo = set[str](), list(needs[name])
        while todo:
            if (other := todo.pop()) not in seen:
                seen.add(other)
                todo += needs.get(other, ())
        reached[name] = seen
    parts = {tuple(sorted({n} | {m for m in reached[n] if n in reached.get(m, ())})) for n in needs}
    return [list(part) for part in sorted(parts) if len(part) > 1 or part[0] in needs[part[0]]]


def needs_of(paths: list[Path]) -> dict[str, set[str]]:
    """What each module of voile imports of voile, by dotted names, in functions and for types too."""
    names = {".".join(p.relative_to(SOURCE.parent).with_suffix("").parts): p for p in paths}
    needs = {}
    for name, path in names.items():
        package = ".".join(("voile", *path.relative_to(SOURCE).parent.parts))
        found = imports(ast.parse(path.read_text()), package)
        needs[name] = {n if n in names else n.rpartition(".")[0] for n in found} & names.keys()
    return needs


def test_no_files_import_each_other():
    assert file_circles(needs_of(modules())) == []


def test_circles_are_found():
    assert file_circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert file_circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_files_stay_short():
    files = [
        p
        for folder in ("src", "tests", "scripts", "meshes")
        for p in (ROOT / folder).rglob("*")
        if p.is_file()
    ]
    texts = [p for p in files if p.suffix in {".py", ".cpp", ".hpp"} or p.parent.name == "scripts"]
    assert len(texts) > 30
    lengths = {str(p.relative_to(ROOT)): len(p.read_text().splitlines()) for p in texts}
    assert {name: n for name, n in lengths.items() if n > MAX_LINES} == {}
