"""What `voile run` does for each task: from a model to result files. Used by cli only."""

import platform
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

NO_CONTACT = {
    "active": 0,
    "stick": 0,
    "slip": 0,
    "max_penetration": 0.0,
    "friction_error": 0.0,
    "self_contacts": 0,
}


def run_statics(scene, model, folder: Path, comm, progress: "Progress", began: float) -> str:
    """Solves a statics scene (model: rank 0's) and writes its results to `folder`; the reason why it did not converge,
    or empty."""
    from voile.problem.contact import attach, shell_layers
    from voile.problem.discrete import Problem
    from voile.results import ResultWriter
    from voile.solver.path import StaticsOptions
    from voile.solver.sewing import sew
    from voile.solver.statics import solve_statics
    from voile.wiring import static_mesh

    s = scene.statics
    options = StaticsOptions(
        s.load_steps, s.max_steps, s.perturbation, s.tolerance, s.stability, s.eigenvalue
    )
    shell = sew(model.shell if model else None, comm)
    problem = Problem(shell, comm)
    layers = None
    if shell is not None and scene.contact.self_contact:
        layers = shell_layers(shell, model.offset, scene.contact.self_friction)
    attach(problem, *comm.bcast((model.obstacles, model.offset, layers) if model else None))
    mesh = static_mesh(model, shell, problem.directors) if shell is not None else None
    writing, reached = 0.0, 0
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=_versions()
    ) as writer:

        def write(factor: float, y, scalars: dict[str, float]) -> None:
            nonlocal writing
            start = time.perf_counter()
            writer.write_step(factor, scalars=scalars, **_rows(problem, y))
            writing += time.perf_counter() - start

        def keep(step, y) -> None:
            write(step.factor, y, {"residual": step.residual, "converged": 1.0})

        def on_step(step, y) -> None:
            nonlocal reached
            progress.step(step)
            reached += 1
            if step.factor >= 1.0 or reached % scene.output.every == 0:
                keep(step, y)

        path = solve_statics(problem, options, on_step=on_step, monitor=progress.iteration)
        if not path.converged and not reached:
            write(0.0, path.state, {"residual": float("inf"), "converged": 0.0})
        elif not path.converged and reached % scene.output.every:
            keep(path.steps[-1], path.state)  # the last good one
    seconds = {**problem.seconds, **path.seconds, "input_output": writing}
    _summarise(scene, model, problem, path, folder, seconds, began)
    return "" if path.converged else path.reason


def run_inverse(scene, model, folder: Path, comm, progress: "Progress", began: float) -> str:
    """As `run_statics` for the rest shape of an inverse scene, whose mesh is the target."""
    if scene.inverse.estimate:
        return _run_estimation(scene, model, folder, comm, progress, began)
    from voile.inverse.solve import InverseOptions, inverse_report, solve_inverse
    from voile.problem.discrete import Problem
    from voile.solver.sewing import sew

    spec = scene.inverse
    shell = sew(_target_shell(model), comm) if model else sew(None, comm)
    problem = Problem(shell, comm)
    bodies, offset = comm.bcast((model.obstacles, model.offset) if model else None)
    options = InverseOptions(
        spec.friction,
        spec.contact_tolerance,
        spec.tolerance,
        spec.method,
        spec.regularisation,
        spec.iterations,
    )
    result = solve_inverse(problem, shell, bodies, offset, options, progress.fraction, progress.optimisation)
    start = time.perf_counter()
    _write_rest(scene, model, shell, folder, result, comm)
    report = inverse_report(result)
    seconds = {**problem.seconds, **result.seconds, "input_output": time.perf_counter() - start}
    _summarise(
        scene, model, problem, result.simulation.path, folder, seconds, began, result=result, inverse=report
    )
    progress.line(
        f"sag {report['sag']:.2e} of the size, {report['sag_disturbed']:.2e} after a disturbance; "
        f"{result.reason}"
    )
    return "" if result.converged else result.reason


