"""What `voile run` does for each task: from a model to result files. Used by cli only."""

from voile.tasks.common import summarise_refusal
from voile.tasks.inverse import run_inverse
from voile.tasks.progress import Progress
from voile.tasks.statics import run_statics

__all__ = ["Progress", "run_inverse", "run_statics", "summarise_refusal"]
