"""Scene files: defaults, tables, overrides, lines of keys, schema; bad input is in test_scene_errors.py."""

import dataclasses
import pickle
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
observed = "seen.obj"
also = ["other.toml"]
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
    steps = None  # 10, or 1 on what is still
    assert dataclasses.astuple(scene.statics) == (
        *(steps, 1000, 1.0, 1e-8, True, False, True, ()),
        *("load", 1.0, 0),
    )
    assert dataclasses.astuple(scene.dynamics) == (
        *("implicit-euler", 0.01, 1.0),
        *("newton", 1e-6, 20, False, 1e-3, 0.8, 1.0, "energy", (0.0, 0.0), 0.0),
    )
    assert dataclasses.astuple(scene.inverse) == (
        *(True, "adjoint", 0.0, 0.001, False, (), None, ()),
        *((), 0.0, 1e-3, 20, 1e-8, 0.0),
    )
    assert scene.output.every == 1


def test_every_table_is_read(tmp_path):
    scene = read(tmp_path, FULL)
    assert scene.shell.mesh == (tmp_path / "skirt.obj").resolve()
    assert scene.shell.rest == (tmp_path / "rest" / "skirt.obj").resolve()
    assert scene.fabric[0].thickness == 1e-3 and scene.fabric[0].young is None
    assert [f.value for f in scene.loads.force] == [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)]
    assert [f.select for f in scene.loads.force] == [{"nodes": [10, 11]}, {"nodes": 3}]
    assert scene.loads.moment[0].select == {"boundary": 0, "box": [[0, 0, 0], [0, 1, 1]]}
    assert scene.fix[0].axes == "xz" and not scene.fix[0].clamp
    assert scene.fix[0].move.displacement == (0.0, 0.0, 0.1)
    assert scene.fix[1].axes == "xyz" and not scene.fix[1].clamp and scene.fix[1].move is None
    assert scene.obstacle[0].radius == 0.2 and scene.obstacle[0].move.displacement == (0.0, 0.1, 0.0)
    assert scene.obstacle[1].file == (tmp_path / "body.obj").resolve() and scene.obstacle[1].scale == 2.0
    assert scene.inverse.developable == "panels" and scene.inverse.estimate == ("young",)
    assert scene.inverse.observed == (tmp_path / "seen.obj").resolve()
    assert scene.inverse.also == ((tmp_path / "other.toml").resolve(),)
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
    assert scene.fix[0].select == {"nodes": [1]} and scene.fix[1].axes == "xy"
    assert tomllib.loads(scene.text) == tomllib.loads(FULL)
    assert scene.text.splitlines()[-len(overrides) :] == [f"# --set {o}" for o in overrides]


def test_an_override_may_supply_a_missing_key_or_table(tmp_path):
    assert read(tmp_path, "", *(f"shell.{line}" for line in SHELL.split("\n")[2:-1])).shell.density == 300.0
    assert (
        read(tmp_path, SHELL.replace("young = 1.0e5", 'young = "soft"'), "shell.young=1").shell.young == 1.0
    )


def test_a_replaced_table_is_the_overrides_fault(tmp_path):
    override = "fix.0.move={displacement=[0]}"
    assert refusal(tmp_path, FULL, override).startswith(
        f"--set {override}: fix.0.move.displacement: [0] has length"
    )
    assert refusal(tmp_path, FULL, "fix.0.axes=xyy", "fix.0.clamp=true").startswith(
        "--set fix.0.axes=xyy: fix.0.axes"
    )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("shell.young", "--set shell.young: allowed: key=value"),
        ("scene.name=a\nb", "--set 'scene.name=a\\nb': a line break or control character"),
        ("scene.name=\x07", "--set 'scene.name=\\x07': a line break or control character"),
        ("shell..young=1", "--set shell..young=1: allowed: key=value"),
        ("shell.yuong=1", '--set shell.yuong=1: shell.yuong: unknown key (did you mean "young"?)'),
        (
            "shell.young=-1",
            "--set shell.young=-1: shell.young: -1 is not allowed; allowed: a finite number > 0 in Pa",
        ),
        ("shell.young=1 MPa", "--set shell.young=1 MPa: shell.young: '1 MPa' is text"),
        (
            "loadz.gravity=1",
            '--set loadz.gravity=1: loadz: unknown key (did you mean "loads"?); allowed: scene',
        ),
        ("shell.foo.bar=1", "--set shell.foo.bar=1: shell.foo: unknown key; allowed: mesh"),
        (
            "loads.gravity.1=1",
            "--set loads.gravity.1=1: loads.gravity is not a table; allowed: loads.gravity=VALUE",
        ),
        ("shell.young.high=1", "--set shell.young.high=1: shell.young is not a table"),
        ("fix.2.axes=xy", "--set fix.2.axes=xy: fix.2: allowed: an index from 0 to 1"),
        ("fix.-1.axes=xy", "--set fix.-1.axes=xy: fix.-1: allowed: an index from 0 to 1"),
        ("loads.gravity=[0,0", "--set loads.gravity=[0,0: the value is not TOML"),
        ("statics.load_steps=0", "--set statics.load_steps=0: statics.load_steps: 0 is not allowed"),
        *(
            (
                f"inverse.max_seconds={bad}",
                f"--set inverse.max_seconds={bad}: inverse.max_seconds: {bad} is not allowed",
            )
            for bad in ("-1", "nan", "inf")
        ),
        ("fix.0.select={node=1}", "--set fix.0.select={node=1}: fix.0.select.node: unknown key"),
    ],
)
def test_bad_overrides_name_the_override(tmp_path, override, message):
    assert refusal(tmp_path, FULL, override).startswith(message)


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
        ("a",): 7,
        ("list",): 13,
        ("list", 0): 13,
        ("list", 0, "k"): 14,
        ("list", 0, "sub"): 15,
        ("list", 0, "sub", "k"): 16,
        ("list", 1): 17,
        ("list", 1, "k"): 18,
        ("list", 1, "inner"): 19,
        ("list", 1, "inner", 0): 19,
        ("list", 1, "inner", 0, "k"): 20,
    }


def test_lines_of_tables_after_their_subtables():
    lines = key_lines("[[loads.force]]\nvalue = 1\n[loads]\npressure = 2")
    assert lines[("loads",)] == 3 and lines[("loads", "force", 0, "value")] == 2


# ---- schema, and what this version leaves out ----


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
    assert keys["loads.gravity"]["default"] == [0.0, -9.81, 0.0] and keys["fix.clamp"]["default"] is False


def test_unsupported_names_the_keys(tmp_path):
    assert unsupported(read(tmp_path, SHELL + "[dynamics]\n[inverse]")) == []
    assert unsupported(read(tmp_path, FULL)) == []
    assert unsupported(read(tmp_path, SHELL, "scene.task=modes")) == []
    assert unsupported(read(tmp_path, SHELL, "shell.model=projective")) == []


def test_the_example_of_every_run_is_a_scene():
    scenes = sorted(Path(__file__).parents[1].glob("runs/*/scene.toml"))
    if not scenes:
        pytest.skip("no runs/*/scene.toml yet")
    for path in scenes:
        assert read_scene(path).scene.task
