"""What a run will model and why: terms, unknowns, solver, memory. Solves nothing. For commands only."""

import numpy as np

from voile import blas
from voile.arrays import diagonal
from voile.elastic import MODELS, has_directors
from voile.elastic.plate import FlatMesh, Stiffness
from voile.launch import threads
from voile.problem.follower import conservative
from voile.problem.shell import Shell, seam_gaps
from voile.scene import Scene
from voile.solver.multigrid import LARGE, unfit
from voile.solver.nested import Options
from voile.wiring import Model, weight

REPEATED = 0.1  # shapes per triangle below which a mesh repeats its cells; irregular meshes have 0.5 to 1
PLATE = 0.03  # share of the plate's stiffness by which a model may miss it unsaid
PLANE = 1e-6  # of the size: a rest shape nearer to a plane has no curvature of its own
PATCH = 8000  # triangles that are enough to tell
STIFFNESS_RATIO = 1e-12  # (thickness/size)^2 under which bending stiffness is lost in double precision


Row = tuple[str, bool, str]  # a term or unknown, whether it is kept or left out, the reason


def modelled(scene: Scene, model: Model) -> list[Row]:
    """Every term and unknown that the program knows."""
    return [*_of_shell(scene, model.shell), *_of_loads(model.shell), *_of_contact(scene, model)]


def _row(name: str, kept: bool, why: str, why_not: str) -> Row:
    return name, kept, why if kept else why_not


def _of_shell(scene: Scene, shell: Shell) -> list[Row]:
    spec, row, directors = scene.shell, MODELS[scene.shell.model], has_directors(shell.model)
    inner, slaves = int((shell.topology.across >= 0).sum()) // 2, len(np.unique(shell.slave))
    turns = "bend like the cloth" if shell.seam_bending else "turn freely"
    stretched = f"material {spec.material}" if row.material else "lengths and areas"
    bent = f"model {spec.model}, {inner} hinges"
    angles = f"one unknown per edge for bending = {spec.bending!r}"
    none = "mid-edge normals are averages of the faces'" if row.normals else f"model {spec.model} has none"
    curved = "the flat rest shape has none" if shell.flat else "from the rest shape"
    gap = seam_gaps(shell).max(initial=0.0)
    sewn = f"{len(shell.slave)} stitches eliminate {slaves} vertices, up to {gap:.2g} m apart at the start; "
    sewn += f"sewn edges {turns}"
    return [
        ("stretching", True, stretched),
        _row("bending", row.bends, bent, f"a {spec.model} has no bending stiffness"),
        _row("director angles", directors, angles, none),
        ("rest curvature", row.bends and not shell.flat, curved),
        _row("seams", len(shell.slave) > 0, sewn, "no stitch records"),
    ]


def _of_loads(shell: Shell) -> list[Row]:
    elastic = [rows is not None for rows in (shell.springs, shell.bars, shell.welds)]
    held = 0 if shell.springs is None else int(shell.springs.any(axis=1).sum())
    bars, welds = (0 if rows is None else len(rows) for rows in (shell.bars, shell.welds))
    springs = f"[[spring]] at {held} vertices, {bars} bars of [[band]] and [[tie]]"
    springs += f", {welds} edges of shell.joint_stiffness"
    no_springs = "no [[spring]], [[band]], [[tie]] or shell.joint_stiffness"
    no_pressure = "loads.pressure is zero, and no [[loads.patch]]"
    return [
        _row("gravity", bool(shell.gravity.any()), f"{weight(shell):.4g} kg", "loads.gravity is zero"),
        _row("pressure", shell.pressed, "follows the surface", no_pressure),
        _row("dead forces", shell.force is not None, "loads.force", "no [[loads.force]]"),
        _row("end moments", shell.moment is not None, "loads.moment", "no [[loads.moment]]"),
        _row("springs", any(elastic), springs, no_springs),
        _row("moving supports", supports_move(shell), "fix.move", "no support moves"),
    ]


