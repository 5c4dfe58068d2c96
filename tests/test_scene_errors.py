"""Bad scenes: one line for each, with file, line and key, what is wrong and what is allowed."""

import json
import re
import tomllib

import pytest
from test_scene import FULL, SHELL, refusal

from voile.errors import InputError
from voile.scene import json_schema, read_scene

# Text in FULL | put in its place | start of the message after file and line.
BAD = """
thickness = 5e-4 | thickness = "1 mm" | shell.thickness: '1 mm' is text; allowed: a finite number > 0 in m
thickness = 5e-4 | thickness = 0 | shell.thickness: 0 is not allowed; allowed: a finite number > 0 in m
thickness = 5e-4 | thickness = nan | shell.thickness: nan is not allowed
thickness = 5e-4 | thickness = true | shell.thickness: true is a boolean
thickness = 5e-4 | thikness = 5e-4 | shell.thikness: unknown key (did you mean "thickness"?); allowed: mesh,
young = 2.0e5 | young = -1.0 | shell.young: -1.0 is not allowed; allowed: a finite number > 0 in Pa
poisson = -0.2 | poisson = 0.5 | shell.poisson: 0.5 is not allowed; allowed: a finite number > -1 and < 0.5
poisson = -0.2 | poisson = -1 | shell.poisson: -1 is not allowed
density = 250.0 | density = -3.0 | shell.density: -3.0 is not allowed; allowed: a finite number > 0 in kg/m^3
density = 250.0 | density = 2024-01-01 | shell.density: datetime.date(2024, 1, 1) is a date or time
seams = false | seams = 0 | shell.seams: 0 is an integer; allowed: true, false
mesh = "skirt.obj" | mesh = "" | shell.mesh: '' is not allowed; allowed: text, not empty
mesh = "skirt.obj" | mesh = 3 | shell.mesh: 3 is an integer; allowed: a path relative to the scene file
model = "koiter" | model = "koitre" | shell.model: 'koitre' is not allowed (did you mean "koiter"?); allowed:
scale = 0.001 | gravity = [0, 0, 0] | shell.gravity: unknown key; allowed: mesh,
gravity = [0, 0, -9.81] | gravity = [0, 0] | loads.gravity: [0, 0] has length 2; allowed: an array of 3 values
gravity = [0, 0, -9.81] | gravity = -9.81 | loads.gravity: -9.81 is a number; allowed: an array of 3
gravity = [0, 0, -9.81] | gravity = [0, 0, "g"] | loads.gravity: in [0, 0, 'g'], 'g' is text
{ nodes = 3 } | { nodes = -3 } | loads.force.1.select.nodes: -3 is not allowed; allowed: an integer >= 0
{ nodes = 3 } | { nodes = [] } | loads.force.1.select.nodes: [] has length 0; allowed:
{ nodes = 3 } | { nodes = [0, 1.5] } | loads.force.1.select.nodes: in [0, 1.5], 1.5 is a number
{ nodes = 3 } | { vertices = 3 } | loads.force.1.select.vertices: unknown key; allowed: nodes, group, box,
{ nodes = 3 } | {} | loads.force.1.select: {} is not allowed; allowed: a table with one or more of
{ nodes = 3 } | [3] | loads.force.1.select: [3] is an array; allowed: a table with one or more of
[[0, 0, 0], [0, 1, 1]] | [[0, 0, 0], [0, -1, 1]] | loads.moment.0.select.box: [[0, 0, 0], [0, -1, 1]] is not
[[0, 0, 0], [0, 1, 1]] | [0, 0, 0] | loads.moment.0.select.box: [0, 0, 0] is not allowed; allowed: [[xmin,
["waist", "hem"] | ["waist", 1] | fix.0.select.group: in ['waist', 1], 1 is an integer; allowed: text
{ all = true } | { all = false } | fix.1.select.all: false is not allowed; allowed: true
axes = "xz" | axes = "xw" | fix.0.axes: 'xw' is not allowed; allowed: one or more of the letters x, y, z
axes = "xz" | axes = "xx" | fix.0.axes: 'xx' is not allowed
axes = "xz" | axes = "" | fix.0.axes: '' is not allowed
[0.0, 0.0, 0.1] | [0.0, 0.2, 0.1] | fix.0.move.displacement: 0.2 m along y, but axes = "xz" leaves y free
radius = 0.2 | radius = 0.0 | obstacle.0.radius: 0.0 is not allowed; allowed: a finite number > 0 in m
radius = 0.2 | radius = 1e155 | obstacle.0.radius: 1e+155 is not allowed; allowed: at most 1e+30 m
radius = 0.2 | radii = [1, 1, 1] | obstacle.0.radii: not a key of shape = "sphere"; allowed: center, radius
friction = 0.3 | friction = -0.1 | obstacle.0.friction: -0.1 is not allowed; allowed: a finite number >= 0
offset = 0.0005 | offset = -1 | contact.offset: -1 is not allowed; allowed: a finite number >= 0 in m
load_steps = 4 | load_steps = 2.5 | statics.load_steps: 2.5 is a number; allowed: an integer >= 1
load_steps = 4 | tolerance = 1.0 | statics.tolerance: 1.0 is not allowed; allowed: a finite number > 0 and < 1
developable = "panels" | developable = true | inverse.developable: true is not allowed; allowed: false, "const
["young"] | ["stiffness"] | inverse.estimate: in ['stiffness'], 'stiffness' is not allowed
every = 3 | every = 0 | output.every: 0 is not allowed; allowed: an integer >= 1
[output] | [outputs] | outputs: unknown key (did you mean "output"?); allowed: scene, shell,
"""
BAD_ROWS = [tuple(row.split(" | ")) for row in BAD.strip().split("\n")]
BETWEEN_KEYS = ("leaves y free", "not a key of shape", "[0, -1, 1]")  # beyond JSON schema


