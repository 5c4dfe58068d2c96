"""What all tasks share: rows of a state for the result file, values in the input's order, the summary."""

import platform
import resource
import time
from dataclasses import asdict
from pathlib import Path

NO_CONTACT = {"active": 0, "stick": 0, "slip": 0, "max_penetration": 0.0, "friction_error": 0.0}


def rows(problem, y) -> dict:
    """What the result file takes of a state: this rank's rows and the obstacles' placements."""
    import numpy as np

    from voile.problem.contact import contact_fields

    part, (u, phi) = problem.part, problem.local(y)
    own = part.owned_vertices
    values = {"points": (part.points + u.reshape(-1, 3))[own], "point_index": part.vertex[own]}
    if problem.directors:
        values |= {"edge_angles": phi[part.owned_edges], "edge_index": part.edge[part.owned_edges]}
    if problem.contact:
        values["point_data"] = {name: values[own] for name, values in contact_fields(problem, y).items()}
        bodies = problem.contact.obstacles
        values["placements"] = np.array([body.motion.matrix(problem.load_factor) for body in bodies])
    return values


def find_layers(scene, model, shell, comm):
    """The layers of a sewn shell (rank 0's) that are in each other's way, on all ranks; None where the scene lets them
    pass. Adds a note on those that are not kept apart."""
    from voile.problem.contact import shell_layers

    if not scene.contact.self_contact:
        return None
    layers = None
    if shell is not None:
        layers = shell_layers(shell, model.offset, scene.contact.self_friction)
        if layers.caught:
            model.notes.append(
                f"contact.self_contact: {layers.caught} pairs of vertices start nearer than the seams gape, a layer "
                "caught between: they are not kept apart"
            )
    return comm.bcast(layers)


def summarise(
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
    from voile.results import write_summary

    if model is None:
        return
    last = path.steps[-1] if path.steps else None
    summary = {
        "converged": path.converged if result is None else result.converged,
        "reason": path.reason if result is None else result.reason,
        **_about(scene, model),
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
    }
    if inverse is not None:
        summary["inverse"] = inverse
    write_summary(folder / "summary.json", summary)


def summarise_refusal(scene, model, folder: Path, reason: str) -> None:
    """summary.json of a run that ended before anything was in equilibrium."""
    from voile.results import write_summary

    if model is not None:
        write_summary(folder / "summary.json", {"converged": False, "reason": reason, **_about(scene, model)})


def _about(scene, model) -> dict:
    """What every summary tells of its run."""
    from voile import blas
    from voile.explain import modelled
    from voile.petsc_options import unused_options

    return {
        "task": scene.scene.task,
        "name": scene.scene.name,
        "versions": versions(),
        "blas": asdict(blas.used()),
        "unused_options": unused_options(),
        "modelled": [name for name, keep, _ in modelled(scene, model) if keep],
        "notes": model.notes,
    }


def versions() -> dict[str, str]:
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
