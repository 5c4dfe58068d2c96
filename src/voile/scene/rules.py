"""What does not go together in a scene: rules between its tables. Each raises Rejected with a key's path, what is wrong
there and what is allowed. What a table can tell by itself is in its own `check`."""

from collections.abc import Iterator

from voile.elastic.stresses import lacking
from voile.elastic.weave import STIFFNESSES
from voile.keys import Rejected
from voile.scene.moves import Move
from voile.scene.pattern import Pattern
from voile.scene.schema import Fabric, Scene, Shell

MOST_STEPS = 1e9  # of a run in time: years of computing
WOVEN = ("fabric", "young_weft", "shear", "bending_warp", "bending_weft", "bending_twist", "warp")
WOVEN_MODELS = ("koiter", "membrane")
Place = tuple[str | int, ...]


def check(scene: Scene, given: set[str]) -> None:
    """Raises Rejected where the scene breaks a rule; given: its tables in the file."""
    for rule in (
        _target,
        _rotation,
        _only_in_time,
        _pattern,
        _modes,
        _arc_length,
        _rebound,
        _steps_in_time,
        _kept_in_time,
        _local_global,
        _told,
        _woven,
        _shrunk,
        _joint_stiffness,
        _supports,
        _springs,
        _groups,
    ):
        rule(scene, given)


def _moves(scene: Scene) -> Iterator[tuple[Place, Move]]:
    """The motions of supports and obstacles."""
    for table in ("fix", "obstacle"):
        for index, each in enumerate(getattr(scene, table)):
            if each.move:
                yield (table, index, "move"), each.move


def _fabrics(scene: Scene) -> Iterator[tuple[Place, Shell | Fabric]]:
    """What the shell is made of, everywhere and by group."""
    yield ("shell",), scene.shell
    for index, fabric in enumerate(scene.fabric):
        yield ("fabric", index), fabric


def _projective(scene: Scene) -> bool:
    """Whether steps in time are Projective Dynamics."""
    return scene.scene.task == "dynamics" and scene.dynamics.solver == "local-global"


# ---- tasks ----


def _target(scene: Scene, given: set[str]) -> None:
    """task = inverse: what may be known of the target and its rest shape."""
    if scene.scene.task != "inverse":
        return
    if scene.inverse.estimate:
        if scene.shell.rest is None:
            _unknown_rest(scene)
        return
    if scene.shell.rest == "flat":
        raise Rejected(
            '"flat" is not a first guess of a rest surface; allowed: a file, or inverse.developable = "panels" '
            "without shell.rest",
            ("shell", "rest"),
        )
    for place, _ in _moves(scene):
        raise Rejected(
            "the target is where all motion has ended; allowed with task = inverse: no move", place
        )


def _unknown_rest(scene: Scene) -> None:
    """Estimation of parameters beside the rest shape."""
    if not scene.inverse.also:
        raise Rejected(
            "needs shell.rest: with the rest shape unknown too, every value fits one observed shape; or further "
            "observations, inverse.also",
            ("inverse", "estimate"),
        )
    if "friction" in scene.inverse.estimate or scene.obstacle or scene.inverse.observed:
        raise Rejected(
            "needs shell.rest; allowed without: parameters of the fabric, a mesh that is the observed shape, "
            "no [[obstacle]]",
            ("inverse", "estimate"),
        )


def _rotation(scene: Scene, given: set[str]) -> None:
    for index, fix in enumerate(scene.fix):
        if fix.move and any(fix.move.rotation) and scene.scene.task not in ("statics", "dynamics"):
            raise Rejected("allowed with task = statics or dynamics", ("fix", index, "move", "rotation"))


