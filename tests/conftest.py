"""Fixtures for parallel tests and for the data kept beside the checkout."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from command_line import script, voile  # also chooses the BLAS before a test imports numpy
from crew import Crew

# What an MPI process tells its children: with it, an mpirun started from here takes itself for one of the
# parent's ranks and fails without a message (a test that imports mpi4py makes pytest such a process).
MPI_PREFIXES = ("OMPI_", "PMIX_", "ORTE_", "OPAL_", "PMI_", "PRTE_")

MpiRun = Callable[[int, Sequence[str], float], subprocess.CompletedProcess[str]]


@pytest.fixture(autouse=True)
def freed() -> Iterator[None]:
    """A test's solvers end with it, as a run's do. Workers kept them all: up to 3 GB."""
    if "petsc4py.PETSc" not in sys.modules:
        yield
        return
    from voile.problem.lifetime import run_of_its_own

    with run_of_its_own():
        yield


@pytest.fixture(scope="session")
def launcher() -> list[str]:
    """mpirun with the flags that containers and few cores need."""
    program = shutil.which("mpirun")
    assert program, "mpirun is not on the PATH; scripts/setup installs it"
    version = subprocess.run([program, "--version"], capture_output=True, text=True).stdout
    return [program, "--allow-run-as-root", "--oversubscribe"] if "Open MPI" in version else [program]


@pytest.fixture(scope="session")
def patient(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Library that makes ranks wait in patience (patient.c)."""
    library = tmp_path_factory.mktemp("patient") / "patient.so"
    source = Path(__file__).with_name("patient.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", library, source], check=True)
    return library


@pytest.fixture(scope="session")
def environment(patient: Path) -> dict[str, str]:
    """What ranks beside other workers of the suite need."""
    # Those that wait give way, no two runs are bound to the same processor, and (with `patient`) a run of two ranks
    # beside five busy processes takes 27 s for 250.
    return {
        "OPENBLAS_NUM_THREADS": "1",
        "LD_PRELOAD": str(patient),
        "OMPI_MCA_mpi_yield_when_idle": "1",
        "OMPI_MCA_hwloc_base_binding_policy": "none",
        "OMPI_MCA_btl_vader_single_copy_mechanism": "none",  # containers forbid reading another process
    }


def unmarked() -> dict[str, str]:
    """The environment, without what MPI told this process."""
    return {k: v for k, v in os.environ.items() if not k.startswith(MPI_PREFIXES)}


@pytest.fixture
def mpirun(launcher: list[str], environment: dict[str, str]) -> MpiRun:
    """mpirun(ranks, args, timeout): runs args on that many ranks, returns the completed process (text)."""

    def run(ranks: int, args: Sequence[str], timeout: float) -> subprocess.CompletedProcess[str]:
        command = [*launcher, "-n", str(ranks), *map(str, args)]
        with subprocess.Popen(
            command,
            env=unmarked() | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                out, err = process.communicate(timeout=timeout)
            except BaseException:
                os.killpg(process.pid, signal.SIGKILL)  # the ranks too
                raise
        return subprocess.CompletedProcess(command, process.returncode, out, err)

    return run


@pytest.fixture(scope="session")
def crews(
    launcher: list[str], environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[int], Crew]]:
    """crews(ranks): that many ranks, which stay until the session ends."""
    made: dict[int, Crew] = {}

    def crew(ranks: int) -> Crew:
        if ranks not in made or not made[ranks].there:
            made[ranks] = Crew(launcher, ranks, unmarked() | environment, tmp_path_factory.mktemp("crew"))
        return made[ranks]

    yield crew
    for each in made.values():
        each.end()


@pytest.fixture
def run_on(crews: Callable[[int], Crew]) -> Callable[..., None]:
    """run_on(ranks, scene, out, timeout=120): runs a scene on that many ranks, on one in this process; it must
    succeed."""

    def run(ranks: int, scene: Path, out: Path, timeout: float = 120) -> None:
        words = ["run", scene, "-o", out]
        done = voile(*words) if ranks == 1 else crews(ranks).run("voile", words, timeout)
        assert done.returncode == 0, done.stderr

    return run


@pytest.fixture
def script_on(crews: Callable[[int], Crew]) -> Callable[..., str]:
    """script_on(ranks, file, *args): what a Python file prints on that many ranks; it must succeed."""

    def run(ranks: int, *words: object) -> str:
        done = script(*words) if ranks == 1 else crews(ranks).run("script", words, 300)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture(params=[(1, 2), pytest.param((1, 2, 4), marks=pytest.mark.slow)], ids=["2 ranks", "4 ranks"])
def rank_counts(request: pytest.FixtureRequest) -> tuple[int, ...]:
    """Numbers of ranks that must find the same. Four by name only: on two processors that the suite shares, each
    message of theirs waits for a turn, which made a run of one second take a hundred."""
    return request.param


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of garments and reference values beside the checkout; skips the test without it."""
    folder = Path(__file__).parents[1].parent / "shared"
    if not folder.is_dir():
        pytest.skip(f"needs the data folder {folder}, which is not part of the project")
    return folder
