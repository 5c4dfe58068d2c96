"""Keys of scene tables: what each may hold, its unit, range, default and meaning. Knows no scene and no shape."""

from voile.keys.kinds import (
    Array,
    Axes,
    Boolean,
    Box,
    Choice,
    File,
    Grain,
    Integer,
    MeshFile,
    Number,
    Rejected,
    Selection,
    Text,
    Vector3,
    vector,
)
from voile.keys.table import Table, Tables, key

__all__ = [
    "Array",
    "Axes",
    "Boolean",
    "Box",
    "Choice",
    "File",
    "Grain",
    "Integer",
    "MeshFile",
    "Number",
    "Rejected",
    "Selection",
    "Table",
    "Tables",
    "Text",
    "Vector3",
    "key",
    "vector",
]