def _only_in_time(scene: Scene, given: set[str]) -> None:
    """What only task = dynamics has a time for."""
    if scene.scene.task == "dynamics":
        return
    for name in ("wind", "drag", "history"):
        value = getattr(scene.loads, name)
        if any(value) if isinstance(value, tuple) else value:
            raise Rejected("allowed with task = dynamics", ("loads", name))
    for place, move in _moves(scene):
        if move.in_time:
            raise Rejected("allowed without task = dynamics: displacement, rotation, center", place)
    for index, body in enumerate(scene.obstacle):
        if getattr(body, "frames", None):
            raise Rejected("allowed with task = dynamics", ("obstacle", index, "frames"))


def _pattern(scene: Scene, given: set[str]) -> None:
    if scene.pattern != Pattern() and (scene.scene.task != "inverse" or scene.inverse.estimate):
        raise Rejected("allowed with task = inverse, without inverse.estimate", ("pattern",))


def _modes(scene: Scene, given: set[str]) -> None:
    if scene.scene.task != "modes":
        return
    if "inverse" in given:
        raise Rejected('allowed with task = "inverse" only; task is "modes"', ("inverse",))
    if scene.loads.moment:
        raise Rejected(
            "has no potential, so the shell has no natural modes; allowed with task = modes: gravity, pressure, force",
            ("loads", "moment"),
        )
    contact = scene.obstacle or scene.contact.self_contact
    if scene.modes.buckling and contact:
        where = ("obstacle",) if scene.obstacle else ("contact", "self_contact")
        raise Rejected("allowed with modes.buckling = true: no contact", where)
    if contact and scene.modes.about != 1.0:
        raise Rejected(f"{scene.modes.about:g}; allowed with contact: 1", ("modes", "load_factor"))


def _arc_length(scene: Scene, given: set[str]) -> None:
    if scene.statics.control != "arc-length":
        return
    if scene.scene.task != "statics":
        raise Rejected('"arc-length" is allowed with task = "statics" only', ("statics", "control"))
    allowed = 'allowed with statics.control = "arc-length"'
    for index, fix in enumerate(scene.fix):
        if fix.move:
            raise Rejected(f"{allowed}: supports that do not move", ("fix", index, "move"))
    if scene.contact.self_contact:
        raise Rejected(f"{allowed}: false", ("contact", "self_contact"))
    for index, body in enumerate(scene.obstacle):
        if body.move:
            raise Rejected(f"{allowed}: obstacles that do not move", ("obstacle", index, "move"))
        if body.friction:
            raise Rejected(f"{body.friction:g}; {allowed}: 0", ("obstacle", index, "friction"))


# ---- time ----


def _rebound(scene: Scene, given: set[str]) -> None:
    if (scene.scene.task, scene.dynamics.scheme) == ("dynamics", "moreau-jean"):
        return
    for index, body in enumerate(scene.obstacle):
        if body.restitution:
            raise Rejected(
                'allowed above 0 with task = dynamics and dynamics.scheme = "moreau-jean" only',
                ("obstacle", index, "restitution"),
            )


def _steps_in_time(scene: Scene, given: set[str]) -> None:
    d = scene.dynamics
    for place, move in _moves(scene):
        if move.until is None and move.begin >= d.duration:
            raise Rejected(
                f"{move.begin:g} s; allowed: before the end of dynamics.duration = {d.duration:g} s",
                (*place, "from"),
            )
    if d.duration > MOST_STEPS * d.time_step:
        raise Rejected(
            f"allowed: at least {d.duration / MOST_STEPS:g} s, a run has {MOST_STEPS:g} steps at most",
            ("dynamics", "time_step"),
        )


def _kept_in_time(scene: Scene, given: set[str]) -> None:
    """What a scheme can keep to round-off: with forces at the step's start, half of them for what needs its middle."""
    d = scene.dynamics
    early = d.scheme in ("moreau-jean", "generalized-alpha")
    centred = (d.scheme, d.theta) == ("moreau-jean", 0.5) or (
        (d.scheme, d.spectral_radius) == ("generalized-alpha", 1.0)
    )
    if not {"energy": True, "nothing": early, "angular-momentum": centred}[d.keeps]:
        raise Rejected(
            f'"{d.keeps}" fits scheme = "moreau-jean" or "generalized-alpha"'
            + ", with theta = 0.5 or spectral_radius = 1" * (d.keeps != "nothing"),
            ("dynamics", "keeps"),
        )


