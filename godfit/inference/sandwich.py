"""Standard errors where neighbouring pixels err together: JPEG blocks, texels of an upsampled pass.

The likelihood takes pixels to be independent. Where the residual is correlated, its curvature H
promises too much. The covariance of the estimate is H^-1 G H^-1, with G the covariance of the
likelihood's slope (White, Econometrica 50 (1982), 1). G is estimated from the slope's sums over
square cells, each cell one draw (Liang & Zeger, Biometrika 73 (1986), 13). Correlation within a
cell, from noise, brightness or the picture's structure, is then included. A single factor for all
parameters, from the residual's autocorrelation, would not do: correlation harms a smooth derivative
and spares a rugged one.
"""

from __future__ import annotations

import numpy as np

from godfit.inference.observation import Observation
from godfit.inference.solver import Tangent

CELLS_A_SIDE = 8
"""Cells along the longer side of a picture: 64 draws determine G to a fifth."""
LEAST_CELL = 16
"""Pixels a side of a cell, at least: the unit of a JPEG with subsampled colours."""
CORRELATION_SPREADS = 5.0
"""Standard deviations of a chance correlation, 1 / sqrt(pairs), that chance does not reach."""
ROUNDING_CORRELATION = 0.03
"""Correlation of neighbours that rounding alone may leave."""


def neighbours(score: np.ndarray, observation: Observation) -> tuple[float, float, int]:
    """Correlation of horizontal and of vertical neighbours of ``score`` (m,), and the number of
    pairs of the direction that has fewer of them."""
    h, w = observation.size
    image = np.full((h * w, observation.channels), np.nan, np.float32)
    image[np.asarray(observation.pixels)] = np.asarray(score).reshape(-1, observation.channels)
    image = image.reshape(h, w, observation.channels)
    found, pairs = [], []
    for a, b in ((image[:, :-1], image[:, 1:]), (image[:-1], image[1:])):
        both = np.isfinite(a) & np.isfinite(b)
        a, b = np.where(both, a, 0), np.where(both, b, 0)
        power = float(np.sqrt(np.sum(a * a, dtype=np.float64) * np.sum(b * b, dtype=np.float64)))
        found.append(float(np.sum(a * b, dtype=np.float64)) / power if power > 0 else 0.0)
        pairs.append(int(np.count_nonzero(both)))
    known = [n for n in pairs if n > 0]
    return found[0], found[1], min(known, default=0)


def white(score: np.ndarray, observation: Observation) -> bool:
    """Whether neighbouring entries of ``score`` (m,) are uncorrelated."""
    across, down, pairs = neighbours(score, observation)
    return bool(
        max(across, down) < max(ROUNDING_CORRELATION, CORRELATION_SPREADS / np.sqrt(max(pairs, 1)))
    )


def slope_covariance(
    tangent: Tangent, score: np.ndarray, sigma: float, observation: Observation
) -> np.ndarray:
    """(p, p) covariance of the log-likelihood's slope by coordinate, from its sums over cells."""
    h, w = observation.size
    side = max(LEAST_CELL, max(h, w) // CELLS_A_SIDE)
    pixels = np.asarray(observation.pixels)
    across = -(-w // side)
    cell = np.repeat(pixels // w // side * across + pixels % w // side, observation.channels)
    weight = np.asarray(score, np.float64) / sigma
    sums = np.stack([np.bincount(cell, weight * row) for row in tangent.jacobian])
    sums /= np.asarray(tangent.scale, np.float64)[:, None]
    filled = np.count_nonzero(np.bincount(cell))
    # The fit makes the sum over all cells zero in every coordinate, which costs as many draws.
    freedom = max(filled - len(sums), 1)
    return sums @ sums.T * (filled / freedom)


def widened(
    covariance: np.ndarray, slope: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, float]:
    """``covariance`` (p, p) replaced by H^-1 G H^-1 in every direction where that is larger, and
    the growth: pixels for each independent one, as a geometric mean over directions."""

    moving = np.flatnonzero(free & (np.diag(covariance) > 0))
    if not len(moving):
        return covariance, 1.0
    block = np.ix_(moving, moving)
    # Scaled to a unit diagonal: the coordinates' units differ by orders of magnitude.
    size = np.sqrt(np.diag(covariance)[moving])
    values, vectors = np.linalg.eigh(covariance[block] / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0))
    growth, turn = np.linalg.eigh(root.T @ slope[block] @ root)
    growth = np.maximum(growth, 1.0)
    out = covariance.copy()
    out[block] = (root @ turn * growth) @ (root @ turn).T
    return out, float(np.exp(np.mean(np.log(growth))))
