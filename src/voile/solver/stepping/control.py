"""Step lengths of a load path."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Options:
    """easy: Newton iterations up to which a load step grows. smooth: steps in a row without a cut or a jump after which
    the next one grows whatever they took, for a folded sheet never takes few. snap: of the load steps' length; a jump
    in less is a snap. restless: snaps from which their onset is not looked for. quiet: of the load steps' length, a
    step without a snap from which it is again. smallest: load step that is not cut any more. hopeless: cuts in all
    after the last resort, where every success is followed by a failure (a shell too soft for its weight)."""

    easy: int = 10
    smooth: int = 2
    snap: float = 1.0 / 64.0
    restless: int = 4
    quiet: float = 0.25
    smallest: float = 1e-5
    hopeless: int = 20


@dataclass
class StepControl:
    """How long the next load step is, after how many cuts, and what the last ones let expect of it.

    nominal: length of the first step; most: cuts until the last resort, every method at once; cap: of any step, by
    default the nominal length. rate: motion in sizes of the shell per load factor; stable: whether it starts from a
    stable equilibrium; snaps since the last longer step without one; failures after the last resort; row: steps
    since the last cut, jump or growth. marks: load factors that a step ends at, ascending, the last one 1.
    """

    nominal: float
    most: int
    cap: float = 0.0
    factor: float = 0.0
    cuts: int = 0
    rate: float = np.inf
    stable: bool = True
    snaps: int = 0
    failures: int = 0
    marks: tuple[float, ...] = (1.0,)
    row: int = 0

    def __post_init__(self) -> None:
        self.options = Options()
        self.step = self.longest = self.nominal

    @property
    def target(self) -> float:
        """Load factor at the end of the next step."""
        mark = next(mark for mark in self.marks if mark > self.factor)
        return mark if self.factor + self.step > mark - 1e-9 else self.factor + self.step

    @property
    def last_resort(self) -> bool:
        """Whether every method is tried."""
        return self.cuts >= self.most

    @property
    def shortest(self) -> bool:
        """Whether a jump in the next step is a snap."""
        short = self.target - self.factor <= self.options.snap * self.nominal
        return self.most == 0 or short or self.snaps >= self.options.restless

    @property
    def exhausted(self) -> bool:
        """Whether no shorter step is worth a try."""
        return self.step < self.options.smallest or self.failures > self.options.hopeless

    def failed(self) -> None:
        """After a step without an equilibrium: a shorter one, or, before steps get too short, the last resort."""
        self.failures += self.last_resort
        shorter = 0.25 * self.step
        hurries = self.cuts < self.most and shorter < self.options.smallest
        self.cuts = self.most if hurries else self.cuts + 1
        self.row = 0
        self.step = self.longest if self.cuts == self.most else shorter

    def whole(self) -> None:
        """Where nothing but the loads leads the shell: all that is left of them at once."""
        self.step = self.longest = self.nominal = 1.0

    def take_back(self) -> None:
        """After a step that has to be taken back."""
        self.step = self.longest = 0.25 * (self.target - self.factor)
        self.row = 0

    def done(self, iterations: int, moved: float, jumps: bool) -> None:
        """After a step with so many iterations and such a motion."""
        self.rate = self.rate if jumps else moved / (self.target - self.factor)
        quiet = not jumps and self.target - self.factor >= self.options.quiet * self.nominal
        self.snaps = 0 if quiet else self.snaps + jumps
        self.cuts = 0
        self.row = 0 if jumps else self.row + 1
        self.advanced(iterations)

    def advanced(self, iterations: int) -> None:
        """As `done` where nothing but the load matters; what followed no branch once is not tried again."""
        self.factor, self.longest = self.target, self.nominal
        if iterations <= self.options.easy or self.row >= self.options.smooth:
            self.row = 0
            self.step = min(2.0 * self.step, self.cap or self.nominal)