def _local_global(scene: Scene, given: set[str]) -> None:
    if _projective(scene) and scene.shell.model != "projective":
        raise Rejected(
            f'fits shell.model = "projective" only, which is "{scene.shell.model}" here',
            ("dynamics", "solver"),
        )


# ---- shell, supports, what is told ----


def _told(scene: Scene, given: set[str]) -> None:
    """Section forces and fields per triangle."""
    if scene.section and scene.scene.task not in ("statics", "dynamics"):
        raise Rejected("allowed with task = statics or dynamics", ("section",))
    if scene.output.fields and scene.scene.task not in ("statics", "dynamics"):
        raise Rejected("allowed with task = statics or dynamics", ("output", "fields"))
    for name, why in lacking(scene.shell.model, scene.shell.material).items():
        if name in scene.output.fields:
            raise Rejected(f'"{name}": {why}', ("output", "fields"))


def _woven(scene: Scene, given: set[str]) -> None:
    """Stiffnesses along warp and weft."""
    shell, woven = scene.shell, scene.shell.material == "orthotropic"
    names = [name for name in scene.inverse.estimate if name in STIFFNESSES]
    if names and not woven:
        raise Rejected(f'"{names[0]}": allowed with shell.material = "orthotropic"', ("inverse", "estimate"))
    if woven and shell.model not in WOVEN_MODELS:
        allowed = '"orthotropic" fits shell.model = "koiter" or "membrane"'
        raise Rejected(f'{allowed}, not "{shell.model}"', ("shell", "material"))
    for path, table in _fabrics(scene):
        asked = [name for name in WOVEN if getattr(table, name) not in (None, "")]
        if asked and not woven:
            raise Rejected('allowed with shell.material = "orthotropic"', (*path, asked[0]))


def _shrunk(scene: Scene, given: set[str]) -> None:
    if scene.scene.task != "inverse":
        return
    for path, table in _fabrics(scene):
        if table.shrink:
            raise Rejected("allowed with task = inverse: 0", (*path, "shrink"))


def _joint_stiffness(scene: Scene, given: set[str]) -> None:
    if scene.shell.joint_stiffness and (not scene.shell.joints or scene.shell.model == "membrane"):
        allowed = "allowed above 0 with shell.joints = true and a model that bends"
        raise Rejected(allowed, ("shell", "joint_stiffness"))


def _supports(scene: Scene, given: set[str]) -> None:
    """Local axes of supports."""
    for index, fix in enumerate(scene.fix):
        if fix.frame and scene.scene.task == "inverse":
            raise Rejected("allowed without task = inverse", ("fix", index, "frame"))
        if fix.frame and _projective(scene):
            raise Rejected('allowed with dynamics.solver = "newton"', ("fix", index, "frame"))


def _springs(scene: Scene, given: set[str]) -> None:
    """Elastic supports, bars and stiff joints."""
    bars: list[Place] = [(name,) for name in ("band", "tie") if getattr(scene, name)]
    if scene.shell.joint_stiffness:
        bars.append(("shell", "joint_stiffness"))
    springs: list[Place] = [("spring",), *bars] if scene.spring else bars
    if springs and scene.scene.task == "inverse":
        raise Rejected("allowed with task = statics or dynamics, or modes", springs[0])
    if bars and scene.scene.task == "modes" and scene.modes.buckling:
        raise Rejected("allowed with modes.buckling = false: loads pull on it", bars[0])
    if springs and _projective(scene):
        raise Rejected('allowed with dynamics.solver = "newton"', springs[0])


def _groups(scene: Scene, given: set[str]) -> None:
    groups = [fabric.group for fabric in scene.fabric]
    for index, group in enumerate(groups):
        if group in groups[:index]:
            raise Rejected(
                f'"{group}" has a [[fabric]] already; allowed: one per group', ("fabric", index, "group")
            )
