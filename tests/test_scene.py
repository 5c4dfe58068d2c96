"""Scene files: defaults, every key of the schema, overrides, one clear message for each kind of bad input."""

import dataclasses
import json
import pickle
import re
import tomllib
from pathlib import Path

import pytest

from voile.errors import InputError
from voile.scene import json_schema, read_scene, unsupported
from voile.scene.reader import key_lines

SHELL = """
[shell]
mesh = "skirt.obj"
young = 1.0e5
thickness = 1e-3
density = 300
"""

FULL = """
[scene]
name = "skirt on a dress form"
task = "statics"
[shell]
mesh = "skirt.obj"
rest = "rest/skirt.obj"
scale = 0.001
model = "koiter"
bending = "average"
material = "neo-hookean"
young = 2.0e5
poisson = -0.2
thickness = 5e-4
density = 250.0
seams = false
[[fabric]]
group = "collar"
thickness = 1e-3
[loads]
gravity = [0, 0, -9.81]
pressure = 5
[[loads.force]]
select = { nodes = [10, 11] }
value = [0.0, 0.0, 1.0]
[[loads.force]]
select = { nodes = 3 }
value = [1, 0, 0]
[[loads.moment]]
select = { boundary = 0, box = [[0, 0, 0], [0, 1, 1]] }
value = 0.5
[[fix]]
select = { group = ["waist", "hem"] }
axes = "xz"
clamp = false
[fix.move]
displacement = [0.0, 0.0, 0.1]
[[fix]]
select = { all = true }
[[obstacle]]
shape = "sphere"
center = [0.0, 0.0, 0.0]
radius = 0.2
friction = 0.3
move = { displacement = [0.0, 0.1, 0.0] }
[[obstacle]]
shape = "mesh"
file = "body.obj"
scale = 2
[contact]
offset = 0.0005
self_contact = true
[statics]
load_steps = 4
eigenvalue = true
[dynamics]
scheme = "bdf2"
[inverse]
developable = "panels"
estimate = ["young"]
[output]
every = 3
"""


def read(tmp_path, text, *overrides):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    return read_scene(path, overrides)


def refusal(tmp_path, text, *overrides) -> str:
    """The message, without the folder; always one line."""
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, *overrides)
    message = str(caught.value).replace(f"{tmp_path}/", "")
    assert "\n" not in message
    return message


def test_defaults_are_those_of_the_interface(tmp_path):
    scene = read(tmp_path, SHELL)
    assert scene.scene.task == "statics" and scene.shell.rest is None and scene.shell.seams is True
    assert (scene.shell.model, scene.shell.bending, scene.shell.material) == ("koiter", "tan", "stvk")
    assert (scene.shell.scale, scene.shell.poisson) == (1.0, 0.3)
    assert scene.loads.gravity == (0.0, -9.81, 0.0) and scene.loads.pressure == 0.0
    assert scene.fix == scene.fabric == scene.obstacle == scene.loads.force == scene.loads.moment == ()
    assert scene.contact.offset is None and scene.contact.self_contact is False
    assert dataclasses.astuple(scene.statics) == (10, 1000, 1.0, 1e-8, True, False)
    assert dataclasses.astuple(scene.dynamics) == ("implicit-euler", 0.01, 1.0)
    assert dataclasses.astuple(scene.inverse) == (True, "adjoint", 0.001, False, ())
    assert scene.output.every == 1


def test_every_table_is_read(tmp_path):
    scene = read(tmp_path, FULL)
    assert scene.shell.mesh == (tmp_path / "skirt.obj").resolve()
    assert scene.shell.rest == (tmp_path / "rest" / "skirt.obj").resolve()
    assert scene.fabric[0].thickness == 1e-3 and scene.fabric[0].young is None
    assert [f.value for f in scene.loads.force] == [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)]
    assert [f.select for f in scene.loads.force] == [{"nodes": (10, 11)}, {"nodes": 3}]
    assert scene.loads.moment[0].select == {"boundary": 0, "box": ((0, 0, 0), (0, 1, 1))}
    assert scene.fix[0].axes == "xz" and not scene.fix[0].clamp
    assert scene.fix[0].move.displacement == (0.0, 0.0, 0.1)
    assert scene.fix[1].axes == "xyz" and scene.fix[1].clamp and scene.fix[1].move is None
    assert scene.obstacle[0].radius == 0.2 and scene.obstacle[0].move.displacement == (0.0, 0.1, 0.0)
    assert scene.obstacle[1].file == (tmp_path / "body.obj").resolve() and scene.obstacle[1].scale == 2.0
    assert scene.inverse.developable == "panels" and scene.inverse.estimate == ("young",)
    assert scene.output.every == 3 and scene.text == FULL and scene.path == tmp_path / "scene.toml"


