#!/usr/bin/env python
"""Runs a notebook from its first cell to its last, as Jupyter does but without it, and stores what the cells print and
draw: .venv/bin/python scripts/run_notebook.py FILE.ipynb [...]"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import sys
from pathlib import Path
from typing import Any


def run(notebook: dict[str, Any]) -> dict[str, Any]:
    """The same notebook with new outputs. An exception of a cell is raised."""
    import matplotlib

    matplotlib.use("Agg")
    names: dict[str, Any] = {"__name__": "__main__"}
    cells, count = [], 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            cell = {
                **cell,
                "execution_count": count,
                "outputs": outputs("".join(cell["source"]), names, count),
            }
        cells.append(cell)
    return {**notebook, "cells": cells}


def outputs(source: str, names: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """Runs a cell in `names`: what it printed, drew with matplotlib, and the value of its last line."""
    body = ast.parse(source).body
    value = None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), f"cell {count}", "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), f"cell {count}", "eval"), names)
    found: list[dict[str, Any]] = []
    if printed.getvalue():
        text = printed.getvalue().splitlines(keepends=True)
        found.append({"output_type": "stream", "name": "stdout", "text": text})
    for picture in figures():
        found.append({"output_type": "display_data", "metadata": {}, "data": {"image/png": picture}})
    if value is not None:
        data = {"text/plain": [repr(value)]}
        if hasattr(value, "_repr_png_"):
            data["image/png"] = text64(value._repr_png_())
        found.append(
            {"output_type": "execute_result", "execution_count": count, "metadata": {}, "data": data}
        )
    return found


def figures() -> list[str]:
    """The open figures of matplotlib, which are closed."""
    from matplotlib import pyplot

    drawn = []
    for number in pyplot.get_fignums():
        data = io.BytesIO()
        pyplot.figure(number).savefig(data, format="png", bbox_inches="tight", dpi=80)
        drawn.append(text64(data.getvalue()))
    pyplot.close("all")
    return drawn


def text64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def main(paths: list[str]) -> None:
    for path in map(Path, paths):
        new = run(json.loads(path.read_text(encoding="utf-8")))
        path.write_text(json.dumps(new, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main(sys.argv[1:])
