"""The choice of OpenBLAS' kernels, and what is said of the BLAS in use."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from test_cli import SCENE, cells

from voile import blas

AVX2 = {"fpu", "sse2", "avx", "avx2", "fma"}
AVX512 = AVX2 | {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}
REFERENCE = Path("/usr/lib/x86_64-linux-gnu/blas")
needs_openblas = pytest.mark.skipif(
    not (blas.used().core and blas.suited_core(blas.processor_flags())),
    reason="not OpenBLAS on an x86 processor with AVX2",
)


def python(text: str, **environment: str) -> str:
    """What a Python program says, with these and none of the caller's settings of OpenBLAS."""
    env = {k: v for k, v in os.environ.items() if not k.startswith("OPENBLAS_")} | environment
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, env=env, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


# ---- the choice ----


@pytest.mark.parametrize(
    ("flags", "core"),
    [
        (AVX512, "SkylakeX"),
        (AVX2 | {"avx512f"}, "Haswell"),
        (AVX2, "Haswell"),
        ({"avx", "sse2"}, ""),
        (set(), ""),
    ],
)
def test_kernels_suit_the_processor(flags, core):
    assert blas.suited_core(flags) == core


@pytest.mark.parametrize(
    ("flags", "offered", "setting", "wanted"),
    [
        (AVX512, "Prescott", None, "SkylakeX"),
        (AVX2, "Prescott", None, "Haswell"),
        (AVX512, "Cooperlake", None, None),  # OpenBLAS knows the processor
        (AVX2, "Zen", None, None),
        (AVX512, "", None, None),  # another BLAS
        ({"sse2"}, "Prescott", None, None),  # rightly so
        (AVX512, "Prescott", "Haswell", "Haswell"),  # the user's own
        (AVX512, "Prescott", "Prescott", "Prescott"),
    ],
)
def test_only_a_fallback_is_overruled(flags, offered, setting, wanted, monkeypatch):
    monkeypatch.setattr(blas, "processor_flags", lambda: flags)
    monkeypatch.setattr(blas, "offered_core", lambda: offered)
    environment = {"OPENBLAS_CORETYPE": setting} if setting else {}
    blas.prepare(environment)
    assert environment.get("OPENBLAS_CORETYPE") == wanted
    assert environment["OPENBLAS_NUM_THREADS"] == "1"


def test_threads_of_the_user_stay(monkeypatch):
    monkeypatch.setattr(blas, "processor_flags", set)
    environment = {"OPENBLAS_NUM_THREADS": "4"}
    blas.prepare(environment)
    assert environment == {"OPENBLAS_NUM_THREADS": "4"}


def test_flags_are_those_of_the_first_processor(tmp_path):
    file = tmp_path / "cpuinfo"
    file.write_text("processor\t: 0\nflags\t\t: fpu avx2\nprocessor\t: 1\nflags\t\t: fpu\n")
    assert blas.processor_flags(file) == {"fpu", "avx2"}
    file.write_text("processor\t: 0\nFeatures\t: fp asimd\n")  # ARM
    assert blas.processor_flags(file) == set()
    assert blas.processor_flags(tmp_path / "none") == set()


@pytest.mark.parametrize(
    ("core", "dynamic", "flags", "setting", "words"),
    [
        ("SkylakeX", True, AVX512, "", ""),
        ("Prescott", True, {"sse2"}, "", ""),
        ("Prescott", True, AVX2, "", "set OPENBLAS_CORETYPE=Haswell, or import voile before numpy"),
        ("Prescott", True, AVX512, "SkylakeX", "set OPENBLAS_CORETYPE=SkylakeX"),  # came too late
        ("Prescott", True, AVX512, "prescott", "OPENBLAS_CORETYPE asks for them"),
        ("Prescott", False, AVX512, "", "built with them only"),
    ],
)
def test_slow_kernels_are_complained_of(core, dynamic, flags, setting, words):
    said = blas.complaint(core, dynamic, flags, {"OPENBLAS_CORETYPE": setting})
    assert words in said and bool(said) == bool(words)


# ---- the library ----


def test_the_library_in_use_is_named_and_multiplies_rightly():
    found = blas.used()
    assert found.library and os.path.isfile(found.file) and found.file in str(found)


def test_a_wrong_product_is_seen():
    def idle(*arguments):  # leaves the product as it is
        pass

    assert not blas.multiplies(idle)


@needs_openblas
def test_a_fallback_is_avoided_before_numpy_loads():
    # As if the library did not know this processor.
    program = """
import voile.blas, os
os.environ.pop("OPENBLAS_CORETYPE", None)
voile.blas.offered_core = lambda: "Prescott"
voile.blas.prepare()
import numpy
found = voile.blas.used()
print(found.core == voile.blas.suited_core(voile.blas.processor_flags()), found.threads, repr(found.note))
"""
    assert python(program) == "True 1 ''"


@needs_openblas
def test_asking_the_library_leaves_the_choice_open():
    program = """
import voile.blas, os
before = voile.blas.offered_core()
os.environ["OPENBLAS_CORETYPE"] = "Nehalem"
print(before != "Nehalem", voile.blas.offered_core(), voile.blas.used().core)
"""
    assert python(program) == "True Nehalem Nehalem"


@needs_openblas
def test_numpy_loaded_before_cannot_be_changed_and_that_is_said():
    # PyPI's numpy brings a library of its own: there another program has loaded the one that PETSc takes.
    program = """
import ctypes, os, numpy
ctypes.CDLL("libblas.so.3")
del os.environ["OPENBLAS_CORETYPE"]
import voile.blas
print(voile.blas.used().core, voile.blas.used().note)
"""
    said = python(program, OPENBLAS_CORETYPE="Prescott")
    assert said.startswith("Prescott ") and said.endswith("or import voile before numpy")


@pytest.mark.skipif(not list(REFERENCE.glob("libblas.so.3")), reason="needs Debian's reference BLAS")
def test_the_reference_blas_is_complained_of():
    program = "import voile.blas; print(voile.blas.used().library, '|', voile.blas.used().note)"
    said = python(program, LD_LIBRARY_PATH=str(REFERENCE))
    assert said.startswith(f"unknown BLAS | {REFERENCE}") and "several times slower" in said


@needs_openblas
def test_explain_and_summary_say_which_blas(tmp_path):
    (tmp_path / "mesh.obj").write_text(cells())
    (tmp_path / "scene.toml").write_text(SCENE)
    program = "import sys, voile.cli; sys.exit(voile.cli.main({arguments}))"
    scene, out = str(tmp_path / "scene.toml"), tmp_path / "out"
    said = python(program.format(arguments=["explain", scene]), OPENBLAS_CORETYPE="Prescott")
    assert "\nblas      OpenBLAS " in said and "Prescott kernels, 1 thread" in said
    assert "  note: OpenBLAS uses its Prescott kernels" in said
    said = python(program.format(arguments=["run", scene, "-o", str(out)]), OPENBLAS_CORETYPE="Prescott")
    assert said.startswith("note: OpenBLAS uses its Prescott kernels")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["blas"]["core"] == "Prescott" and summary["blas"]["threads"] == 1
    assert summary["blas"]["note"] in summary["notes"]
