"""What many of a picture's pixels vote for, compiled by numba: lights, by the directions of edges,
and circles, by outlines."""

from __future__ import annotations

import math

import numpy as np

from godfit.runtime.numba_jit import jit

# By how much the cosine of an edge's normal to the way there may be off 0, or off 1, and how many
# times as far off it has no say.
ACROSS, ON, FAR = 0.05, 0.02, 6.0


@jit
def votes_for(u, v, x, y, nx, ny, along):
    """(v, u) votes of edges at ``x``, ``y`` (n,) for places to the right (u,) and above (v,): of
    those whose normals ``nx``, ``ny`` are across the way there or, not ``along``, on it."""
    votes = np.zeros((len(v), len(u)))
    width = ACROSS if along else ON
    for i in range(len(v)):
        for j in range(len(u)):
            for k in range(len(x)):
                dx, dy = u[j] - x[k], v[i] - y[k]
                cosine = abs(dx * nx[k] + dy * ny[k]) / (math.sqrt(dx * dx + dy * dy) + 1e-6)
                off = (cosine if along else 1 - cosine) / width
                if off < FAR:
                    votes[i, j] += math.exp(-off * off)
    return votes


@jit
def passed_by(circles, x, y, near):
    """(n,) how many places ``x``, ``y`` (m,) each of ``circles`` (n, 3) passes so ``near``."""
    passed = np.zeros(len(circles), np.int64)
    for i in range(len(circles)):
        u, v, radius = circles[i]
        for j in range(len(x)):
            passed[i] += abs(math.sqrt((x[j] - u) ** 2 + (y[j] - v) ** 2) - radius) < near
    return passed
