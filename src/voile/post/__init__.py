"""What users see of a result: figures as text, pictures, files for other programs."""

from voile.post.export import export
from voile.post.info import info
from voile.post.quantities import quantity
from voile.post.render import render

__all__ = ["export", "info", "quantity", "render"]