def _of_contact(scene: Scene, model: Model) -> list[Row]:
    moves = scene.scene.task == "dynamics" or _vibrates(scene)
    inertia = f"inertia of the vertices, {weight(model.shell):.4g} kg; directors follow at every instant"
    still = f"task = {scene.scene.task!r}; the mass matrix is used to regularise and in eigenvalues only"
    return [
        ("contact", bool(model.obstacles), _contact(model)),
        ("self-contact", scene.contact.self_contact, _self_contact(scene, model)),
        ("friction", any(mu > 0.0 for _, mu in _frictions(scene, model)), _friction(scene, model)),
        ("nested levels", *_nested(scene, model)),
        _row("mass", moves, inertia, still),
    ]


def _vibrates(scene: Scene) -> bool:
    return scene.scene.task == "modes" and not scene.modes.buckling


def _modes(scene: Scene) -> str:
    """How modes are found."""
    spec = scene.modes
    what = "lowest load factors of buckling" if spec.buckling else "lowest natural frequencies"
    return (
        f"{spec.count} {what} about the equilibrium at load factor {spec.about:g}: SLEPc's Krylov-Schur, "
        "shift-and-invert by MUMPS LDL^T, counted by inertia; the equilibrium by "
    )


def supports_move(shell: Shell) -> bool:
    """Whether any does."""
    return bool(shell.motion.any()) or any(motion.moves for _, motion in shell.moves)


FACTORS = "LL^T by fronts on one rank, MUMPS LDL^T on several and where that fails"
SYSTEMS = "systems by CG or GMRES with ILU(0), by factors in steps where these do not converge"


def _by_levels(scene: Scene, model: Model, unknowns: int) -> bool:
    """Whether systems are solved by multigrid without being asked to (see solver.multigrid.with_levels)."""
    shell = model.shell
    contact = bool(model.obstacles) or scene.contact.self_contact
    stepped = scene.scene.task in ("statics", "modes") and scene.statics.control != "arc-length"
    return stepped and unknowns > LARGE and not unfit(contact, conservative(shell), shell.axes is not None)


def _solver(scene: Scene, model: Model, by_levels: bool) -> str:
    if scene.scene.task == "dynamics":
        if scene.dynamics.solver == "local-global":
            step = f"at most {scene.dynamics.iterations} local and global iterations"
            return f"{scene.dynamics.scheme}, steps of {scene.dynamics.time_step:g} s by {step}, one factor by CHOLMOD"
        step = "semismooth Newton" if model.obstacles or scene.contact.self_contact else "Newton"
        return f"{scene.dynamics.scheme}, steps of {scene.dynamics.time_step:g} s by {step}, {SYSTEMS}"
    if scene.scene.task == "inverse" and not scene.inverse.estimate:
        search = "Newton in the rest shape (MUMPS LU), inertia as certificate"
        then = {
            "adjoint": "the nearest stable shape by an interior point method",
            "tao": "adjoint method in TAO",
        }
        method = scene.inverse.method
        adjoint = f"; {then[method]} where the target is not stable" if method in then else ""
        further = {"panels": "; then flat panels in TAO", "constraint": "; then developable in TAO"}
        return f"{search}{adjoint}{further.get(str(scene.inverse.developable), '')}; two simulations as proof"
    search = _modes(scene) if scene.scene.task == "modes" else ""
    if scene.scene.task == "inverse":
        search = f"Gauss-Newton in {', '.join(scene.inverse.estimate)}, whose simulations are: "
    if scene.statics.control == "arc-length":
        branch = f", onto the branch at bifurcation {scene.statics.branch}" if scene.statics.branch else ""
        end = f"to load factor {scene.statics.max_load_factor:g}{branch}"
        return f"arc length with mixed Newton steps {end}, {FACTORS}"
    if not (model.obstacles or scene.contact.self_contact):
        systems = "CG with multigrid over coarser levels of the mesh" if by_levels else FACTORS
        return f"{search}Newton (mixed steps, then descent on the potential), {systems}"
    ways = "semismooth Newton (then augmented Lagrangian, then pseudo-time)"
    return f"{search}{ways}, {FACTORS}, LU where something slips"