@pytest.mark.parametrize(("old", "new", "message"), BAD_ROWS)
def test_bad_values_name_file_line_and_key(tmp_path, old, new, message):
    assert FULL.count(old) == 1
    line = FULL[: FULL.index(old)].count("\n") + 1
    text = refusal(tmp_path, FULL.replace(old, new))
    assert text.startswith(f"scene.toml, line {line}: {message}")
    assert "allowed: " in text


def test_a_key_in_the_wrong_table_is_told_its_own(tmp_path):
    assert refusal(tmp_path, SHELL + "gravity = [0, 0, 0]").endswith("(it belongs in [loads])")
    assert refusal(tmp_path, "young = 1.0\n" + SHELL).endswith("(it belongs in [shell] or [[fabric]])")
    assert "belongs" not in refusal(tmp_path, SHELL + "colour = 1")


def test_a_key_with_a_line_break_stays_on_one_line(tmp_path):
    message = refusal(tmp_path, SHELL + '"a\\nb" = 1')
    assert message.startswith(r"scene.toml, line 7: shell.'a\nb': unknown key")


# What follows SHELL, "; " for a new line | start of the message after the file; SHELL ends on line 6.
FORMS = """
[[fix]]; axes = 'x' | , line 7: fix.0: the key "select" is missing: vertices: nodes
[fix]; axes = 'x' | , line 7: fix: {'axes': 'x'} is a table; allowed: tables in double brackets
[[fix]]; select.all = true; move = {} | , line 9: fix.0.move: the key "displacement" is missing
[[fabric]]; group = 'a'; [[fabric]]; group = 'a' | , line 10: fabric.1.group: "a" has a [[fabric]] already
[[loads.force]]; select = { all = true } | , line 7: loads.force.0: the key "value" is missing: dead force
[loads]; force = 5 | , line 8: loads.force: 5 is an integer; allowed: tables in double brackets
[statics; | : not TOML: Expected ']' at the end of a table declaration (at line 7, column 9)
[[obstacles]] | , line 7: obstacles: unknown key (did you mean "obstacle"?)
[[load.force]] | , line 7: load: unknown key (did you mean "loads"?)
young = 1; [loads] | : not TOML: Cannot overwrite a value (at line 7, column 10)
[[obstacle]]; shape = 'sphere'; radius = 1 | , line 7: obstacle.0: the key "center" is missing
[[obstacle]]; shape = 'plane'; point = [0, 0, 0]; normal = [0, 0, 0] | , line 10: obstacle.0.normal: [0, 0, 0]
[[obstacle]]; shape = 'capsule'; a = [0, 0, 0]; b = [0, 0, 0]; radius = 1 | , line 10: obstacle.0.b: equals a
[[obstacle]]; shape = 'cone'; apex = [0, 0, 0]; axis = [0, 0, 1]; half_angle = 1.6 | , line 11: obstacle.0.hal
[[obstacle]]; shape = 'torus'; center = [0, 0, 0]; axis = [0, 0, 1]; radius = 1; tube = 1 | , line 12: obst
[[obstacle]]; shape = 'ellipsoid'; center = [0, 0, 0]; radii = [1, 0, 1] | , line 10: obstacle.0.radii: in [1,
[inverse]; observed = 'seen.obj' | , line 8: inverse.observed: tells of parameters; allowed with inverse.estimate
[scene]; task = 'inverse'; [[fix]]; select.all = true; move.displacement = [0, 0, 1] | , line 11: fix.0.move: the target
[inverse]; estimate = ['young', 'young'] | , line 8: inverse.estimate: ['young', 'young']; allowed: each para
[[obstacle]]; shape = 'sphere'; center = [0, 0, 0]; radius = 1; scale = 1.0 | , line 11: obstacle.0.scale: not
"""


