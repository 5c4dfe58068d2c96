"""Triangle meshes: reading, checks, rest shapes, seams, selections and topology. Lengths are in metres."""

from voile.mesh.obj import METRES, write_obj
from voile.mesh.select import select
from voile.mesh.stitches import Stitches, sewing_matrix
from voile.mesh.surface import Rest, Surface, read_body, read_mesh, read_rest
from voile.mesh.topology import Topology, boundary_loops, build_topology

__all__ = [
    "METRES",
    "Rest",
    "Stitches",
    "Surface",
    "Topology",
    "boundary_loops",
    "build_topology",
    "read_body",
    "read_mesh",
    "read_rest",
    "select",
    "sewing_matrix",
    "write_obj",
]
