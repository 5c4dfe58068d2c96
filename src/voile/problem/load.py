"""The law of a load in time; statics take their load factor for the time."""

import math
from dataclasses import dataclass, field

import numpy as np

from voile.arrays import Reals


@dataclass(frozen=True)
class Load:
    """How much of a load acts at time t, of what the scene gives: in proportion to t. Another law overrides it."""

    @property
    def ends(self) -> float:
        """Time after which it stays as it is."""
        return math.inf

    def factor(self, t: float) -> float:
        return t


@dataclass(frozen=True)
class History(Load):
    """Factors (k,) at times (k,) s, linear between and constant beyond; by default 1 throughout."""

    times: Reals = field(default_factory=lambda: np.zeros(1))
    factors: Reals = field(default_factory=lambda: np.ones(1))

    @property
    def ends(self) -> float:
        return float(self.times[-1])

    def factor(self, t: float) -> float:
        return float(np.interp(t, self.times, self.factors))
