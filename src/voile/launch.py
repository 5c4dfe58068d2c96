"""How MPI starts."""

import os


def launched() -> bool:
    """Whether this process is one of ranks that mpirun or the like started."""
    return any(name.startswith(("OMPI_COMM_WORLD", "PMI_", "PMIX_")) for name in os.environ)


def started() -> int:
    """How many ranks mpirun or the like started with this one, as far as it tells; 1 without."""
    return max(int(os.environ.get(name, "1")) for name in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE"))


def without_launcher() -> None:
    """Tells Open MPI, before it starts, where there is no mpirun: it need not start a daemon and look for networks,
    which takes 0.3 s."""
    if not launched():
        os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")
        os.environ.setdefault("OMPI_MCA_pml", "ob1")
