"""What a search has found, call by call, so that a later run makes the same calls and is given what they gave.

The call that was under way goes on from what it kept last. A call's outcome is arrays by name, of this rank, with plain
values in one of them; only the last outcome has what weighs most and is needed no more later (`BULKY`).
"""

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from voile.arrays import Array
from voile.solver.path import Arrays, Pause

BULKY = "bulky"  # how names of such arrays begin
Keep = Callable[[Callable[[], Arrays]], None]


class Journal:
    """Of a run that goes on from what an earlier one was told to keep (`found`); on_pause: told of what to keep."""

    def __init__(self, on_pause: Pause | None = None, found: Arrays | None = None):
        self.on_pause, self.done, self.kept = on_pause, list[Arrays](), Arrays()
        calls = int(found["calls"]) if found else 0
        every = [_named(f"{k}/", found or {}) for k in range(calls + 1)]
        self.done, self.kept, self.next = every[:calls], every[calls], 0

    def call(self, work: Callable[[Arrays, Keep], Arrays]) -> Arrays:
        """What `work` gives, or gave. It is given what it kept the last time, nothing at a start, and a function to
        call with what to keep."""
        self.next += 1
        if self.next <= len(self.done):
            return self.done[self.next - 1]
        kept, self.kept = self.kept, {}
        result = work(kept, self._keep)
        self.done = [{n: a for n, a in call.items() if not n.startswith(BULKY)} for call in self.done]
        self.done.append(result)
        self._keep(dict)
        return result

    def flag(self, test: Callable[[], bool]) -> bool:
        """What a test says, or said."""
        return bool(self.call(lambda _kept, _keep: {"flag": np.array(test())})["flag"])

    def _keep(self, under_way: Callable[[], Arrays]) -> None:
        if self.on_pause:
            self.on_pause(lambda: self._packed(under_way()))

    def _packed(self, under_way: Arrays) -> Arrays:
        calls = [*self.done, under_way]
        packed = {f"{k}/{name}": array for k, call in enumerate(calls) for name, array in call.items()}
        return {"calls": np.array(len(self.done)), **packed}


def _named(prefix: str, arrays: Arrays) -> Arrays:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def said(**values: Any) -> Arrays:
    """Plain values as an array."""
    return {"said": np.frombuffer(json.dumps(values).encode(), dtype=np.uint8)}


def heard(arrays: Arrays) -> dict[str, Any]:
    """Those of `said`."""
    values: dict[str, Any] = json.loads(arrays["said"].tobytes())
    return values


def columns(vectors: list[Any]) -> Array:
    """(p, own) of vectors on the problem's layout."""
    return np.array([vector.array_r for vector in vectors])