def _run_estimation(scene, model, folder: Path, comm, progress: "Progress", began: float) -> str:
    """Parameters of the shell from its observed shape, the scene's mesh, and its known rest shape."""
    from voile.inverse.estimate import Estimation
    from voile.problem.discrete import Problem
    from voile.results import ResultWriter
    from voile.solver.path import Path as LoadPath
    from voile.solver.sewing import sew
    from voile.wiring import static_mesh

    shell = sew(model.shell if model else None, comm)
    problem = Problem(shell, comm)
    estimation = Estimation(problem, scene.inverse.estimate, scene.inverse.tolerance)
    found = estimation.solve(progress.estimate)
    mesh = static_mesh(model, shell, problem.directors) if shell is not None else None
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=_versions()
    ) as writer:
        writer.write_step(1.0, scalars={"misfit": found.misfit}, **_rows(problem, found.state))
    report = {
        "estimate": {
            name: {"value": value, "deviation": found.deviations[name]}
            for name, value in found.values.items()
        },
        "misfit": found.misfit,
        "forward_solves": found.forward_solves,
    }
    for name, value in found.values.items():
        progress.line(f"{name} = {value:.6g}, standard deviation {found.deviations[name]:.2g}")
    path = LoadPath(found.state, converged=True, reason="estimate settled", stable=True)
    _summarise(scene, model, problem, path, folder, dict(problem.seconds), began, inverse=report)
    return ""


def _target_shell(model):
    """The model's shell with the target as rest shape: where the search starts."""
    s = model.shell
    return replace(s, rest_points=s.points, rest_triangles=s.triangles, flat=False)


def _write_rest(scene, model, shell, folder: Path, result, comm) -> None:
    """result.vtkhdf (the target, then the simulation from it, with the rest shape found) and rest.obj."""
    import numpy as np

    from voile.mesh import METRES, write_obj
    from voile.results import ResultWriter
    from voile.wiring import static_mesh

    problem, target = result.target.problem, result.target
    part, own = problem.part, problem.part.owned_vertices
    rest = _gathered(problem, target.x + problem.motion(result.rest))
    mode = _gathered(problem, problem.motion(result.mode))
    mesh = None
    if comm.rank == 0:
        mesh = static_mesh(model, replace(shell, rest_points=rest), problem.directors)
        mesh = replace(mesh, point_data={**mesh.point_data, "mode": mode})
        s = model.surface
        write_obj(
            folder / "rest.obj", rest, shell.triangles, groups=(s.group, s.group_names), stitches=s.stitches,
            comment=f"{METRES}\nrest shape of {scene.scene.name or scene.path}",
        )  # fmt: skip
    with ResultWriter(
        folder / "result.vtkhdf", comm, mesh=mesh, scene_text=scene.text, versions=_versions()
    ) as writer:
        at_target = _rows(problem, target.rest.state(result.rest))
        fields = {name: values[own] for name, values in target.fields().items()}
        if fields:
            at_target |= {"point_data": fields}
            at_target["placements"] = np.array([body.motion.matrix(0.0) for body in target.obstacles])
        writer.write_step(0.0, scalars={"residual": result.residual, "converged": 1.0}, **at_target)
        simulated, path = at_target, result.simulation.path
        with target.obstructed():
            simulated = _rows(problem, path.state)
        writer.write_step(1.0, scalars={"residual": 0.0, "converged": float(path.converged)}, **simulated)
    assert part is problem.part


def _gathered(problem, rows):
    """(n, ...) values in the input's order on rank 0 of each rank's local vertices; None elsewhere."""
    import numpy as np

    own = problem.part.owned_vertices
    pieces = problem.comm.gather((problem.part.vertex[own], rows[own]))
    if pieces is None:
        return None
    total = np.zeros((sum(len(index) for index, _ in pieces), *rows.shape[1:]))
    for index, values in pieces:
        total[index] = values
    return total


def _rows(problem, y) -> dict:
    """What the result file takes of a state: this rank's rows and the obstacles' placements."""
    import numpy as np

    from voile.problem.contact import contact_fields

    part, (u, phi) = problem.part, problem.local(y)
    own = part.owned_vertices
    rows = {"points": (part.points + u.reshape(-1, 3))[own], "point_index": part.vertex[own]}
    if problem.directors:
        rows |= {"edge_angles": phi[part.owned_edges], "edge_index": part.edge[part.owned_edges]}
    if problem.contact:
        rows["point_data"] = {name: values[own] for name, values in contact_fields(problem, y).items()}
        bodies = problem.contact.obstacles
        rows["placements"] = np.array([body.motion.matrix(problem.load_factor) for body in bodies])
    return rows


