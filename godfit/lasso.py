"""Least squares of shares between 0 and 1, few of which are not what they were thought to be.

Each costs by how far it is from there (Tibshirani, J. R. Stat. Soc. B 58 (1996), 267): found one
after the other, mostly among those that do move (Friedman, Hastie & Tibshirani, J. Stat. Softw. 33
(2010), 1). What else may move, at no price of that kind, is eliminated (variable projection: Golub
& Pereyra, SIAM J. Numer. Anal. 10 (1973), 413): where each waited for the other they would creep.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from godfit.native import compiled

# Sweeps over all shares, most, and between two of them over those that move, until the longest step
# of a sweep is this short.
SWEEPS, WITHIN, SHORT = 12, 20, 3e-3


class Along:
    """What moves along, by least squares over rows of a ``weight`` (n,): ``moves`` (n, q) are the
    derivatives, and a step of one costs as much as being off by ``noise`` in one row."""

    def __init__(self, moves: np.ndarray, weight: np.ndarray, noise: float):
        self.weight = weight
        # What moves is told apart by differences a thousandth as large.
        self.weighted = moves.astype(np.float64) * weight[:, None]
        gram = moves.T @ self.weighted
        self.inverse = np.linalg.inv(gram + noise**2 * np.eye(moves.shape[1]))

    def step(self, residual: np.ndarray) -> np.ndarray:
        """(q,) the step that leaves least of a residual (n,)."""
        return self.inverse @ (self.weighted.T @ residual)


def lasso(
    design: sparse.csc_matrix,
    goal: np.ndarray,
    along: Along,
    thought: np.ndarray,
    start: np.ndarray,
    pull: float,
    flip: float,
    short: float = SHORT,
) -> np.ndarray:
    """Shares (m,) in [0, 1] for which ``design`` (n, m), no entry of which is given twice, is
    nearest to ``goal`` (n,), from ``start`` (m,): each costs ``flip`` times how far it is from what
    was ``thought`` (m,), and half of ``pull`` times the square of that. The last step is at most
    ``short``."""
    share = start.astype(np.float64)
    off = goal - design @ share
    shared = design.T @ along.weighted
    # By how much a whole share makes the step shorter.
    taken = shared @ along.inverse
    matrix = design.data, design.indices, design.indptr
    _descend(
        (*matrix, along.weight, shared, taken, thought, pull, flip),
        along.weight * off, along.step(off), share, short,
    )  # fmt: skip
    return share


@compiled
def _descend(problem, off, step, share, short):
    """``share`` (m,) in place, and with it the ``step`` (q,) of what moves along and ``off`` (n,),
    what is left of the goal, weighted."""
    data, rows, starts, weight, shared, taken, thought, pull, _ = problem
    size = np.full(len(share), pull)
    for j in range(len(share)):
        for k in range(starts[j], starts[j + 1]):
            size[j] += weight[rows[k]] * data[k] ** 2
        # What moves along takes some of it.
        size[j] -= (shared[j] * taken[j]).sum()
    every = np.arange(len(share))
    for _ in range(SWEEPS):
        if _swept(every, problem, size, off, step, share) < short:
            break
        (moving,) = np.nonzero(share != thought)
        for _ in range(WITHIN):
            if _swept(moving, problem, size, off, step, share) < short:
                break


@compiled
def _swept(some, problem, size, off, step, share):
    """One after the other of ``some``, each as well as it can be; how far the farthest went."""
    data, rows, starts, weight, shared, taken, thought, pull, flip = problem
    longest = 0.0
    for j in some:
        slope = -pull * (share[j] - thought[j])
        for q in range(len(step)):
            slope -= shared[j, q] * step[q]
        for k in range(starts[j], starts[j + 1]):
            slope += data[k] * off[rows[k]]
        change = share[j] + slope / size[j] - thought[j]
        change = np.sign(change) * max(abs(change) - flip / size[j], 0.0)
        by = min(max(thought[j] + change, 0.0), 1.0) - share[j]
        if by == 0:
            continue
        share[j] += by
        longest = max(longest, abs(by))
        for q in range(len(step)):
            step[q] -= by * taken[j, q]
        for k in range(starts[j], starts[j + 1]):
            off[rows[k]] -= weight[rows[k]] * data[k] * by
    return longest
