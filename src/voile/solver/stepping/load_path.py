"""Quasi-static load paths: load steps around a cascade of methods, off unstable branches, to stable ends.

With contact and friction the order of the steps matters. A jump is then a step in which the shell moves far more than
supports and obstacles do and than the step before lets expect, or to an equilibrium that slip makes unstable: either
the step was too long and Newton's method fell on another branch, or the shell snaps. Motion along a branch goes to
zero with the load step, that of a snap does not: shorter steps tell them apart, and find where it snaps.
"""

from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from voile.problem.contact import contact_of, contact_report, passes_through
from voile.problem.problem import Problem
from voile.problem.rest import field_vector
from voile.problem.scales import slow_rate
from voile.problem.state import State, difference
from voile.solver.equilibrium import Solver
from voile.solver.methods.method import Method, Outcome
from voile.solver.path import (
    Arrays,
    Jump,
    LoadStep,
    Path,
    Pause,
    Progress,
    StaticsOptions,
    load_steps,
    tolerance,
)
from voile.solver.stability import NEUTRAL, contact_tangent, is_stable, reach, smallest_eigenpair
from voile.solver.stepping.control import StepControl
from voile.solver.stepping.predictor import edge_length, predict
from voile.solver.stepping.restart import packed_path, packed_state, unpacked_path, unpacked_state


@dataclass
class Options:
    """cuts: quartered load steps before all methods are tried; patient: the same where loads have no potential to
    descend on. far: edges of triangles; where supports or obstacles go further in a load step with contact, its
    equilibrium is predicted: over less, Newton's method does as well, and decides by itself what sticks. jump: times
    the motion to be expected that a step may make; doubtful: the same where no short step led on, for a buckled shell
    that is bent on moves ever less. notable: sizes of the shell; a smaller motion is none. nearby: sizes; a gap at
    which an obstacle touches. rounds: solves at one load until the tolerance, taken from the state, has settled."""

    cuts: int = 2
    patient: int = 8
    far: float = 0.1
    jump: float = 5.0
    doubtful: float = 2.0
    notable: float = 0.01
    nearby: float = 1e-3
    rounds: int = 6


