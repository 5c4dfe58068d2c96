"""task = inverse: the rest shape, or flat panels, that make the mesh an equilibrium; or parameters (estimate.py)."""

import time
from dataclasses import replace
from typing import Any

from voile.errors import on_root
from voile.inverse.result import InverseResult, inverse_report
from voile.inverse.solve import InverseOptions
from voile.problem.shell import Shell
from voile.tasks.estimate import estimate
from voile.tasks.patterns import check_wishes
from voile.tasks.rest import find_panels, find_surface, write_result
from voile.tasks.run import Run
from voile.tasks.statics import options_of

LOOSE = 1e-3  # sizes: a sag of panels that their seams may be to blame for
# Strain of a rest shape laid flat that a user should know of: a collar of 2e-5 cut so hangs 8e-5 sizes off, a bent
# sleeve of 0.12 hangs 0.22 off.
STRAINED = 0.01


def run(job: Run) -> str:
    """Solves an inverse scene, whose mesh is the target, and writes its results; the reason why it did not converge, or
    empty."""
    spec = job.scene.inverse
    if spec.estimate:
        return estimate(job)
    shell = job.sewn(_target_shell(job))
    on_root(job.comm, lambda: check_wishes(job.model, shell, job.scene) if job.model else None)
    options = InverseOptions(
        spec.friction,
        spec.contact_tolerance,
        spec.tolerance,
        spec.method,
        spec.margin,
        spec.regularisation,
        spec.iterations,
        developable=spec.developable == "constraint",
        max_seconds=spec.max_seconds,
        statics=options_of(job.scene),
    )
    start = time.perf_counter()
    find = find_panels if spec.developable == "panels" else find_surface
    result, flat, pattern = find(job, shell, options)
    report = inverse_report(result) | {"pattern": pattern}
    _note(job, result, report)
    write_result(job, shell, result, flat)
    rest = time.perf_counter() - start - sum(result.seconds.values())
    job.summarise(
        result.target.problem,
        result.simulation.path,
        {**result.seconds, "linear_solve": result.target.counts.seconds, "input_output": rest},
        converged=result.converged,
        reason=result.reason,
        stable=result.stable and result.simulation.path.stable,
        smallest_eigenvalue=result.eigenvalue,
        inverse=report,
    )
    if not (result.nearest and result.nearest.timed_out):  # one that time ended may go on
        job.restarts.clear()
    job.progress.line(f"{_sags(report)}; {result.reason}")
    return "" if result.converged else result.reason


def _target_shell(job: Run) -> Shell | None:
    """The model's shell with the target as rest shape: where the search starts."""
    if job.model is None:
        return None
    s = job.model.shell
    return replace(s, rest_points=s.points, rest_triangles=s.triangles, flat=False)


def _note(job: Run, result: InverseResult, report: dict[str, Any]) -> None:
    """What a user should know of the result."""
    spec = job.scene.inverse
    if result.tolerance > spec.tolerance:
        job.note(
            f"inverse.tolerance: double precision holds the balance at the target to {result.residual:.1e} N, "
            f"{result.tolerance:.1e} of the loads; simulations are asked for no more"
        )
    if result.nearest and result.held and result.held.stable and not result.stays:
        job.tell(
            f"the shape found is {result.nearest.sag:.2g} sizes from the target, but cloth let go in the target ends "
            f"{result.simulation.sag:.2g} sizes from it: it must be put into that shape, step 0.5 of the result"
        )
    if result.hovers:
        sunk, hover = report["reactions"]["gaps"]
        job.note(
            f"what bears in the target lies {sunk:.2g} to {hover:.2g} m off what it touches: simulations here keep the "
            "gaps, a scene of statics closes them, as that of sag_closed does"
        )
    pattern = report["pattern"] or {}
    if "none" in pattern:
        job.tell(f"no sewing pattern: {pattern['none']}")
    elif not spec.developable and pattern.get("distortion", 0.0) > STRAINED:
        job.tell(
            f"the pattern is the rest shape laid flat, which strains it by up to {pattern['distortion']:.1%}: sag is "
            "that of the rest shape, not of cloth cut so; more groups or inverse.seams strain it less, "
            'inverse.developable = "panels" finds cloth that can be cut'
        )
    loose = spec.developable == "panels" and not job.scene.shell.seam_bending
    if loose and (report["sag"] or 1.0) > LOOSE:
        job.note(
            "shell.seam_bending = false: the panels turn freely at their seams; true lets seams bend like the cloth, "
            "and panels hang nearer to the target"
        )


def _sags(report: dict[str, Any]) -> str:
    """How far simulations sag, for the last line of the progress."""
    sag, disturbed = (
        "none" if report[name] is None else f"{report[name]:.2e} of the size"
        for name in ("sag", "sag_disturbed")
    )
    after = f"{disturbed} after a disturbance" if report["disturbance"] else "nothing is free to be disturbed"
    return f"sag {sag}, {after}"