def test_a_relative_scene_path_gives_absolute_files(tmp_path, monkeypatch):
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "scene.toml").write_text(SHELL)
    monkeypatch.chdir(tmp_path)
    assert read_scene("runs/scene.toml").shell.mesh == (tmp_path / "runs" / "skirt.obj").resolve()


def test_flat_rest_is_a_word_and_dot_slash_flat_a_file(tmp_path):
    assert read(tmp_path, SHELL + 'rest = "flat"').shell.rest == "flat"
    assert read(tmp_path, SHELL + 'rest = "./flat"').shell.rest == (tmp_path / "flat").resolve()


def test_scenes_are_frozen_and_travel_between_ranks(tmp_path):
    scene = read(tmp_path, FULL)
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.shell.young = 1.0
    assert pickle.loads(pickle.dumps(scene)) == scene


# ---- overrides ----


def test_overrides_apply_in_order_and_are_kept_in_the_text(tmp_path):
    overrides = (
        "shell.young=2e5",
        "shell.young=3e5",
        "shell.model=membrane",
        'scene.name="a = b"',
        "loads.gravity=[0,0,-9.81]",
        "statics.load_steps = 2",
        "fix.1.axes=xy",
        "fix.0.select={ nodes = [1] }",
    )
    scene = read(tmp_path, FULL.rstrip(), *overrides)
    assert scene.shell.young == 3e5 and scene.shell.model == "membrane" and scene.scene.name == "a = b"
    assert scene.loads.gravity == (0.0, 0.0, -9.81) and scene.statics.load_steps == 2
    assert scene.fix[0].select == {"nodes": (1,)} and scene.fix[1].axes == "xy"
    assert tomllib.loads(scene.text) == tomllib.loads(FULL)
    assert scene.text.splitlines()[-len(overrides) :] == [f"# --set {o}" for o in overrides]


def test_an_override_may_supply_a_missing_key_or_table(tmp_path):
    assert read(tmp_path, "", *(f"shell.{line}" for line in SHELL.split("\n")[2:-1])).shell.density == 300.0
    assert (
        read(tmp_path, SHELL.replace("young = 1.0e5", 'young = "soft"'), "shell.young=1").shell.young == 1.0
    )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("shell.young", "--set shell.young: allowed: key=value"),
        ("shell..young=1", "--set shell..young=1: allowed: key=value"),
        ("shell.yuong=1", '--set shell.yuong=1: shell.yuong: unknown key (did you mean "young"?)'),
        (
            "shell.young=-1",
            "--set shell.young=-1: shell.young: -1 is not allowed; allowed: a finite number > 0 in Pa",
        ),
        ("shell.young=1 MPa", "--set shell.young=1 MPa: shell.young: '1 MPa' is text"),
        ("shell.young.high=1", "--set shell.young.high=1: shell.young is not a table"),
        ("fix.2.axes=xy", "--set fix.2.axes=xy: fix.2: allowed: an index from 0 to 1"),
        ("fix.-1.axes=xy", "--set fix.-1.axes=xy: fix.-1: allowed: an index from 0 to 1"),
        ("loads.gravity=[0,0", "--set loads.gravity=[0,0: the value is not TOML"),
        ("statics.load_steps=0", "--set statics.load_steps=0: statics.load_steps: 0 is not allowed"),
        ("fix.0.select={node=1}", "--set fix.0.select={node=1}: fix.0.select.node: unknown key"),
    ],
)
def test_bad_overrides_name_the_override(tmp_path, override, message):
    assert refusal(tmp_path, FULL, override).startswith(message)


# ---- bad input: (replaced in FULL, by, line of the key, start of the rest of the message) ----