class LoadPath:
    """Follows the load of a problem from 0 to 1 from the unknowns y; `path` is told of everything.

    Loads act in steps of 1/load_steps. Where the methods that follow a branch fail the step is cut; where cuts do not
    help (buckling, slip that runs away) all methods take it; where that fails and nothing moves, the full load is
    tried at once.
    """

    def __init__(self, problem: Problem, y: PETSc.Vec, options: StaticsOptions, path: Path):
        self.problem, self.y, self.asked, self.path = problem, y, options, path
        self.options = Options()
        self.solver = Solver(problem, options, path.counts)
        contact = problem.contact
        cuts = self.options.cuts if problem.conservative else self.options.patient
        if contact:
            cuts = self.options.cuts if problem.supported else 0  # a smaller load holds nothing better
        elif self.solver.nests:
            cuts = 1  # its descents start from coarser levels, not from the last load step
        marks = options.load_factors or (1.0,)
        first = 1.0 / load_steps(problem, options)
        if options.load_factors:
            first = float(np.diff((0.0, *marks)).max())
        self.control = StepControl(first, cuts, cap=0.0 if contact else 1.0, marks=marks)
        self.edge = edge_length(problem) / problem.size()
        self.moving = problem.moves or bool(contact and contact.moves)
        self.went: PETSc.Vec | None = None  # the last load step's motion, over that much of the load
        self.over = 0.0
        self.refused: dict[float, Outcome] = {}  # by where load steps from the last equilibrium were to end

    def follow(
        self, on_step: Progress | None, on_pause: Pause | None = None, found: Arrays | None = None
    ) -> None:
        """Calls on_step after each converged step, then on_pause; found: what that was given, to go on from."""
        y, control, path = self.y, self.control, self.path
        if found:
            self._go_on(found)
        else:
            self.problem = self.problem.at(0.0)
            self._begin()
        while control.factor < 1.0:
            if path.attempts >= self.asked.max_steps:
                path.reason = (
                    f"max_steps = {self.asked.max_steps} load steps ended at load factor {control.factor:g}"
                )
                return
            path.attempts += 1
            start = self.problem.save(y)
            self.problem = problem = self.problem.at(control.target)
            self._guess()
            done, outcome = self._solve(self._methods())
            problem.unknowns_of(start).copy(path.state)
            if done is None:
                path.blurred = self._blurred(outcome)
                outcome = outcome if outcome.reason else self.refused.get(control.target, outcome)
                self.refused[control.target] = outcome
                problem.restore(y, start)  # from the guess, too, which went as far as the step
                self.problem = problem.at(control.factor)
                if not self._retry(outcome):
                    path.reason = f"{outcome.reason}; at load factor {problem.time:g}"
                    return
                continue
            done = self._accept(done, start, outcome.watched)
            if done is None:
                continue
            y.copy(path.state)
            path.blurred = None
            self.refused.clear()
            path.steps.append(done)
            if on_step:
                on_step(done, y)
            if control.factor < 1.0:
                self._begin()  # not at the end: what slipped on the way there tells what may slip on
            if on_pause:
                on_pause(self._packed)
        path.converged, path.reason = True, path.steps[-1].reason

    def settle_unloaded(self) -> None:
        """Brings a shell that does not start in equilibrium (bands, bars, flat panels) to one before loads without a
        potential act: no load step is so short that less acts there, and nothing descends then."""
        if self.problem.conservative:
            return
        unloaded, force = self.problem.unloaded(), self.problem.create_vector()
        wanted = self.asked.tolerance * self.problem.load_norm(self.y)
        unloaded.residual(self.y, force)
        if wanted < force.norm():
            self.solver.solve(unloaded, self.y, wanted, self.solver.all)

    def _blurred(self, outcome: Outcome) -> tuple[LoadStep, State] | None:
        """Of a failure: the step that round-off may have kept from the tolerance, and its state."""
        problem, state = self.problem, outcome.blurred
        if state is None:
            return None
        y = problem.unknowns_of(state)
        figures = outcome.norm, tolerance(problem, y, self.asked), problem.energies(y)
        return LoadStep(problem.time, 0, *figures, method=outcome.method, reason=outcome.reason), state

    def _packed(self) -> Arrays:
        """What the path goes on from, between two steps."""
        found = packed_state(self.problem, self.problem.save(self.y))
        if self.went is not None:
            found |= {"went": self.went.array_r.copy(), "over": np.array(self.over)}
        return found | packed_path(self.path, control=vars(self.control) | {"options": None})

    def _go_on(self, found: Arrays) -> None:
        """Where `_packed` was called."""
        control = unpacked_path(found, self.path)["control"]
        vars(self.control).update({name: value for name, value in control.items() if name != "options"})
        self.problem = self.problem.at(self.control.factor)
        self.problem.restore(self.y, unpacked_state(self.problem, found, self.control.factor))
        self.y.copy(self.path.state)
        if "went" in found:
            self.went, self.over = self.problem.create_vector(), float(found["over"])
            self.went.array[:] = found["went"]

    def _watch(self, start: State) -> None:
        """Remembers a jump of a step without contact."""
        control, problem = self.control, self.problem
        length, before = control.target - control.factor, control.rate
        moved = problem.largest_motion(difference(self.y, problem.unknowns_of(start)))
        control.rate = moved / length
        lost = control.last_resort and self.path.steps and not self.solver.nests
        allowed = self.options.doubtful if lost else self.options.jump
        self._note_jump(moved, max(before * length, self.options.notable / allowed), allowed)

    def _note_jump(self, moved: float, expected: float, allowed: float) -> None:
        """Remembers a step that moved the shell so many sizes, if that is a jump: more than `allowed` times what was
        expected."""
        if allowed * expected < moved:
            jump = Jump(self.control.factor, self.control.target, moved, moved / expected)
            self.path.jumps.append(jump)

    def _begin(self) -> None:
        """Slip is measured from here on."""
        if self.problem.contact:
            self.problem.contact.begin(self.problem.positions(self.y), self.problem.time)

    def _retry(self, outcome: Outcome) -> bool:
        """Chooses the next try after a failure; False where there is none."""
        problem, control = self.problem, self.control
        if problem.contact and control.last_resort and (outcome.gone or not self.moving):
            if control.nominal == 1.0 or outcome.gone:
                return False
            control.whole()
            return True
        control.failed()
        if not problem.contact and control.cuts == control.most and not problem.moves:
            control.whole()
        return not control.exhausted

    # ---- one load step ----

    def _methods(self) -> Method:
        """Those for the next try; as the last resort every one that has not failed on the same way."""
        if not self.control.last_resort:
            return self.solver.near
        return self.solver.rest if self.control.target in self.refused else self.solver.all

    def _solve(self, by: Method, then: Method | None = None) -> tuple[LoadStep | None, Outcome]:
        """The equilibrium at the problem's load factor; no step where there is none. by: a method of the solver,
        to be made sharper by `then`, or itself."""
        problem, solver, y = self.problem, self.solver, self.y
        before, method, watched = solver.work.counts.iterations, "", False
        for _ in range(self.options.rounds):  # loads that follow, and reactions, are others at the end
            wanted = tolerance(problem, y, self.asked)
            outcome = solver.solve(problem, y, wanted, (method and then) or by)
            self.path.seconds |= {"linear_solve": solver.work.counts.seconds}
            if problem.contact:
                self.path.seconds |= {"contact": problem.contact.seconds}
            if not outcome.converged:
                return None, outcome
            watched = outcome.watched if not method else watched
            method = method or outcome.method  # the first one found it, later ones only sharpen it
            if outcome.reason or outcome.norm <= tolerance(problem, y, self.asked):  # a reason: to round-off
                break
        else:
            return None, Outcome(False, method, "the tolerance, taken from the state, does not settle")
        done = LoadStep(
            problem.time,
            solver.work.counts.iterations - before,
            outcome.norm,
            wanted,
            problem.energies(y),
            outcome.negative,
            contact_report(problem, y) if problem.contact else None,
            method,
            outcome.reason or "residual below tolerance",
        )
        return done, replace(outcome, watched=watched)

    def _guess(self) -> None:
        """Moves the shell towards the equilibrium at the problem's load factor, where contact lets tell."""
        contact = self.problem.contact
        if contact and contact.moves and not self.problem.held:
            self._carry()
        elif contact and self._driven() > self.options.far * self.edge:
            self._predict()

    def _accept(self, done: LoadStep, start: State, watched: bool) -> LoadStep | None:
        """A converged step, at the end of the path brought to a stable state; None where it is taken back."""
        problem, control = self.problem, self.control
        if problem.contact:
            judged = self._judge(done, start, watched)
            if judged:
                self.went, self.over = (
                    difference(self.y, problem.unknowns_of(start)),
                    problem.time - start.time,
                )
            return judged
        if control.target == 1.0 and self.asked.stability:
            done = self._settle(done)
        self._watch(start)
        control.advanced(done.iterations)
        return done

    def _judge(self, done: LoadStep, start: State, watched: bool) -> LoadStep | None:
        """A converged step with contact: found again where it led through an obstacle, if it is not `watched` already,
        taken back (None) where it jumped off its branch, brought to a stable end."""
        problem, y, control = self.problem, self.y, self.control
        assert start.history is not None
        began = start.history.reference
        if (
            (problem.held or self.moving)
            and not watched
            and passes_through(problem, began, control.factor, problem.positions(y))
        ):
            again = self._around(start)
            done = again or replace(done, method=f"{done.method}, through an obstacle")
        moved = problem.largest_motion(difference(y, problem.unknowns_of(start)))
        stable = not self.asked.stability or done.negative == 0 or is_stable(self.solver.work, problem, y)
        jumps = moved > self.options.jump * self._expected() or (control.stable and not stable)
        if jumps and not (control.shortest or watched):
            problem.restore(y, start)
            self.problem = problem.at(control.factor)
            control.take_back()
            return None
        if self.asked.stability and (jumps or not stable or control.target == 1.0):
            done, stable = self._settle_contact(done)
        if jumps and problem.supported:
            done.method = f"snap by {done.method}"
            self._note_jump(moved, self._expected(), self.options.jump)
        control.done(done.iterations, moved, jumps)
        control.stable = stable
        return done

    def _around(self, start: State) -> LoadStep | None:
        """The load step again in pseudo-time, in steps that do not lead through obstacles, from where it began; None,
        and y as it is, where that has no end."""
        problem, y = self.problem, self.y
        ended = problem.save(y)
        problem.restore(y, start)
        done, _ = self._solve(self.solver.watched, self.solver.all)
        if done is None:
            problem.restore(y, ended)
        return done

    def _carry(self) -> None:
        """Moves a shell that nothing holds with the obstacle that carries it, or else is next to most of it, over
        the next load step, where there is friction: it starts where it sticks, however far that is."""
        problem, y, control = self.problem, self.y, self.control
        contact, x = contact_of(problem), problem.positions(y)
        pressing = np.array(
            [normal[problem.own].sum() for normal in contact.history.normal[: len(contact.obstacles)]]
        )
        limit = self.options.nearby * problem.size()
        near = [contact.gap(k, x, control.factor) <= limit for k in range(len(pressing))]
        beside = np.array([np.count_nonzero(part[problem.own]) for part in near], dtype=float)
        pressing, beside = problem.comm.allreduce(np.array([pressing, beside]))
        most = int(np.argmax(pressing if pressing.any() else beside))
        if (pressing[most] or beside[most]) and contact.obstacles[most].friction > 0.0:
            there = contact.obstacles[most].carry(x, control.factor, control.target)
            y.axpy(1.0, field_vector(problem, there - x))

    def _predict(self) -> None:
        """Moves the shell towards the equilibrium at the problem's load factor, no further than by what a jump is over
        the supports' own motion: a step that fell on an obstacle is not made again."""
        control, went, most = self.control, None, self.options.jump * self._driven()
        if self.went is not None:
            went = self.went * ((control.target - control.factor) / self.over)
        predict(self.solver.work, self.problem, self.y, control.factor, most, went)

    def _expected(self) -> float:
        """Motion in sizes of the shell that the next load step should make: that of the step before, of supports, or
        of obstacles beside the shell."""
        control = self.control
        before = control.rate * (control.target - control.factor)
        return max(before, self._driven(), self.options.notable / self.options.jump)

    def _driven(self) -> float:
        """That of supports and obstacles alone."""
        problem, control = self.problem, self.control
        start, end, contact = control.factor, control.target, contact_of(problem)
        x = contact.history.reference[problem.own]
        paths = [problem.part.supports.between(start, end)[: contact.history.reference.size]]
        paths += [(o.carry(x, start, end) - x).ravel() for o in contact.obstacles]
        return problem.in_sizes(np.concatenate(paths))

    # ---- stable ends ----

    def _settle_contact(self, done: LoadStep) -> tuple[LoadStep, bool]:
        """Tests a state on the contacts' tangent space; leaves a saddle, which slip may have hidden so far. The step,
        and whether it is stable, which the path says of its end."""
        problem, y, work = self.problem, self.y, self.solver.work
        stable, value = done.negative == 0 or is_stable(work, problem, y), None
        if not stable and self.solver.leave_saddle(problem, y, done.tolerance):
            self._begin()
            again, _ = self._solve(self.solver.near)
            done, stable = again or done, is_stable(work, problem, y)
        if problem.time == 1.0:
            if self.asked.eigenvalue or not stable:
                scale = 0.0 if stable else slow_rate(problem)
                matrix = contact_tangent(problem, y, work.matrix)
                value, _ = smallest_eigenpair(problem, matrix, scale, work.counts)
                stable = value >= -NEUTRAL * slow_rate(problem)  # a spin about a single contact has none
            self.path.stable, self.path.smallest_eigenvalue = stable, value
        return done, stable

    def _settle(self, done: LoadStep) -> LoadStep:
        """Tests the end of a path without contact; where it is a saddle, leaves it along its softest mode and
        minimises again."""
        problem, y, path, work = self.problem, self.y, self.path, self.solver.work
        for further in range(6):
            path.stable = done.negative == 0 or is_stable(work, problem, y)
            if path.stable or further == 5:
                break
            value, mode = smallest_eigenpair(problem, work.matrix, slow_rate(problem), work.counts)
            path.smallest_eigenvalue = value
            if not value < 0.0:
                break
            before = problem.save(y)
            y.axpy(reach(self.solver.perturbation, further), mode)
            again, _ = self._solve(self.solver.all)
            if again is None:
                problem.restore(y, before)
                continue
            done = again
        if path.stable:
            path.smallest_eigenvalue = None
        if path.stable and self.asked.eigenvalue:
            problem.tangent(y, work.matrix)
            path.smallest_eigenvalue, _ = smallest_eigenpair(problem, work.matrix, 0.0, work.counts)
        return done