@pytest.mark.parametrize(("lines", "message"), [row.split(" | ") for row in FORMS.strip().split("\n")])
def test_missing_keys_and_wrong_forms(tmp_path, lines, message):
    text = SHELL + lines.replace("; ", "\n").rstrip(";") + "\n"
    assert refusal(tmp_path, text).startswith(f"scene.toml{message}")


def test_a_missing_shell(tmp_path):
    assert refusal(tmp_path, "").startswith(
        'scene.toml: the key "shell" is missing: the shell; allowed: a table'
    )
    message = refusal(tmp_path, "[scene]\n" + SHELL.replace("young = 1.0e5\n", ""))
    assert message.startswith(
        'scene.toml, line 3: shell: the key "young" is missing: Young\'s modulus; allowed:'
    )


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: no such file"):
        read_scene(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_scene(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(InputError, match=r"not UTF-8 text .* at byte 8"):
        read_scene(tmp_path / "binary.toml")
    for text in ("a = " + "[" * 5000, "a = " + "9" * 5000, SHELL + f"scale = {10**400}"):
        assert refusal(tmp_path, text).startswith("scene.toml")


def test_an_hdf5_file_is_told_by_what_reads_it(tmp_path):
    (tmp_path / "problem.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(InputError, match=r"an HDF5 file; a scene file .* `voile friction` friction problems"):
        read_scene(tmp_path / "problem.h5")


# ---- the schema refuses what the reader refuses ----


def accepts(schema, value) -> bool:
    """Checks a value by the parts of JSON schema that json_schema uses."""
    types = {
        "object": dict,
        "array": list,
        "string": str,
        "boolean": bool,
        "integer": int,
        "number": (int, float),
    }
    kind = schema.get("type")
    if kind and (not isinstance(value, types[kind]) or (isinstance(value, bool) and kind != "boolean")):
        return False
    if value not in schema.get("enum", [value]) or value != schema.get("const", value):
        return False
    if "anyOf" in schema and not any(accepts(option, value) for option in schema["anyOf"]):
        return False
    if isinstance(value, str) and (
        not re.search(schema.get("pattern", ""), value) or len(value) < schema.get("minLength", 0)
    ):
        return False
    if isinstance(value, int | float) and (
        value <= schema.get("exclusiveMinimum", -float("inf"))
        or value >= schema.get("exclusiveMaximum", float("inf"))
        or not schema.get("minimum", -float("inf")) <= value <= schema.get("maximum", float("inf"))
    ):
        return False
    if isinstance(value, list):
        lengths = schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value))
        return lengths and all(accepts(schema.get("items", {}), item) for item in value)
    if isinstance(value, dict):
        known = schema.get("properties", {})
        rules = all(accepts(r["then"], value) for r in schema.get("allOf", ()) if accepts(r["if"], value))
        allowed = schema.get("additionalProperties", True) or set(value) <= set(known)
        required = set(schema.get("required", ())) <= set(value) and len(value) >= schema.get(
            "minProperties", 0
        )
        return (
            rules
            and allowed
            and required
            and all(accepts(known[k], v) for k, v in value.items() if k in known)
        )
    return True


def test_schema_agrees_with_the_reader():
    schema = json.loads(json.dumps(json_schema()))
    assert schema["$schema"].endswith("2020-12/schema")
    assert accepts(schema, tomllib.loads(FULL)) and accepts(schema, tomllib.loads(SHELL))
    for old, new, message in BAD_ROWS:
        if not any(part in message for part in BETWEEN_KEYS) and not {"nan", "2024-01-01"} & set(new.split()):
            assert not accepts(schema, tomllib.loads(FULL.replace(old, new))), new
    assert not accepts(schema, tomllib.loads(SHELL + "[[obstacle]]\nshape = 'sphere'\nradius = 1"))