BAD = [
    (
        "thickness = 5e-4",
        'thickness = "1 mm"',
        "shell.thickness: '1 mm' is text; allowed: a finite number > 0 in m",
    ),
    (
        "thickness = 5e-4",
        "thickness = 0",
        "shell.thickness: 0 is not allowed; allowed: a finite number > 0 in m",
    ),
    ("thickness = 5e-4", "thickness = nan", "shell.thickness: nan is not allowed"),
    ("thickness = 5e-4", "thickness = true", "shell.thickness: true is a boolean"),
    (
        "thickness = 5e-4",
        "thikness = 5e-4",
        'shell.thikness: unknown key (did you mean "thickness"?); allowed: mesh,',
    ),
    ("young = 2.0e5", f"young = {10**400}", "shell.young: 1000"),
    ("young = 2.0e5", "young = -1.0", "shell.young: -1.0 is not allowed; allowed: a finite number > 0 in Pa"),
    (
        "poisson = -0.2",
        "poisson = 0.5",
        "shell.poisson: 0.5 is not allowed; allowed: a finite number > -1 and < 0.5",
    ),
    ("poisson = -0.2", "poisson = -1", "shell.poisson: -1 is not allowed"),
    (
        "density = 250.0",
        "density = -3.0",
        "shell.density: -3.0 is not allowed; allowed: a finite number > 0 in kg/m^3",
    ),
    ("density = 250.0", "density = 2024-01-01", "shell.density: datetime.date(2024, 1, 1) is a date or time"),
    ("seams = false", "seams = 0", "shell.seams: 0 is an integer; allowed: true, false"),
    ('mesh = "skirt.obj"', 'mesh = ""', "shell.mesh: '' is not allowed; allowed: text, not empty"),
    (
        'mesh = "skirt.obj"',
        "mesh = 3",
        "shell.mesh: 3 is an integer; allowed: a path relative to the scene file",
    ),
    (
        'model = "koiter"',
        'model = "koitre"',
        "shell.model: 'koitre' is not allowed (did you mean \"koiter\"?); allowed:",
    ),
    ("scale = 0.001", "gravity = [0, 0, 0]", "shell.gravity: unknown key; allowed: mesh,"),
    (
        "gravity = [0, 0, -9.81]",
        "gravity = [0, 0]",
        "loads.gravity: [0, 0] has length 2; allowed: an array of 3 values",
    ),
    (
        "gravity = [0, 0, -9.81]",
        "gravity = -9.81",
        "loads.gravity: -9.81 is a number; allowed: an array of 3",
    ),
    ("gravity = [0, 0, -9.81]", 'gravity = [0, 0, "g"]', "loads.gravity: in [0, 0, 'g'], 'g' is text"),
    (
        "{ nodes = 3 }",
        "{ nodes = -3 }",
        "loads.force.1.select.nodes: -3 is an integer; allowed: an integer >= 0",
    ),
    ("{ nodes = 3 }", "{ nodes = [] }", "loads.force.1.select.nodes: [] has length 0; allowed:"),
    ("{ nodes = 3 }", "{ nodes = [0, 1.5] }", "loads.force.1.select.nodes: in [0, 1.5], 1.5 is a number"),
    (
        "{ nodes = 3 }",
        "{ vertices = 3 }",
        "loads.force.1.select.vertices: unknown key; allowed: nodes, group, box,",
    ),
    ("{ nodes = 3 }", "{}", "loads.force.1.select: {} is not allowed; allowed: a table with one or more of"),
    ("{ nodes = 3 }", "[3]", "loads.force.1.select: [3] is an array; allowed: a table with one or more of"),
    (
        "[[0, 0, 0], [0, 1, 1]]",
        "[[0, 0, 0], [0, -1, 1]]",
        "loads.moment.0.select.box: [[0, 0, 0], [0, -1, 1]] is not",
    ),
    (
        "[[0, 0, 0], [0, 1, 1]]",
        "[0, 0, 0]",
        "loads.moment.0.select.box: [0, 0, 0] is not allowed; allowed: [[xmin,",
    ),
    (
        '["waist", "hem"]',
        '["waist", 1]',
        "fix.0.select.group: in ['waist', 1], 1 is an integer; allowed: text",
    ),
    ("{ all = true }", "{ all = false }", "fix.1.select.all: false is not allowed; allowed: true"),
    (
        'axes = "xz"',
        'axes = "xw"',
        "fix.0.axes: 'xw' is not allowed; allowed: one or more of the letters x, y, z",
    ),
    ('axes = "xz"', 'axes = "xx"', "fix.0.axes: 'xx' is not allowed"),
    ('axes = "xz"', 'axes = ""', "fix.0.axes: '' is not allowed"),
    (
        "[0.0, 0.0, 0.1]",
        "[0.0, 0.2, 0.1]",
        'fix.0.move.displacement: 0.2 m along y, but axes = "xz" leaves y free',
    ),
    (
        "radius = 0.2",
        "radius = 0.0",
        "obstacle.0.radius: 0.0 is not allowed; allowed: a finite number > 0 in m",
    ),
    (
        "radius = 0.2",
        "radii = [1, 1, 1]",
        'obstacle.0.radii: not a key of shape = "sphere"; allowed: center, radius',
    ),
    (
        "friction = 0.3",
        "friction = -0.1",
        "obstacle.0.friction: -0.1 is not allowed; allowed: a finite number >= 0",
    ),
    (
        "offset = 0.0005",
        "offset = -1",
        "contact.offset: -1 is not allowed; allowed: a finite number >= 0 in m",
    ),
    ("load_steps = 4", "load_steps = 2.5", "statics.load_steps: 2.5 is a number; allowed: an integer >= 1"),
    (
        "load_steps = 4",
        "tolerance = 1.0",
        "statics.tolerance: 1.0 is not allowed; allowed: a finite number > 0 and < 1",
    ),
    (
        'developable = "panels"',
        "developable = true",
        'inverse.developable: true is not allowed; allowed: false, "constr',
    ),
    ('["young"]', '["stiffness"]', "inverse.estimate: in ['stiffness'], 'stiffness' is not allowed"),
    ("every = 3", "every = 0", "output.every: 0 is not allowed; allowed: an integer >= 1"),
    ("[output]", "[outputs]", 'outputs: unknown key (did you mean "output"?); allowed: scene, shell,'),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD)
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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", 'scene.toml: the key "shell" is missing'),
        (
            "[scene]\n" + SHELL.replace("young = 1.0e5\n", ""),
            'scene.toml, line 3: shell: the key "young" is missing: Young',
        ),
        (SHELL + "[[fix]]\naxes = 'x'", 'scene.toml, line 7: fix.0: the key "select" is missing'),
        (
            SHELL + "[fix]\naxes = 'x'",
            "scene.toml, line 7: fix: {'axes': 'x'} is a table; allowed: tables in double",
        ),
        (
            SHELL + "[[fix]]\nselect.all = true\nmove = {}",
            'scene.toml, line 9: fix.0.move: the key "displacement" is',
        ),
        (
            SHELL + "[[obstacle]]\nshape = 'sphere'\nradius = 1",
            'scene.toml, line 7: obstacle.0: the key "center" is',
        ),
        (
            SHELL + "[[fabric]]\ngroup = 'a'\n[[fabric]]\ngroup = 'a'",
            'scene.toml, line 10: fabric.1.group: "a" has',
        ),
        (SHELL + "loads.force = 5", "scene.toml, line 7: shell.loads: unknown key"),
        (
            "loads.force = 5" + SHELL,
            "scene.toml, line 1: loads.force: 5 is an integer; allowed: tables in double",
        ),
        ("shell = 3", "scene.toml, line 1: shell: 3 is an integer; allowed: a table with the keys mesh,"),
        (
            "[shell\n",
            "scene.toml: not TOML: Expected ']' at the end of a table declaration (at line 1, column 7)",
        ),
        (SHELL + "young = 1\n[loads]", "scene.toml: not TOML: Cannot overwrite a value (at line 7"),
    ],
)
def test_missing_keys_and_wrong_forms(tmp_path, text, message):
    assert refusal(tmp_path, text).startswith(message)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            "shape = 'plane'\npoint = [0, 0, 0]\nnormal = [0, 0, 0]",
            "line 10: obstacle.0.normal: [0, 0, 0] is not allowed",
        ),
        ("shape = 'capsule'\na = [0, 0, 0]\nb = [0, 0, 0]\nradius = 1", "line 10: obstacle.0.b: equals a"),
        (
            "shape = 'cone'\napex = [0, 0, 0]\naxis = [0, 0, 1]\nhalf_angle = 1.6",
            "line 11: obstacle.0.half_angle: 1.6 is",
        ),
        (
            "shape = 'torus'\ncenter = [0, 0, 0]\naxis = [0, 0, 1]\nradius = 1\ntube = 1",
            "line 12: obstacle.0.tube: 1;",
        ),
        (
            "shape = 'ellipsoid'\ncenter = [0, 0, 0]\nradii = [1, 0, 1]",
            "line 10: obstacle.0.radii: in [1, 0, 1], 0 is not",
        ),
        (
            "shape = 'sphere'\ncenter = [0, 0, 0]\nradius = 1\nscale = 1.0",
            "line 11: obstacle.0.scale: not a key of",
        ),
    ],
)
def test_bad_obstacles(tmp_path, keys, message):
    assert refusal(tmp_path, SHELL + f"[[obstacle]]\n{keys}").startswith(f"scene.toml, {message}")


