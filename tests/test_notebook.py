"""The notebook is true: every cell runs without a screen and gives what the file shows."""

import base64
import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))
import run_notebook  # noqa: E402


def told(cell):
    """What a cell printed, its value, and how many pictures it drew."""
    outputs = cell.get("outputs", [])
    pictures = [out["data"]["image/png"] for out in outputs if "image/png" in out.get("data", {})]
    assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)
    return [out.get("text") or out["data"].get("text/plain") for out in outputs], len(pictures)


def test_the_notebook_is_true():
    pytest.importorskip("matplotlib")
    stored = json.loads((ROOT / "docs" / "notebook.ipynb").read_text(encoding="utf-8"))
    for old, new in zip(stored["cells"], run_notebook.run(stored)["cells"], strict=True):
        assert told(new) == told(old), "".join(old["source"])
    assert sum(told(cell)[1] for cell in stored["cells"]) == 3
