"""Discrete frictional contact problems u = W r + q with Coulomb's law; see src/cpp/friction.hpp for the method."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from voile import _friction
from voile.arrays import Reals
from voile.contact.law import check_problem, friction_error
from voile.errors import InputError, NotConverged

METHOD = "proximal-point semismooth Newton"


@dataclass
class FrictionInfo:
    """How a problem was solved. error: friction_error; iterations: Newton steps; factorisations: of their matrices;
    proximal_steps: regularised problems; history: error at the start and after every Newton step."""

    error: float
    iterations: int
    factorisations: int
    proximal_steps: int
    method: str
    history: Reals


class FrictionNotConverged(NotConverged):
    """Carries the best reactions found, `reaction` (3c,), and their `info`."""

    def __init__(self, message: str, reaction: Reals, info: FrictionInfo):
        super().__init__(message)
        self.reaction, self.info = reaction, info


def solve_friction(
    W: Any, q: Any, mu: Any, tol: float = 1e-8, max_iterations: int = 20_000
) -> tuple[Reals, FrictionInfo]:
    """Reactions (3c,) of c contacts with friction_error <= tol.

    W: Delassus operator (3c, 3c), sparse in any format or dense, may be singular (hyperstatic); q (3c,) relative
    velocities without reactions; mu (c,) coefficients of friction; frames (normal, tangent 1, tangent 2).
    InputError on bad input, FrictionNotConverged, with the best reactions, after max_iterations Newton systems.
    """
    matrix, q, mu = check_problem(W, q, mu)
    if not tol > 0.0:
        raise InputError(f"tol is {tol}; it must be positive")
    if max_iterations < 1:
        raise InputError(f"max_iterations is {max_iterations}; at least 1 is needed")
    if not len(mu):
        return np.zeros(0), FrictionInfo(0.0, 0, 0, 0, METHOD, np.zeros(1))
    blocks = block_rows(matrix)
    found = _friction.solve_friction(
        blocks.indptr.astype(np.int32),
        blocks.indices.astype(np.int32),
        blocks.data,
        q,
        mu,
        tol,
        max_iterations,
    )
    r = np.array(found.reaction)
    # The kernel's own error differs by round-off; the one that counts is measured on the problem as given.
    error = friction_error(matrix, q, mu, r)
    info = FrictionInfo(
        error, found.iterations, found.factorisations, found.proximal_steps, METHOD, np.array(found.history)
    )
    if not (found.converged and error <= tol):
        reason = f"error {error:.2e} above the tolerance {tol:.1e}"
        if info.error <= tol:
            reason = f"the reactions grow without bound (|r| = {np.linalg.norm(r):.1e}): the laws cannot hold"
        raise FrictionNotConverged(f"{reason} after {info.iterations} Newton steps", r, info)
    return r, info


def block_rows(matrix: sp.csr_matrix) -> sp.bsr_matrix:
    """W in sorted rows of 3 by 3 blocks, each with its diagonal block."""
    blocks = matrix.tobsr((3, 3))
    blocks.sort_indices()
    rows = np.repeat(np.arange(len(blocks.indptr) - 1), np.diff(blocks.indptr))
    if np.count_nonzero(rows == blocks.indices) == len(blocks.indptr) - 1:
        return blocks
    entries, diagonal = matrix.tocoo(), np.arange(matrix.shape[0])
    values = np.concatenate([entries.data, np.zeros(len(diagonal))])
    places = (np.concatenate([entries.row, diagonal]), np.concatenate([entries.col, diagonal]))
    blocks = sp.coo_matrix((values, places), shape=matrix.shape).tobsr((3, 3))
    blocks.sort_indices()
    return blocks
