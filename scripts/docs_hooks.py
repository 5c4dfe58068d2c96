"""What mkdocs cannot: pages made from the program, equations without scripts, links to files beside docs."""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)(#[^)]*)?\)")
PLURAL = {"number": "numbers", "integer": "integers", "string": "strings"}
BLOCK, INLINE = re.compile(r"^\$\$\n(.*?)\n\$\$$", re.M | re.S), re.compile(r"\$`(.+?)`\$")


def on_files(files, config):
    """Adds the pages that are made from the program."""
    from mkdocs.structure.files import File

    for name, text in (
        ("reference.md", scene_keys()),
        ("commands.md", commands()),
        ("notebook.md", notebook()),
    ):
        files.append(File.generated(config, name, content=text))
    return files


def on_config(config):
    """Lists the pages that the navigation lacks."""
    known = set(re.findall(r"[\w-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    more = sorted(page.name for page in (ROOT / "docs").glob("*.md") if page.name not in known)
    if more:
        config.nav.append({"More": more})
    return config


def on_page_markdown(markdown, page, config, files):
    """Equations as MathML, which browsers draw themselves; files beside docs by their names."""
    from latex2mathml.converter import convert

    markdown = BLOCK.sub(lambda found: convert(found[1], display="block"), markdown)
    markdown = INLINE.sub(lambda found: convert(found[1]), markdown)
    return OUTSIDE.sub(_name, markdown)


def on_post_page(output, page, config):
    """The script that search needs on the disk comes with the site, not from the network."""
    return output.replace("https://unpkg.com/iframe-worker/shim", "assets/iframe-worker.js")


def _name(found):
    text, path = found[1], found[2]
    return f"`{path}`" if path.endswith(text) else f"{text} (`{path}`)"


def notebook() -> str:
    """docs/notebook.ipynb with what its cells printed and drew."""
    parts = []
    for cell in json.loads((ROOT / "docs" / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for out in cell.get("outputs", []):
            data = out.get("data", {})
            if "image/png" in data:
                parts.append(f"![Output](data:image/png;base64,{data['image/png']})")
            elif text := "".join(out.get("text") or data.get("text/plain", [])):
                parts.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts) + "\n"


def scene_keys() -> str:
    """Every key of a scene, from the JSON schema that `voile schema` prints."""
    schema = json.loads(
        subprocess.run(
            [sys.executable, "-m", "voile.cli", "schema"], check=True, capture_output=True, text=True
        ).stdout
    )
    lines = [
        "# Scene keys",
        "",
        "Made from `voile schema`. SI units, right-handed axes, radians unless a name says otherwise. Any key can be "
        "set on the command line: `--set shell.young=2e6`, `--set obstacle.0.friction=0.1`.",
    ]
    for name, table in schema["properties"].items():
        many = table.get("type") == "array"
        inside = table["items"] if many else table
        lines += ["", f"## {'[[' if many else '['}{name}{']]' if many else ']'} {{ #{name} }}", ""]
        lines += [_sentence(table.get("description") or inside.get("description", "")), ""]
        lines += ["| key | values | default | meaning |", "|---|---|---|---|"]
        lines += _rows(inside, "", name)
    return "\n".join(lines) + "\n"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") or not text else ".")


def _properties(table: dict) -> dict:
    """Keys of a table; those of all alternatives where there are some."""
    found = dict(table.get("properties", {}))
    for part in table.get("anyOf", []) + table.get("oneOf", []):
        for key, value in _properties(part).items():
            found.setdefault(key, value)
    return found


def _rows(table: dict, before: str, inside: str) -> list[str]:
    """A row for each key, those of tables in the table `inside` after it."""
    rows = []
    required = table.get("required", [])
    for key, about in _properties(table).items():
        name = before + key
        if about.get("type") == "array" and _properties(about.get("items", {})):
            rows.append(_row(f"[[{inside}.{name}]]", "tables", "", about))
            rows += _rows(about["items"], f"{name}.", inside)
        elif _properties(about):
            rows.append(_row(name, "table", "", about))
            rows += _rows(about, f"{name}.", inside)
        else:
            default = "**required**" if key in required else _default(about)
            rows.append(_row(name, _values(about), default, about))
    return rows


def _row(name: str, values: str, default: str, about: dict) -> str:
    cells = (f"`{name}`", values, default, about.get("description", ""))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _default(about: dict) -> str:
    return f"`{json.dumps(about['default'])}`" if "default" in about else ""


def _values(about: dict) -> str:
    """What a key may be, in words."""
    if "enum" in about:
        return ", ".join(f"`{value}`" for value in about["enum"])
    if "const" in about:
        return f"`{json.dumps(about['const'])}`"
    parts = about.get("anyOf", []) + about.get("oneOf", [])
    if parts:
        return " or ".join(dict.fromkeys(_values(part) for part in parts))
    kind = about.get("type", "")
    if kind == "array":
        low, high = about.get("minItems"), about.get("maxItems")
        count = f"{low} " if low and low == high else f"at least {low} " if low else ""
        return f"list of {count}{PLURAL.get(about.get('items', {}).get('type'), _values(about.get('items', {})))}"
    limits = [
        f"{sign} {about[key]:g}"
        for key, sign in (
            ("minimum", "≥"),
            ("exclusiveMinimum", ">"),
            ("maximum", "≤"),
            ("exclusiveMaximum", "<"),
        )
        if key in about
    ]
    return " ".join([{"boolean": "true, false"}.get(str(kind), str(kind)), ", ".join(limits)]).strip()


def commands() -> str:
    """Every command with its arguments, from its parser."""
    from voile.commands import all_commands

    lines = [
        "# Commands",
        "",
        "Exit codes: 0 done; 2 bad input; 3 a solver did not converge (what was computed is kept); 1 else.",
    ]
    for name, command in all_commands().items():
        parser = argparse.ArgumentParser(prog=f"voile {name}", formatter_class=_wide)
        command.arguments(parser)
        lines += [
            "",
            f"## voile {name}",
            "",
            _sentence(command.TEXT),
            "",
            "```text",
            parser.format_help().rstrip(),
            "```",
        ]
    return "\n".join(lines) + "\n"


def _wide(prog: str) -> argparse.HelpFormatter:
    return argparse.HelpFormatter(prog, width=100, max_help_position=32)
