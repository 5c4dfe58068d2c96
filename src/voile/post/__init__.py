"""What users see of a result: figures as text, pictures, files for other programs."""

from voile.post.export import export
from voile.post.info import info
from voile.post.pattern_dxf import write_dxf
from voile.post.pattern_picture import draw_pattern
from voile.post.pattern_svg import write_svg
from voile.post.quantities import quantity
from voile.post.render import render

__all__ = ["draw_pattern", "export", "info", "quantity", "render", "write_dxf", "write_svg"]
