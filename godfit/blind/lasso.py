"""Least squares of shares between 0 and 1, few of which are not what they were thought to be.

Each costs by how far it is from there (Tibshirani, J. R. Stat. Soc. B 58 (1996), 267). Which of
them move is found one after the other (Friedman, Hastie & Tibshirani, J. Stat. Softw. 33 (2010),
1); those that do are solved for together, as texels along one ray are so much alike that one after
the other they would creep: which of them end at a bound is guessed, and all that were guessed wrong
change sides at once (block principal pivoting: Portugal, Judice & Vicente, Math. Comp. 63 (1994),
625). What else may move, at no price of that kind, is eliminated (variable projection: Golub &
Pereyra, SIAM J. Numer. Anal. 10 (1973), 413).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from godfit.runtime.numba_jit import jit

# Sweeps over all shares, most, until the longest step of a sweep is this short or what moves gains
# less than this share of what it costs that one flips.
SWEEPS, SHORT, GAIN = 12, 3e-3, 0.02
# Between two of them those that move are swept so often and then solved for; while they are more
# than so many, too many to be solved for, swept so often instead, for as long as that is worth such
# a share of what is left: where so many are not as they were thought, the light seldom is found.
BEFORE, MANY, INSTEAD, HEADWAY = 5, 700, 20, 0.01
# Guesses at which of them end at a bound, most, and by how much their squares are damped at first,
# as a share of the matrix's diagonal: ten times less once they were guessed, ten times more where
# they were not.
GUESSES, DAMP = 8, 1e-2


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

    def left(self, off: np.ndarray, step: np.ndarray) -> float:
        """Half the sum of squares of a residual, ``off`` (n,) times the weight, that is left by the
        ``step`` (q,) that leaves least."""
        residual = off / self.weight
        return float(off @ residual - step @ (self.weighted.T @ residual)) / 2


def lasso(
    design: sparse.csc_matrix,
    goal: np.ndarray,
    along: Along,
    thought: np.ndarray,
    start: np.ndarray,
    pull: float | np.ndarray,
    flip: float | np.ndarray,
    short: float = SHORT,
) -> np.ndarray:
    """Shares (m,) in [0, 1] for which ``design`` (n, m), no entry of which is given twice, is
    nearest to ``goal`` (n,), from ``start`` (m,): each costs ``flip``, all alike or (m,), times how
    far it is from what was ``thought`` (m,), and half of ``pull`` times the square of that. It ends
    once the longest step of a sweep is less than ``short``."""
    pull, flip = (np.full(len(thought), price, np.float64) for price in (pull, flip))
    enough = GAIN * flip.max(initial=0)
    share = start.astype(np.float64)
    off = along.weight * (goal - design @ share)
    step = along.step(goal - design @ share)
    shared = design.T @ along.weighted
    # By how much a whole share makes the step shorter.
    taken = shared @ along.inverse
    columns = design.data, design.indices, design.indptr, along.weight, shared, taken
    prices = thought, pull, flip
    size = _sizes(columns, pull)
    every = np.arange(len(share))
    damp, before = DAMP, np.inf
    for _ in range(SWEEPS):
        if _swept(every, columns, prices, size, off, step, share) < short:
            break
        (moving,) = np.nonzero(share != thought)
        for _ in range(INSTEAD if len(moving) > MANY else BEFORE):
            _swept(moving, columns, prices, size, off, step, share)
        (moving,) = np.nonzero(share != thought)
        if len(moving) > MANY:
            left = along.left(off, step) + _cost(share - thought, pull, flip)
            if left > (1 - HEADWAY) * before:
                break
            before = left
            continue
        few = design[:, moving]
        # Column by column, so that those of a row are in order.
        rows = few.tocsr()
        gram = _gram(rows.data, rows.indices, rows.indptr, along.weight, len(moving))
        gram -= shared[moving] @ taken[moving].T
        gram[np.diag_indices(len(moving))] += pull[moving]
        there, was = thought[moving], share[moving]
        up = was > there
        slope = few.T @ off - shared[moving] @ step - pull[moving] * (was - there)
        slope -= np.where(up, 1, -1) * flip[moving]
        # None goes past what it was thought to be: what it costs would change its sign.
        least, most = np.where(up, there, 0.0), np.where(up, 1.0, there)
        damped = gram + damp * np.diag(np.diag(gram))
        share[moving], guessed = _bounded(damped, slope, was, least, most)
        by = share[moving] - was
        off -= along.weight * (few @ by)
        step -= by @ taken[moving]
        if guessed and damp < DAMP and slope @ by - by @ gram @ by / 2 < enough:
            break
        damp *= 0.1 if guessed else 10
    return share


def _cost(change: np.ndarray, pull: np.ndarray, flip: np.ndarray) -> float:
    """Of shares that are by so much, ``change`` (m,), not what they were thought to be."""
    return float((pull * change**2).sum() / 2 + (flip * np.abs(change)).sum())


def _bounded(
    gram: np.ndarray, slope: np.ndarray, start: np.ndarray, least: np.ndarray, most: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Where ``slope @ d - d @ gram @ d / 2``, d from ``start`` (k,), is the largest, between
    ``least`` and ``most`` (k,), and whether it is: where the guesses run out, the best of them."""
    best, gain = start, 0.0
    low, high = start <= least, start >= most
    # Half as long: what that rounds, the next guess or the next sweep makes up for.
    short = gram.astype(np.float32)
    for _ in range(GUESSES):
        found = np.where(low, least, np.where(high, most, start))
        left = slope - short @ (found - start).astype(np.float32)
        (free,) = np.nonzero(~(low | high))
        if len(free):
            found[free] += _solved(short, gram, free, left[free])
        by = (found - start).astype(np.float32)
        left = slope - short @ by
        inside = np.clip(found, least, most)
        by = (inside - start).astype(np.float32)
        now = float(slope @ by - by @ (short @ by) / 2)
        if now > gain:
            best, gain = inside, now
        # Those that end past a bound go to it, those at one that would rather be off it leave.
        below, above = ~low & (found < least), ~high & (found > most)
        up, down = low & (left > 0), high & (left < 0)
        if not (below | above | up | down).any():
            return best, True
        low, high = (low & ~up) | below, (high & ~down) | above
    return best, False


