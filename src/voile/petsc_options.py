"""PETSc's options as a user gives them (after `--`, in PETSC_OPTIONS or ~/.petscrc), and those that nothing used."""

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

from voile.errors import InputError
from voile.launch import without_launcher

# What PETSc itself asks for only when it ends.
READ_LAST = {
    "citations",
    "get_total_flops",
    "log",
    "log_all",
    "log_mpe",
    "malloc_dump",
    "malloc_view",
    "memory_view",
    "mpidump",
    "nox",
    "nox_warning",
    "objects_dump",
    "options_left",
    "options_view",
}
_given: set[str] = set()


def start_petsc(arguments: Sequence[str] = ()) -> None:
    """Starts PETSc with a user's options, unless it runs already."""
    without_launcher()
    import petsc4py

    # Each call has one more collective end; ranks that called it more often than others would wait there for ever.
    if "petsc4py.PETSc" not in sys.modules:
        petsc4py.init(["voile", *arguments])
    from petsc4py import PETSc

    if not PETSc.Options().hasName(
        "options_left"
    ):  # newer PETSc would say at its end what `unused_options` says
        PETSc.Options().setValue("options_left", "no")
    if threading.current_thread() is threading.main_thread():
        # PETSc takes a reader that leaves (voile run ... | head) for a crash; Python raises BrokenPipeError there.
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)


@contextmanager
def options_of_run(more: Sequence[str]) -> Iterator[None]:
    """The user's options, `more` words and all there are already, while a run goes; solvers add defaults of their own.
    Afterwards PETSc's database is as before."""
    from petsc4py import PETSc

    options = PETSc.Options()
    before = options.getAll()
    for name, value in _pairs(more):
        options.setValue(name, value)
    _given.update(options.getAll())
    try:
        yield
    except PETSc.Error as error:
        trace = str(error).splitlines()
        if not any("SetFromOptions" in line for line in trace):
            raise
        why = trace[-1].partition("] ")[2]
        raise InputError(f"PETSc options: {why}; allowed: types and values that PETSc has") from None
    finally:
        _given.clear()
        for name, value in options.getAll().items():
            if name not in before:
                options.delValue(name)
            elif value != before[name]:
                options.setValue(name, before[name])


def _pairs(words: Sequence[str]) -> Iterator[tuple[str, str | None]]:
    """Names and values of options given as words."""
    check_words(words)
    for word, after in pairwise((*words, "-end")):
        if _is_option(word):
            yield word.lstrip("-"), None if _is_option(after) else after


def check_words(arguments: Sequence[str]) -> None:
    """Raises InputError for a word that is neither an option nor the value of one: PETSc would pass over it."""
    if isinstance(arguments, str):
        raise InputError(f"PETSc options: {arguments!r} is one text; allowed: a list of its words")
    for before, word in pairwise(("", *arguments)):
        if not _is_option(word) and not _is_option(before):
            raise InputError(
                f"PETSc options after --: {word!r} is neither an option (-name) nor the value of one"
            )


def unused_options() -> list[str]:
    """The user's options, "-name value", that nothing has asked for so far, neither by their own name nor by that of a
    method that they were handed on to (solver.linear.hand_on)."""
    from petsc4py import PETSc

    from voile._petsc import unused_options as left

    unused = dict(left())
    used = PETSc.Options().getAll().keys() - unused.keys()
    own = {
        name: value
        for name, value in unused.items()
        if name in _given - READ_LAST and not any(other.endswith(f"_{name}") for other in used)
    }
    return [f"-{name} {value}".rstrip() for name, value in own.items()]


def _is_option(word: str) -> bool:
    """As PETSc tells options from values, which may be negative numbers."""
    name = word.removeprefix("-").removeprefix("-")
    return word.startswith("-") and name[:1].isalpha()
