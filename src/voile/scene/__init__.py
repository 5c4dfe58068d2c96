"""Scene files: the schema of their keys and the reader. Nothing below the command line sees a scene."""

from voile.scene.reader import read_scene
from voile.scene.schema import Scene, json_schema, unsupported

__all__ = ["Scene", "json_schema", "read_scene", "unsupported"]