def _summarise(
    scene,
    model,
    problem,
    path,
    folder: Path,
    seconds: dict[str, float],
    began: float,
    *,
    result=None,
    inverse=None,
) -> None:
    """summary.json of a run whose (last) simulation is `path`; for an inverse task with its result and figures."""
    from voile.explain import modelled
    from voile.results import write_summary

    if model is None:
        return
    last = path.steps[-1] if path.steps else None
    summary = {
        "converged": path.converged if result is None else result.converged,
        "reason": path.reason if result is None else result.reason,
        "task": scene.scene.task,
        "name": scene.scene.name,
        "dofs": problem.unknowns,
        "steps": len(path.steps),
        "load_factor": last.factor if last else 0.0,
        "newton_iterations": path.newton_iterations,
        "residual_norm": last.residual if last else None,
        "residual_tolerance": last.tolerance if last else None,
        "energy": last.energies if last else {},
        "contact": (last.contact if last else None) or NO_CONTACT,
        "ways": [step.way for step in path.steps],
        "stable": path.stable if result is None else result.stable and path.stable,
        "smallest_eigenvalue": path.smallest_eigenvalue if result is None else result.eigenvalue,
        "wall_time_s": {**seconds, "total": time.perf_counter() - began},
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "ranks": problem.comm.size,
        "versions": _versions(),
        "modelled": [name for name, keep, _ in modelled(scene, model) if keep],
        "notes": model.notes,
    }
    if inverse is not None:
        summary["inverse"] = inverse
    write_summary(folder / "summary.json", summary)


def _versions() -> dict[str, str]:
    """What a result is computed with."""
    import numpy
    from petsc4py import PETSc

    import voile

    return {
        "voile": voile.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "numpy": numpy.__version__,
        "python": platform.python_version(),
    }


class Progress:
    """Live on a terminal, plain lines (at most one every few seconds between steps) elsewhere."""

    QUIET = 5.0  # s between lines of a batch log

    def __init__(self, comm):
        self.quiet = comm.rank != 0
        self.live = sys.stdout.isatty() and comm.size == 1  # mpirun lends its ranks a terminal
        self.began = self.last = time.perf_counter()

    def line(self, text: str) -> None:
        """A line that stays."""
        if not self.quiet:
            print(("\r\033[K" if self.live else "") + text, flush=True)

    def iteration(self, factor: float, iteration: int, residual: float) -> None:
        """One Newton iteration at a load factor."""
        now = time.perf_counter()
        if self.quiet or (not self.live and now - self.last < self.QUIET):
            return
        self.last = now
        text = (
            f"load {factor:.4f}  Newton {iteration:3d}  residual {residual:.2e} N  {now - self.began:.1f} s"
        )
        print(f"\r\033[K{text}" if self.live else f"  ... {text}", end="" if self.live else "\n", flush=True)

    def fraction(self, step) -> None:
        """One step of the rest shape's continuation."""
        self.line(
            f"load {step.fraction:.4f}  rest shape in {step.iterations} iterations  residual {step.residual:.2e} N  "
            f"{step.negative} negative eigenvalues  {time.perf_counter() - self.began:.1f} s"
        )

    def optimisation(self, step) -> None:
        """One iteration of the adjoint method."""
        self.line(
            f"adjoint {step.iteration:3d}  objective {step.objective:.3e}  gradient {step.gradient:.2e}  "
            f"sag {step.sag:.2e}  {time.perf_counter() - self.began:.1f} s"
        )

    def estimate(self, iteration: int, misfit: float, values: dict[str, float]) -> None:
        """One iteration of an estimation."""
        shown = ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
        self.line(
            f"estimate {iteration:3d}  misfit {misfit:.3e} m  {shown}  {time.perf_counter() - self.began:.1f} s"
        )

    def step(self, step) -> None:
        """One converged load step."""
        energy = sum(step.energies.values())
        self.line(
            f"load {step.factor:.4f}  Newton {step.iterations:3d}  residual {step.residual:.2e} N "
            f"(<= {step.tolerance:.2e})  energy {energy:.6e} J  {_touching(step)}"
            f"{time.perf_counter() - self.began:.1f} s"
        )


def _touching(step) -> str:
    """What a step's contact is, for a line of progress; empty without."""
    c = step.contact
    return f"contact {c['active']} ({c['slip']} slip, {step.way})  " if c else ""
