"""Triangle meshes: reading, checks, rest shapes, seams, selections, lines, topology, patterns. Lengths in metres."""

from voile.mesh.attached import Attached
from voile.mesh.obj import METRES, write_obj
from voile.mesh.pattern import Notches, Pattern, Piece, SewnSeam, is_called
from voile.mesh.raw import RawMesh, mesh_of_arrays
from voile.mesh.refine import refine, surface_loops
from voile.mesh.select import inner_lines, select
from voile.mesh.shares import edges_of, portions, shares
from voile.mesh.shrink import shrunk
from voile.mesh.stitches import Stitches, sewing_matrix
from voile.mesh.surface import Rest, Surface, read_body, read_mesh, read_raw, read_rest
from voile.mesh.texture import texture_direction
from voile.mesh.topology import Topology, boundary_loops, build_topology

__all__ = [
    "METRES",
    "Attached",
    "Notches",
    "Pattern",
    "Piece",
    "RawMesh",
    "Rest",
    "SewnSeam",
    "Stitches",
    "Surface",
    "Topology",
    "boundary_loops",
    "build_topology",
    "edges_of",
    "inner_lines",
    "is_called",
    "mesh_of_arrays",
    "portions",
    "read_body",
    "read_mesh",
    "read_raw",
    "read_rest",
    "refine",
    "select",
    "sewing_matrix",
    "shares",
    "shrunk",
    "surface_loops",
    "texture_direction",
    "write_obj",
]
