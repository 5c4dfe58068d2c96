"""Protocols: physical claims of the program, each a scene with a reference and a bound (`voile validate`)."""

from voile.validate.bench import Bench
from voile.validate.protocol import (
    Check,
    Curve,
    Findings,
    Plot,
    Protocol,
    all_protocols,
    close,
    perform,
    within,
)

__all__ = [
    "Bench",
    "Check",
    "Curve",
    "Findings",
    "Plot",
    "Protocol",
    "all_protocols",
    "close",
    "perform",
    "within",
]
