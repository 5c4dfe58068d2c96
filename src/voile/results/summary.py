"""`summary.json`: the figures of a run, in one file that scripts read."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from voile.errors import InputError
from voile.files import replace


def write_summary(path: str | os.PathLike[str], summary: dict[str, Any]) -> None:
    """Write `summary` (keys of the interface: converged, reason, task, dofs, ...) as JSON, all or nothing.

    numpy numbers and arrays become JSON numbers and lists. Raises ValueError naming the key of a number that
    is not finite (JSON has none), TypeError for a value JSON cannot hold; the old file then stays as it is.
    """
    text = json.dumps(_plain(summary, ""), indent=2, allow_nan=False) + "\n"
    replace(Path(path), text.encode("utf-8"))


def read_summary(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The summary at `path`. Raises InputError where there is none or it is not JSON of an object."""
    try:
        summary = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read the summary: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: not a JSON summary: {error}") from error
    if not isinstance(summary, dict):
        raise InputError(f"{path}: not a summary: a JSON object expected")
    return summary


def _plain(value: Any, key: str) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v, f"{key}.{k}" if key else str(k)) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(v, f"{key}[{i}]") for i, v in enumerate(value)]
    if isinstance(value, float) and not np.isfinite(value):
        raise ValueError(f"summary key {key} is {value}; a summary holds finite numbers only")
    return value
