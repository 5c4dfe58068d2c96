"""A mesh that deforms in time: its shapes at times 0, step, 2 step, ..., linear between."""

from voile.arrays import Reals


def frame_before(time: float, step: float, count: int) -> tuple[int, float]:
    """The frame before a time (s), of `count` that are `step` (s) apart, and the share of the way to the next one."""
    k = min(max(int(time / step), 0), count - 1)
    return k, min(max(time / step - k, 0.0), 1.0) if k < count - 1 else 0.0


def shape_between(frames: Reals, time: float, step: float) -> Reals:
    """(n, 3) m at a time (s), of frames (f, n, 3) m."""
    k, share = frame_before(time, step, len(frames))
    found: Reals = frames[k] + share * (frames[min(k + 1, len(frames) - 1)] - frames[k])
    return found
