"""Equilibria and inverse design of thin elastic shells with contact and friction, on PETSc."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from voile import blas

blas.prepare()  # before numpy loads it

if TYPE_CHECKING:
    from voile.api import Result, load, read, run
    from voile.errors import InputError, NotConverged

_LATER = {  # name -> its module, imported when first asked for
    "InputError": "voile.errors",
    "NotConverged": "voile.errors",
    "Result": "voile.api",
    "load": "voile.api",
    "read": "voile.api",
    "run": "voile.api",
}
__all__ = ["InputError", "NotConverged", "Result", "load", "read", "run"]

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module 'voile' has no attribute {name!r}")
    return getattr(import_module(_LATER[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER})
