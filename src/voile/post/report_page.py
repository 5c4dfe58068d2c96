"""The page around the shapes: HTML whose every text from scenes and results is escaped, and runs no script but ours."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
from collections.abc import Iterator
from html import escape
from importlib import resources
from typing import Any

from voile.arrays import Reals
from voile.post.camera import parse_scene
from voile.post.info import rows
from voile.post.pattern_svg import svg
from voile.post.plot import figure
from voile.post.report_arrays import LEVELS
from voile.post.report_shapes import Shown
from voile.post.series import ENERGIES, Recorded
from voile.results import Result, read_pattern, read_summary
from voile.results.pattern import FILE as PATTERN

PLOTTED = (ENERGIES, "contact_force", "max_displacement")
ALONG = {"dynamics": "time [s]", "statics": "load factor"}  # tasks whose steps follow one another
NOT_HTML = re.compile(r"<\?xml.*?\?>|<!DOCTYPE.*?>|<metadata>.*?</metadata>", re.DOTALL)
FILES = {
    "template": "page.html",
    "style": "page.css",
    "library": "three.min.js",
    "licence": "three.LICENSE",
    "viewer": "viewer.js",
    "controls": "controls.js",
}


class Page:
    """What a page has beside the shapes. size: its bytes."""

    def __init__(self, result: Result):
        folder = resources.files("voile.post") / "page"
        self.files = {name: (folder / file).read_text(encoding="utf-8") for name, file in FILES.items()}
        self.scene = parse_scene(result.scene_text)
        beside = result.path.with_name("summary.json")
        self.summary = read_summary(beside) if beside.is_file() else {}
        self.result = result
        self.plots, self.axis = self._plots()
        self.sections = "".join(self._sections())
        self.size = sum(len(text.encode()) for text in (*self.files.values(), self.sections))

    def text(self, shapes: Shown, opening: dict[str, Any]) -> str:
        """The page with shapes, as it opens."""
        data = {**shapes.meta, **opening, "cursor": self._cursor(self.result.values[shapes.steps])}
        viewer = self.files["viewer"] + self.files["controls"]
        scripts = " ".join(f"'sha256-{_hash(text)}'" for text in (self.files["library"], viewer))
        rules = (
            "default-src 'none'",
            f"script-src {scripts}",
            "style-src 'unsafe-inline'",
            "base-uri 'none'",
        )
        verdict, outcome = self._outcome()
        filled = {
            "policy": "; ".join((*rules, "form-action 'none'")),
            "generator": escape(f"voile {self.result.versions.get('voile', '')}".strip()),
            "title": escape(self._title()),
            "style": self.files["style"],
            "verdict": verdict,
            "outcome": escape(outcome),
            "message": "Drawing ...",
            "sections": _notes([*self._noted(), *_left_out(self.result, shapes)]) + self.sections,
            "licence": escape(self.files["licence"]),
            "data": json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
            "arrays": shapes.arrays,
            "library": self.files["library"],
            "viewer": viewer,
        }
        # in one pass: a text that looks like a place of the template stays a text
        return re.sub(r"\{\{(\w+)\}\}", lambda place: filled[place[1]], self.files["template"])

    def _title(self) -> str:
        return str(self.scene.get("scene", {}).get("name") or self.result.path.absolute().parent.name)

    def _outcome(self) -> tuple[str, str]:
        """Class of style.css and words: how the run ended."""
        if not self.summary:
            return "unknown", "no summary: the run has not ended"
        reason = str(self.summary.get("reason", ""))
        if not self.summary.get("converged"):
            return "bad", f"not converged: {reason}"
        return "good", f"converged: {reason}" if reason else "converged"

    def _noted(self) -> list[str]:
        notes = [str(note) for note in self.summary.get("notes", [])]
        return (
            notes
            if self.result.ended
            else [*notes, "the run has not ended, or was killed: these are its steps so far"]
        )

    def _sections(self) -> Iterator[str]:
        if self.plots:
            yield f'<section><h2>Plots</h2><div id="plots">{self.plots}<div id="cursor"></div></div></section>'
        if (self.result.path.parent / PATTERN).is_file():
            drawn = _inline(svg(read_pattern(self.result.path)))
            yield (
                f'<section><h2>Pattern</h2><p><button id="save-pattern" type="button">Save as SVG</button> '
                f'<span class="quiet">true scale, millimetres</span></p><div id="pattern">{drawn}</div></section>'
            )
        if self.summary:
            lines = "".join(
                f'<tr class="{"head" if text is None else ""}"><td style="padding-left: {1.2 * depth}em">'
                f"{escape(key.replace('_', ' '))}</td><td>{escape(text or '')}</td></tr>"
                for depth, key, text in rows({k: v for k, v in self.summary.items() if k != "notes"})
            )
            yield f"<section><h2>Figures</h2><table>{lines}</table></section>"
        text = escape(self.result.scene_text)
        yield f"<section><h2>Scene</h2><details><summary>scene file</summary><pre>{text}</pre></details></section>"

    def _plots(self) -> tuple[str, tuple[float, float, float, float] | None]:
        """SVG of what was recorded, "" where nothing follows on anything; its axis: left end and width as shares of
        the picture's, and their values."""
        task = self.scene.get("scene", {}).get("task", "statics")
        if task not in ALONG:
            return "", None
        recorded = Recorded(self.result, task == "dynamics")
        names = [name for name in PLOTTED if name in recorded.names]
        panels = [recorded.series(name) for name in names]
        lines = [k for k, panel in enumerate(panels) if panel and max(len(s.at) for s in panel) > 1]
        if not lines:
            return "", None
        import matplotlib

        text = io.BytesIO()
        with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "voile"}):
            picture = figure([panels[k] for k in lines], [names[k] for k in lines], ALONG[task])
            picture.savefig(text, format="svg", metadata={"Date": None})
        axes = picture.axes[0]
        place, (low, high) = axes.get_position(), axes.get_xlim()
        return _inline(text.getvalue()), (place.x0, place.width, low, high)

    def _cursor(self, values: Reals) -> list[float]:
        """Where each step is on the plots' axis, as shares of the picture's width."""
        if self.axis is None:
            return []
        left, width, low, high = self.axis
        found: list[float] = (left + width * (values - low) / (high - low)).round(5).tolist()
        return found


def _left_out(result: Result, shapes: Shown) -> list[str]:
    """What of the run a page does not show."""
    steps, vertices = shapes.count, len(shapes.part.vertices)
    notes = []
    if steps < result.n_steps:
        notes.append(
            f"{steps} of {result.n_steps} steps are shown, evenly spread: the page has room for no more"
        )
    if vertices < result.n_points:
        notes.append(f"{vertices} of {result.n_points} vertices are shown: the page has room for no more")
    grid = shapes.meta["points"]["spacing"]
    return [
        *notes,
        f"places are rounded to {grid:.1g} m, colours to 1/{LEVELS} of their scale; figures are exact",
    ]


def _notes(notes: list[str]) -> str:
    items = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return f"<section><h2>Notes</h2><ul>{items}</ul></section>"


def _inline(written: bytes) -> str:
    """A picture as part of a page: without what XML files begin with."""
    return NOT_HTML.sub("", written.decode("utf-8")).strip()


def _hash(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
