"""PETSc's options from the command line and the environment: what acts, what is refused, what nothing used."""

import json
import os
import subprocess
import sys

import pytest
from petsc4py import PETSc
from test_cli import SCENE, cells

from voile.errors import InputError
from voile.petsc_options import check_words

needs_suitesparse = pytest.mark.skipif(
    not PETSc.Sys.hasExternalPackage("suitesparse"), reason="this PETSc has no SuiteSparse"
)


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        ([], None),
        (["-snes_monitor"], None),
        (["-snes_atol", "1e-9", "--ksp_view", "-pc_type", "cholesky"], None),
        (["-shift", "-3.5", "-last", "-1"], None),  # negative values
        (["snes_monitor"], "snes_monitor"),
        (["-snes_atol", "1e-9", "1e-8"], "1e-8"),
        (["-3"], "-3"),
    ],
)
def test_words_that_petsc_would_pass_over_are_refused(words, wrong):
    if wrong is None:
        check_words(words)
        return
    with pytest.raises(InputError, match=f"PETSc options after --: '{wrong}' is neither"):
        check_words(words)


@pytest.fixture
def run(tmp_path):
    """run(words, PETSC_OPTIONS): runs a small scene with PETSc options; the completed process and the summary."""
    (tmp_path / "mesh.obj").write_text(cells())
    (tmp_path / "scene.toml").write_text(SCENE)

    def call(*words: str, options: str = "") -> tuple[subprocess.CompletedProcess[str], dict]:
        command = [sys.executable, "-m", "voile.cli", "run", "scene.toml", "-o", "out", "--", *words]
        env = {**os.environ, "PETSC_OPTIONS": options}
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=100)
        summary = tmp_path / "out" / "summary.json"
        return done, json.loads(summary.read_text()) if summary.exists() else {}

    return call


def test_options_that_nothing_used_are_named_once(run):
    done, summary = run("-snes_typ", "newtonls", "-mat_mumps_icntl_14", "60", options="-ksp_rtoll -1")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("nothing used") == 1
    assert "\nPETSc options that nothing used: -ksp_rtoll -1, -snes_typ newtonls\n" in done.stdout
    assert summary["unused_options"] == ["-ksp_rtoll -1", "-snes_typ newtonls"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["-ksp_type", "bogus"], "requested KSP type bogus"),
        (["-snes_max_it", "many"], "many has no integer value"),
        (["-pc_factor_mat_solver_type", "superlu"], "superlu"),
    ],
)
def test_what_petsc_does_not_have_is_bad_input(run, words, why):
    done, _ = run(*words)
    assert done.returncode == 2
    assert done.stderr.startswith("voile: PETSc options: ") and why in done.stderr
    assert done.stderr.count("\n") == 1


def test_nothing_is_said_where_all_options_acted(run):
    # Of the last three PETSc itself asks for some only when it ends.
    done, summary = run(
        "-mat_mumps_icntl_14", "60", "-log_view", ":/dev/null", "-malloc_view", "-options_left"
    )
    assert done.returncode == 0, done.stderr
    assert "nothing used" not in done.stdout and summary["unused_options"] == []


def test_without_options_the_programs_own_defaults_are_not_named(run):
    done, summary = run()
    assert done.returncode == 0, done.stderr
    assert "PETSc options" not in done.stdout + done.stderr and summary["unused_options"] == []


@needs_suitesparse
@pytest.mark.parametrize(
    "words", ["-pc_factor_mat_solver_type cholmod", "-pc_type lu -pc_factor_mat_solver_type umfpack"]
)
def test_stability_is_counted_whatever_solves_the_systems(run, tmp_path, words):
    """CHOLMOD and LU count no negative eigenvalues; the end, on a plane, is stable all the same."""
    plane = "[[obstacle]]\nshape = 'plane'\npoint = [0, 0, -0.01]\nnormal = [0, 0, 1]\nfriction = 0.3\n"
    (tmp_path / "scene.toml").write_text(SCENE + plane)
    done, summary = run(*words.split())
    assert done.returncode == 0, done.stderr
    assert summary["stable"] is True and summary["contact"]["active"] > 0
    assert summary["notes"] == [] and summary["unused_options"] == []


@needs_suitesparse
def test_cholmod_may_meet_matrices_that_are_not_positive_definite(run, tmp_path):
    """A free sheet above a ball: it raises an error where MUMPS counts pivots."""
    free = SCENE[: SCENE.index("[[fix]]")].replace("1e5", "1e6")
    ball = "[[obstacle]]\nshape = 'sphere'\ncenter = [0.15, 0.15, -0.1]\nradius = 0.0995\nfriction = 0.5\n"
    (tmp_path / "mesh.obj").write_text(cells(size=0.3, count=8))
    (tmp_path / "scene.toml").write_text(free + ball)
    done, summary = run("-pc_factor_mat_solver_type", "cholmod")
    assert done.returncode == 0, done.stderr
    assert summary["stable"] is True and summary["contact"]["active"] > 0
    assert "CHOLMOD" not in done.stdout + done.stderr


def test_a_solver_that_petsc_has_not_is_bad_input(run, tmp_path, mpirun):
    """No such solver, and one that cannot on two ranks."""
    done, _ = run("-pc_factor_mat_solver_type", "cholesky")
    assert (
        done.returncode == 2
        and "pc_factor_mat_solver_type cholesky cannot factor here (ranks: 1)" in done.stderr
    )
    command = [
        sys.executable,
        "-m",
        "voile.cli",
        "run",
        tmp_path / "scene.toml",
        "-o",
        tmp_path / "two",
        "--",
    ]
    both = mpirun(2, [*command, "-pc_factor_mat_solver_type", "cholmod"], 100)
    assert both.returncode == 2 and "cholmod cannot factor here (ranks: 2)" in both.stderr


def test_a_stray_word_is_bad_input(run):
    done, summary = run("snes_monitor")
    assert done.returncode == 2 and not summary
    assert done.stderr == (
        "voile: PETSc options after --: 'snes_monitor' is neither an option (-name) nor the value of one\n"
    )


@pytest.mark.parametrize("words", ["explain scene.toml", "validate incline --quick"])
@pytest.mark.usefixtures("run")
def test_a_reader_that_has_read_enough_is_no_crash(tmp_path, words):
    """To PETSc's own handler it is one, which ends MPI."""
    command = [sys.executable, "-m", "voile.cli", *words.split()]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, cwd=tmp_path, text=True, **pipes) as process:
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == ("", 0)
