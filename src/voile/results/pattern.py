"""`pattern.json` of a result: the sewing pattern (voile.mesh.Pattern) as plain JSON, lengths in metres."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from voile.arrays import Reals
from voile.errors import InputError
from voile.mesh import Notches, Pattern, Piece, SewnSeam
from voile.results.folder import replace

FILE = "pattern.json"
VERSION = 1


def write_pattern(folder: str | Path, pattern: Pattern) -> None:
    """Write a pattern to a result's folder. InputError if that cannot be done."""
    path = Path(folder) / FILE
    try:
        text = json.dumps({"version": VERSION, **asdict(pattern)}, default=np.ndarray.tolist)
        replace(path, text.encode("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def read_pattern(result: str | os.PathLike[str]) -> Pattern:
    """The pattern of a result, given its folder or a file in it. InputError where it has none or it is damaged."""
    folder = Path(result) if Path(result).is_dir() else Path(result).parent
    path = folder / FILE
    if not path.is_file():
        raise InputError(
            f"{result}: no {FILE} with a sewing pattern; inverse runs write it where their rest shape can be laid flat"
        )
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["version"] != VERSION:
            raise InputError(f"{path}: version {data['version']}, allowed: {VERSION}")
        return Pattern(
            tuple(_piece(p) for p in data["pieces"]),
            tuple(
                SewnSeam(
                    s["label"],
                    (s["pieces"][0], s["pieces"][1]),
                    (np.array(s["sides"][0]), np.array(s["sides"][1])),
                    (s["lengths"][0], s["lengths"][1]),
                    s["allowance"],
                    s["ease"],
                )
                for s in data["seams"]
            ),
            data["allowance"],
            data["tolerance"],
            tuple(data["mirrors"]),
            data["symmetrised"],
            tuple(data["fabric"]) if data["fabric"] else None,
        )
    except (OSError, UnicodeDecodeError, KeyError, TypeError, IndexError, json.JSONDecodeError) as error:
        raise InputError(f"{path}: damaged pattern file: {type(error).__name__}: {error}") from None


def _piece(data: dict[str, Any]) -> Piece:
    n = data["notches"]
    reach = np.array(n["allowance"], dtype=float)
    notches = Notches(_pairs(n["points"]), _pairs(n["inward"]), reach, tuple(n["labels"]))
    points, stretches, grain = (_pairs(data[key]) for key in ("points", "stretches", "grain"))
    cut = tuple(_pairs(ring) for ring in data["cut"])
    triangles, outline, turns = (np.array(data[key], dtype=int) for key in ("triangles", "outline", "turns"))
    return Piece(data["name"], points, triangles, stretches, outline, cut, turns, grain, notches)


def _pairs(rows: list[list[float]]) -> Reals:
    return np.array(rows, dtype=float).reshape(-1, 2)
