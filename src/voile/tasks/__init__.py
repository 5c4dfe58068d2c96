"""What `voile run` does for each task: from a model to result files. Used by cli only."""

from voile.tasks.progress import Progress
from voile.tasks.run import Run

__all__ = ["Progress", "Run"]