def test_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="none.toml: no such file"):
        read_scene(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_scene(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(InputError, match="not UTF-8 text .* at byte 8"):
        read_scene(tmp_path / "binary.toml")
    for text in ("a = " + "[" * 5000, "a = " + "9" * 5000):
        assert refusal(tmp_path, text).startswith("scene.toml: ")


def test_lines_of_keys_in_unusual_toml():
    text = '''# [comment] with = signs
top = 1
note = """
[not.a.table]
key = 1
"""  # ends here
[a."b.c"]  # [[quoted]]
"x=y" = [
  1, # ]
  "]",
]
d.e.f = { inline = 1 }
[[list]]
k = '#'
[list.sub]
k = 2
[[list]]
k = 3
[[list.inner]]
k = 4
'''
    assert key_lines(text) == {
        ("top",): 2,
        ("note",): 3,
        ("a", "b.c"): 7,
        ("a", "b.c", "x=y"): 8,
        ("a", "b.c", "d"): 12,
        ("a", "b.c", "d", "e"): 12,
        ("a", "b.c", "d", "e", "f"): 12,
        ("list", 0): 13,
        ("list", 0, "k"): 14,
        ("list", 0, "sub"): 15,
        ("list", 0, "sub", "k"): 16,
        ("list", 1): 17,
        ("list", 1, "k"): 18,
        ("list", 1, "inner", 0): 19,
        ("list", 1, "inner", 0, "k"): 20,
    }


# ---- schema, and what this version leaves out ----


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
    if "enum" in schema and value not in schema["enum"] or "const" in schema and value != schema["const"]:
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
        or value < schema.get("minimum", -float("inf"))
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
    between_keys = ("leaves y free", "not a key of shape", "nan is", "shell.young: 1000", "[0, -1, 1]")
    for old, new, message in BAD:
        if not any(part in message for part in between_keys) and "2024" not in new:
            assert not accepts(schema, tomllib.loads(FULL.replace(old, new))), new
    assert not accepts(schema, tomllib.loads(SHELL + "[[obstacle]]\nshape = 'sphere'\nradius = 1"))


def test_schema_describes_every_key_with_its_unit():
    def walk(table, where):
        for name, entry in table.get("properties", {}).items():
            yield f"{where}{name}", entry
            yield from walk(entry.get("items", entry), f"{where}{name}.")

    keys = dict(walk(json_schema(), ""))
    undescribed = [k for k, v in keys.items() if not v.get("description") and ".select." not in k]
    assert undescribed == []
    assert keys["shell.young"]["description"].endswith("(Pa)")
    assert keys["loads.gravity"]["description"].endswith("(m/s^2)")
    assert keys["loads.gravity"]["default"] == [0.0, -9.81, 0.0] and keys["fix.clamp"]["default"] is True


def test_unsupported_names_the_keys(tmp_path):
    assert unsupported(read(tmp_path, SHELL + "[dynamics]\n[inverse]")) == []
    assert unsupported(read(tmp_path, FULL)) == ["[[obstacle]]", "contact.self_contact = true"]
    overrides = ("scene.task=modes", "shell.model=projective")
    assert unsupported(read(tmp_path, SHELL, *overrides)) == [
        'scene.task = "modes"',
        'shell.model = "projective"',
    ]


def test_the_example_of_every_run_is_a_scene():
    scenes = sorted(Path(__file__).parents[1].glob("runs/*/scene.toml"))
    if not scenes:
        pytest.skip("no runs/*/scene.toml yet")
    for path in scenes:
        assert read_scene(path).scene.task
