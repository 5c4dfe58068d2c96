"""The commands: one file each, found by listing this folder.

A file NAME.py is `voile NAME`. It holds `TEXT` (one line of help), `arguments(parser)`, and `run(args)`, which returns
an exit code or None for 0. Files whose name starts with an underscore are no commands.
"""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType


def all_commands(only: str = "") -> dict[str, ModuleType]:
    """Name -> module, by name; where `only` is one of them, that one. They import what they need when they run, so that
    `voile --help` is quick."""
    names = sorted(module.name for module in iter_modules(__path__) if not module.name.startswith("_"))
    return {name: import_module(f"{__name__}.{name}") for name in ([only] if only in names else names)}
