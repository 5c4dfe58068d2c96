"""The law of a load in time; statics take their load factor for the time."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Load:
    """How much of a load acts at time t, of what the scene gives: in proportion to t. Another law overrides it."""

    def factor(self, t: float) -> float:
        return t