def _nested(scene: Scene, model: Model) -> tuple[bool, str]:
    """Whether coarser levels of the mesh are solved first, and why (see solver.nested.pays)."""
    shell, options, statics = model.shell, Options(), scene.statics
    moves = supports_move(shell) or any(body.moves for body in model.obstacles)
    against = {
        f"task = {scene.scene.task!r}": scene.scene.task not in ("statics", "modes"),
        "statics.nested is false": not statics.nested,
        "control is arc-length": statics.control == "arc-length",
        "statics.load_steps is given": statics.load_steps is not None,
        "statics.load_factors is given": bool(statics.load_factors),
        "supports or obstacles move": moves,
        "there are springs, bands, ties or stiff joints": any(
            a is not None for a in (shell.springs, shell.bars, shell.welds)
        ),
        "layers are kept apart": scene.contact.self_contact,
        "loads have no potential": not conservative(shell),
        f"under {options.smallest} vertices": len(shell.points) <= options.smallest,
    }
    reason = next((reason for reason, holds in against.items() if holds), "")
    if reason:
        return False, reason
    count, levels = len(shell.points), []
    while count > options.smallest:
        count = round(options.ratio * count)
        levels.append(f"{count}")
    return True, f"of about {' and '.join(levels[::-1])} vertices, where a load step fails (statics.nested)"


def _contact(model: Model) -> str:
    if not model.obstacles:
        return "no [[obstacle]]"
    names = ", ".join(obstacle.name for obstacle in model.obstacles)
    return f"{names}, {model.offset:.4g} m from the mid-surface; reactions are multipliers of what touches, no unknowns"


def _obstacles(model: Model) -> list[str]:
    """How exact each obstacle's gap is, and where the shell starts from it."""
    lines = []
    for obstacle in model.obstacles:
        gap = obstacle.gap(model.shell.points, 0.0) - model.offset
        touching = int((gap <= 0.0).sum())
        start = f"{touching} vertices touch it at the start" if touching else f"starts {gap.min():.3g} m off"
        lines.append(f"obstacle  {obstacle.name}: {obstacle.about()}; {start}")
    return lines


def _self_contact(scene: Scene, model: Model) -> str:
    if not scene.contact.self_contact:
        return "contact.self_contact is false: layers may pass through each other"
    return (
        f"mid-surfaces keep {2.0 * model.offset:.4g} m: vertices with triangles, edges with edges; the matrix grows "
        "where layers touch, and no step carries one through another"
    )


def _frictions(scene: Scene, model: Model) -> list[tuple[str, float]]:
    """What the shell may touch, with Coulomb's coefficient."""
    itself = [("itself", scene.contact.self_friction)] if scene.contact.self_contact else []
    return [(o.name, o.friction) for o in model.obstacles] + itself


def _friction(scene: Scene, model: Model) -> str:
    found = _frictions(scene, model)
    return "friction " + ", ".join(f"{mu:g} on {name}" for name, mu in found) if found else "no [[obstacle]]"


def _repeats_cells(shell: Shell) -> bool:
    """Whether the rest shape is made of few shapes of triangles, as a grid is."""
    corner = shell.rest_points[shell.rest_triangles]
    length = np.sort(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2), axis=1)
    shapes = np.unique(np.round(length / np.median(length), 4), axis=0)
    return len(shapes) < REPEATED * len(length)


def _refined(scene: Scene, model: Model) -> str:
    """What refinement made the mesh of."""
    file, times = model.surface.coarsest, scene.shell.refine
    count = f"{len(file.points)} vertices, {len(file.triangles)} triangles"
    return f", {count}, refined {times} time{'s' * (times > 1)}" if times else ""


def _against_plate(shell: Shell) -> tuple[Stiffness, Stiffness] | None:
    """How the middle of a rest shape in one plane bends and stretches, None of others."""
    x, t = shell.rest_points - shell.rest_points.mean(axis=0), shell.rest_triangles
    _, _, axes = np.linalg.svd(x, full_matrices=False)
    x = x @ axes.T
    if np.abs(x[:, 2]).max() > PLANE * np.abs(x[:, 0]).max():
        return None
    middle = x[t].mean(axis=1)
    near = np.argsort(np.linalg.norm(middle - middle.mean(axis=0), axis=1), kind="stable")[:PATCH]
    used, triangles = np.unique(t[near], return_inverse=True)
    model, bending, material = shell.model.split("/")
    names = {"model": model, **({"bending": bending} if bending else {})}
    names |= {"material": material} if material else {}
    fabric = {name: getattr(shell, name)[near] for name in ("thickness", "young", "poisson")}
    mesh = FlatMesh(x[used], triangles.reshape(-1, 3), model=names, **fabric)
    return mesh.bending(), mesh.stretching()


