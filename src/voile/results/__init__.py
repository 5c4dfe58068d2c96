"""Results of a run: the file `result.vtkhdf`, `summary.json` and, for panels, `pattern.json`."""

from voile.mesh import Pattern, Piece, SewnSeam
from voile.results.fields import CELL_FIELDS, POINT_FIELDS, Field
from voile.results.folder import held_output, prepare_output
from voile.results.pattern import read_pattern, write_pattern
from voile.results.reader import Restart, Result, open_result, opened, read_result, result_file
from voile.results.static import Body, StaticMesh
from voile.results.summary import read_summary, write_summary
from voile.results.writer import ResultWriter

__all__ = [
    "CELL_FIELDS",
    "POINT_FIELDS",
    "Body",
    "Field",
    "Pattern",
    "Piece",
    "Restart",
    "Result",
    "ResultWriter",
    "SewnSeam",
    "StaticMesh",
    "held_output",
    "open_result",
    "opened",
    "prepare_output",
    "read_pattern",
    "read_result",
    "read_summary",
    "result_file",
    "write_pattern",
    "write_summary",
]
