"""The two ways a run fails, and the exit code of each (see interface: 2 bad input, 3 not converged)."""


class InputError(ValueError):
    """Bad input: one message naming the file, line or key, what is wrong and what is allowed."""

    exit_code = 2


class NotConverged(RuntimeError):
    """A solver did not converge; the message says which quantity missed which tolerance."""

    exit_code = 3
