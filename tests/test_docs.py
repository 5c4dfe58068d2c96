"""The documentation: links lead somewhere, the tutorial is true, reference pages are complete, the site builds."""

import doctest
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from voile.commands import all_commands
from voile.scene import json_schema

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", ROOT / "examples" / "README.md", *ROOT.glob("docs/*.md")])
MADE = {"reference.md", "commands.md", "notebook.md"}  # by scripts/docs_hooks.py


def hooks():
    spec = importlib.util.spec_from_file_location("docs_hooks", ROOT / "scripts" / "docs_hooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def prose(page):
    """Without code."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", "", text)


def anchors(page):
    heads = re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    return {re.sub(r"[^\w -]", "", head.strip().lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = prose(page)
    for link in re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'(?:src|href)="([^"]+)"', text):
        if re.match(r"https?://", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists() or target.name in MADE, f"{page.name}: {link}"
        if anchor and target.suffix == ".md" and target.exists():
            assert anchor in anchors(target), f"{page.name}: {link}"


def test_navigation_names_pages():
    named = re.findall(r"[\w-]+\.md", (ROOT / "mkdocs.yml").read_text())
    assert len(named) == len(set(named)) > 20
    for name in named:
        assert name in MADE or (ROOT / "docs" / name).is_file(), name


def keys(table, before=""):
    for key, about in table.get("properties", {}).items():
        yield before + key
        yield from keys(about.get("items", about), f"{before}{key}.")


def test_every_scene_key_is_in_the_reference():
    text = hooks().scene_keys()
    for name, table in json_schema()["properties"].items():
        part = text.split(f"{{ #{name} }}")[1].split("\n## ")[0]
        for key in keys(table.get("items", table)):
            assert f"`{key}`" in part or f"[[{name}.{key}]]" in part, f"{name}.{key}"
    assert all(line.count(" | ") >= 3 for line in text.splitlines() if line.startswith("| `"))
    assert "| `young` | number > 0 | **required** | Young's modulus (Pa) |" in text
    assert "| `gravity` | list of 3 numbers |" in text


def test_every_command_is_in_the_reference():
    text = hooks().commands()
    for name, command in all_commands().items():
        assert f"\n## voile {name}\n" in text and command.TEXT[1:] in text
    assert "--template" in text and "--field" in text


def sentences(page):
    """Words of each sentence; cells of tables and list items are paragraphs of their own."""
    text = re.sub(r"^\$\$.*?^\$\$|\$`[^`]*`\$|<[^>]*>", "", prose(page), flags=re.M | re.S)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    for part in re.split(r"\n\s*\n|\n(?=[-*] |\d+\. |\||#)|\|", text):
        for sentence in re.split(r"(?<=[.!?])\s+|(?<=[;:])\s+(?=[A-Z\"(*])", part):
            yield [word for word in sentence.split() if re.search("[A-Za-z]", word)]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_sentences_are_short(page):
    long = [" ".join(words) for words in sentences(page) if len(words) > 30]
    assert not long


# ---- the tutorial ----


def transcript(page):
    """Commands and what each prints."""
    for block in re.findall(r"^```console\n(.*?)^```", page.read_text(), re.M | re.S):
        for part in re.split(r"^\$ ", block, flags=re.M)[1:]:
            command, _, output = part.partition("\n")
            yield command, output


def test_the_tutorial_is_true(tmp_path):
    """Every command prints what the page says, to what `...` leaves open."""
    checker = doctest.OutputChecker()
    env = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "OPENBLAS_NUM_THREADS": "1",
    }
    told = list(transcript(ROOT / "docs" / "tutorial.md"))
    assert len(told) > 8
    for command, expected in told:
        done = subprocess.run(
            command, shell=True, cwd=tmp_path, env=env, text=True, timeout=300,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        printed = done.stdout.replace("restart\n", "")  # kept by a search of over half a second
        assert checker.check_output(expected, printed, doctest.ELLIPSIS), f"$ {command}\n{done.stdout}"
        assert done.returncode == (2 if "unknown key" in expected else 0), command


# ---- the site ----


def test_the_site_builds(tmp_path):
    """Without a warning, with equations, search and no address that is fetched."""
    pytest.importorskip("material", reason="needs mkdocs-material: scripts/docs installs it")
    pytest.importorskip("latex2mathml", reason="needs latex2mathml: scripts/docs installs it")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", tmp_path / "site"],
        cwd=ROOT, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    site = tmp_path / "site"
    for page in [*ROOT.glob("docs/*.md"), *map(Path, MADE)]:
        text = (site / f"{page.stem}.html").read_text()
        for address in re.findall(
            r'<(?:script|img|iframe|link rel="stylesheet")[^>]*(?:src|href)="([^"]+)"', text
        ):
            assert not address.startswith(("http", "//")), (page.name, address)
    assert (site / "theory.html").read_text().count("<math") >= 15
    assert "Young's modulus" in (site / "reference.html").read_text().replace("&#39;", "'")
    index = (site / "search" / "search_index.js").read_text()
    assert "obstacle" in json.dumps(index)