def _solved(short: np.ndarray, gram: np.ndarray, which: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """``gram``'s equations of some unknowns, ``which`` (k,), in single precision (``short``) where
    that will do."""
    for matrix in (short, gram):
        try:
            factor = cho_factor(
                _lower(matrix, which), lower=True, overwrite_a=True, check_finite=False
            )
        except np.linalg.LinAlgError:
            continue
        return cho_solve(factor, goal.astype(matrix.dtype), check_finite=False)
    raise np.linalg.LinAlgError("shares: expected a positive definite matrix")


@jit
def _sizes(columns, pull):
    """(m,) what the square of every share is times."""
    data, rows, starts, weight, shared, taken = columns
    size = pull.copy()
    for j in range(len(size)):
        for k in range(starts[j], starts[j + 1]):
            size[j] += weight[rows[k]] * data[k] ** 2
        # What moves along takes some of it.
        size[j] -= (shared[j] * taken[j]).sum()
    return size


@jit
def _gram(data, columns, starts, weight, count):
    """(count, count) products of every two columns of a matrix in sparse rows, sorted by column: of
    each row those it holds, few."""
    out = np.zeros((count, count))
    for row in range(len(starts) - 1):
        for a in range(starts[row], starts[row + 1]):
            value = weight[row] * data[a]
            for b in range(starts[row], a + 1):
                out[columns[a], columns[b]] += value * data[b]
    for i in range(count):
        for j in range(i):
            out[j, i] = out[i, j]
    return out


@jit
def _lower(matrix, which):
    """(k, k) rows and columns ``which`` (k,) of a symmetric matrix, up to its diagonal."""
    out = np.empty((len(which), len(which)), matrix.dtype)
    for i in range(len(which)):
        for j in range(i + 1):
            out[i, j] = matrix[which[i], which[j]]
    return out


@jit
def _swept(some, columns, prices, size, off, step, share):
    """One after the other of ``some``, each as well as it can be, ``share`` (m,) in place, and with
    it the ``step`` (q,) of what moves along and ``off`` (n,), what is left of the goal, weighted;
    how far the farthest went."""
    data, rows, starts, weight, shared, taken = columns
    thought, pull, flip = prices
    longest = 0.0
    for j in some:
        slope = -pull[j] * (share[j] - thought[j])
        for q in range(len(step)):
            slope -= shared[j, q] * step[q]
        for k in range(starts[j], starts[j + 1]):
            slope += data[k] * off[rows[k]]
        change = share[j] + slope / size[j] - thought[j]
        change = np.sign(change) * max(abs(change) - flip[j] / size[j], 0.0)
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