def explain(scene: Scene, model: Model) -> str:
    """The text of `voile explain`."""
    rows = modelled(scene, model)
    kept = {name for name, keep, _ in rows if keep}
    width = max(len(name) for name, _, _ in rows)
    told = [f"  {'+' if keep else '-'} {name:<{width}}  {reason}" for name, keep, reason in rows]
    notes = [*model.notes, *(_advice(scene, model.shell) if "bending" in kept else ())]
    return "\n".join([*_head(scene, model, kept), "", *told, *(f"  note: {note}" for note in notes)])


def _head(scene: Scene, model: Model, kept: set[str]) -> list[str]:
    """Mesh, unknowns, solver, memory, obstacles."""
    shell = model.shell
    n, e = len(shell.points), len(shell.topology.edges)
    slaves = len(np.unique(shell.slave))
    displacement = 3 * (n - slaves) - int(shell.fixed.sum())
    angles = e - len(shell.clamped_edges) if "director angles" in kept else 0
    size = diagonal(shell.points)
    entries = (165 if angles else 85 if "bending" in kept else 32) * len(shell.triangles)
    by_levels = _by_levels(scene, model, displacement + angles)
    factor = 24 * (displacement + angles) * max(np.log2(max(displacement + angles, 2)), 1.0)
    # Of multigrid the levels' matrices: measured 5 to 6 kB per triangle in all for plates of 60,000 to 1,000,000.
    needs = entries * 75 if by_levels else entries * 28 + factor * 8
    return [
        f"{scene.scene.name or scene.path}: {scene.scene.task}",
        f"mesh      {n} vertices, {len(shell.triangles)} triangles, {e} edges, size {size:.4g} m",
        f"file      {model.surface.source}{_refined(scene, model)}",
        f"model     {shell.model}",
        f"unknowns  about {displacement + angles}: {displacement} displacements, {angles} director angles",
        f"solver    {_solver(scene, model, by_levels)}; PETSc options after --",
        f"blas      {blas.used()}",
        f"threads   {threads()} to factor, solve and assemble on one rank (OMP_NUM_THREADS)",
        f"memory    about {needs / 2**20:.0f} MiB for matrix and {'levels' if by_levels else 'factor'}",
        f"thickness over size {_slenderness(shell):.2e}",
        *_obstacles(model),
    ]


def _slenderness(shell: Shell) -> float:
    """Least thickness over the size."""
    return float(shell.thickness.min() / max(diagonal(shell.points), 1e-300))


def _advice(scene: Scene, shell: Shell) -> list[str]:
    """Where another model bends this mesh better."""
    spec, directors, notes = scene.shell, has_directors(shell.model), list[str]()
    if MODELS[spec.model].normals and not directors and _repeats_cells(shell):
        notes.append(
            f"bending = {spec.bending!r} need not converge on meshes of repeated cells such as this; 'tan' converges"
        )
    found = None if directors else _against_plate(shell)
    if found:
        bent, stretched = found
        (low, high), (least, most) = bent.of_cylinders(), bent.of_all()
        if least < 1.0 - PLATE or most > 1.0 + PLATE:
            notes.append(
                f"{spec.model} bends this mesh {low:.2f} to {high:.2f} times as stiffly to cylinders (by direction), "
                f"{least:.2f} to {most:.2f} times to any shape (domes, saddles), as the plate of its E, nu and h; "
                "model = 'koiter' with bending = 'tan' converges to that"
            )
        least, most = stretched.of_all()
        if least < 1.0 - PLATE or most > 1.0 + PLATE:
            notes.append(
                f"{spec.model} stretches this mesh {least:.2f} to {most:.2f} times as stiffly, by direction and "
                "shear, as its E, nu and h would; model = 'koiter' does so exactly"
            )
    if _slenderness(shell) ** 2 < STIFFNESS_RATIO:
        notes.append("bending stiffness is at round-off against stretching; consider model = 'membrane'")
    return notes
