"""Energy from nowhere: steps that the books do not let pass.

A scheme without a meaning for a shell, or steps that end far from balance, create energy. What loads and motions have
let the shell have is known from the books, whatever happens in the steps; so is what came beside: by the scheme, or
as the work of residuals, whether it stays or is dissipated at once.
"""

from dataclasses import dataclass

import numpy as np

from voile.problem.problem import Problem
from voile.problem.scales import slow_rate
from voile.solver.stepping.books import Books, created


@dataclass
class Options:
    """Of the most that loads and motions have let the shell have: nowhere, which may come from nowhere in all, more is
    nonsense; leap, in one step, which else is cut. aside: sizes of the shell; what the loads work over that is no
    energy worth the name."""

    nowhere: float = 0.5
    leap: float = 0.05
    aside: float = 1e-3


class Creation:
    """Refuses steps of a problem; `nonsense` says whether no step can help any more."""

    def __init__(self, problem: Problem, options: Options | None = None):
        self.options, self.nonsense = options or Options(), False
        mass = problem.comm.allreduce(float(problem.vertex_mass()[problem.own].sum()))
        self.small = self.options.aside * mass * slow_rate(problem) * problem.size() ** 2  # J

    def refusal(self, books: Books, entries: dict[str, float], short: bool) -> str:
        """Why a step with these entries may not be taken; empty where it may. short: it is not cut any more."""
        options, missed = self.options, entries["error"]
        most = max(books.let(entries), self.small)
        step = created(entries)
        total = max(books.created + step, abs(books.error + missed))
        if not np.isfinite(total + entries["present"]):
            return "the energies of a step are not finite"
        if step > options.leap * most and not short:
            return "a step takes energy from nowhere"
        self.nonsense = total > options.nowhere * most
        if self.nonsense:
            return f"{total:.2g} J come from nowhere, and all that loads and motions give is {most:.2g} J"
        return ""
