"""How MPI starts, and how many threads a process has."""

import os

# Bits of a byte tell in an assembly whose rows a triangle has.
MOST_THREADS = 8


def launched() -> bool:
    """Whether this process is one of ranks that mpirun or the like started."""
    return any(name.startswith(("OMPI_COMM_WORLD", "PMI_", "PMIX_")) for name in os.environ)


def started() -> int:
    """How many ranks mpirun or the like started with this one, as far as it tells; 1 without."""
    return max(int(os.environ.get(name, "1")) for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE"))


def processors() -> int:
    """How many this process may run on."""
    return len(os.sched_getaffinity(0))


def threads() -> int:
    """How many factor, solve and assemble in a process: as OMP_NUM_THREADS says; without it as many as there are
    processors, one where ranks share them."""
    given = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    wanted = int(given) if given.isascii() and given.isdigit() else 1 if launched() else processors()
    return min(max(wanted, 1), MOST_THREADS)


def without_launcher() -> None:
    """Tells Open MPI, before it starts, where there is no mpirun: it need not start a daemon and look for networks,
    which takes 0.3 s."""
    if not launched():
        os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
        os.environ.setdefault("OMPI_MCA_pml", "ob1")
