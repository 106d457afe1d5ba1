"""The published shaders' loops, compiled by numba, in float64; see ``godfit.flatland.published``.

Pictures are (h, w, channels), row 0 at the top. Texture coordinates (u, v) are those of the
shaders, v up. A texture returns its nearest texel, clamped to the edge.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from godfit.runtime.numba_jit import inlined_jit, jit

TAU = 2 * 3.14159265
"""Radians of the circle, with the source's digits."""

NAIVE_OWN_ALPHA = 0.1
"""The naive march shows a pixel whose alpha is above this as it is."""

NAIVE_HIT_ALPHA = 0.5
"""A ray of the naive march ends in a texel whose alpha is above this."""

GI_OWN_ALPHA = 0.1
"""The gi pass casts rays from a pixel whose alpha is below this."""

GI_EPSILON = 1e-3
"""Texture coordinates: a ray of the gi pass has arrived where the distance is below this."""

NO_DISTANCE = 999999.9
"""Squared texture coordinates: what the flood compares the first seed with."""


class GiRays(NamedTuple):
    """The rays of the gi pass: how many a pixel has, ``steps`` (the source's maxSteps), whether the
    angle between them has noise (``grain``), and the sun's angle and width in radians."""

    rays: Any
    steps: Any
    grain: Any
    sun_angle: Any
    sun_width: Any


@inlined_jit
def outside(u, v):
    """Whether (u, v) is out of bounds. The borders themselves are inside."""
    return u < 0.0 or u > 1.0 or v < 0.0 or v > 1.0


@inlined_jit
def texel_at(u, v, h, w):
    """Row and column of the texel nearest to (u, v)."""
    row = h - 1 - min(max(int(np.floor(v * h)), 0), h - 1)
    return row, min(max(int(np.floor(u * w)), 0), w - 1)


@jit
def naive_rows(scene, noise, first_step, steps, rays, rows):
    """(last - first, w, 3) the naive march of the ``rows`` (first, last) of a ``scene`` (h, w, 4).

    ``noise`` (h, w) is the offset of every pixel's rays. Texels at ``first_step`` to ``steps`` - 1
    pixels along a ray are tested.
    """
    h, w = noise.shape
    first, last = rows
    out = np.zeros((last - first, w, 3))
    share = 1.0 / rays
    for row in range(first, last):
        v = (h - row - 0.5) / h
        for column in range(w):
            light = out[row - first, column]
            if scene[row, column, 3] > NAIVE_OWN_ALPHA:
                light[:] = scene[row, column, :3]
                continue
            u = (column + 0.5) / w
            for i in range(rays):
                # The source's sum: rays a radian apart, and not a share of the circle.
                angle = TAU * share + (i + noise[row, column])
                du, dv = np.cos(angle) / w, -np.sin(angle) / h
                for step in range(first_step, steps):
                    s, t = u + du * step, v + dv * step
                    if outside(s, t):
                        break
                    y, x = texel_at(s, t, h, w)
                    if scene[y, x, 3] > NAIVE_HIT_ALPHA:
                        for c in range(3):
                            light[c] += scene[y, x, c]
                        break
            light *= share
    return out


@jit
def flood_pass(seeds, offset):
    """(h, w, 2) the ``seeds`` (u, v) after one pass of the flood with neighbours ``offset`` away.

    A seed of (0, 0) is none, and what a pixel without any gets.
    """
    h, w, _ = seeds.shape
    out = np.zeros((h, w, 2))
    for row in range(h):
        v = (h - row - 0.5) / h
        for column in range(w):
            u = (column + 0.5) / w
            nearest = NO_DISTANCE
            # From the bottom up, as v goes: the first of two equal seeds stays.
            for y in range(row + offset, row - offset - 1, -offset):
                for x in range(column - offset, column + offset + 1, offset):
                    if not (0 <= y < h and 0 <= x < w):
                        continue
                    s, t = seeds[y, x, 0], seeds[y, x, 1]
                    if s != 0.0 or t != 0.0:
                        distance = (s - u) * (s - u) + (t - v) * (t - v)
                        if distance < nearest:
                            nearest = distance
                            out[row, column, 0], out[row, column, 1] = s, t
    return out


@jit
def gi_rows(scene, distance, noise, march, around, rows):
    """(last - first, w, 3) the gi pass of the ``rows`` (first, last) of a ``scene`` (h, w, 4).

    ``distance`` and ``noise`` are (h, w), ``march`` is a ``GiRays``, and ``around`` (2, 3) has the
    radiance of the sun and of the sky.
    """
    h, w = noise.shape
    first, last = rows
    out = np.zeros((last - first, w, 3))
    share = 1.0 / march.rays
    for row in range(first, last):
        for column in range(w):
            light = out[row - first, column]
            # Here the source tests the colour's length too, to no effect: the larger of a pixel's
            # light and of a share of it is its light.
            if scene[row, column, 3] >= GI_OWN_ALPHA:
                light[:] = scene[row, column, :3]
                continue
            offset = noise[row, column]
            between = TAU * share
            if march.grain:
                between += offset * TAU
            for i in range(march.rays):
                angle = between * (i + offset) + march.sun_angle
                du, dv = np.cos(angle), -np.sin(angle)
                u, v = (column + 0.5) / w, (h - row - 0.5) / h
                arrived = False
                for _ in range(1, march.steps):
                    y, x = texel_at(u, v, h, w)
                    far = distance[y, x]
                    u, v = u + du * far, v + dv * far
                    if outside(u, v):
                        break
                    if far < GI_EPSILON:
                        arrived = True
                        break
                if arrived:
                    y, x = texel_at(u, v, h, w)
                    for c in range(3):
                        light[c] += scene[y, x, c]
                    continue
                past_sun = angle - march.sun_angle
                past_sun -= TAU * np.floor(past_sun / TAU)
                # GLSL leaves a smoothstep with its edges reversed undefined. Drivers compute it as
                # it stands.
                k = min(max((past_sun - march.sun_width) / (0.0 - march.sun_width), 0.0), 1.0)
                k *= k * (3.0 - 2.0 * k)
                for c in range(3):
                    light[c] += around[0, c] * k + around[1, c]
            for c in range(3):
                light[c] = max(scene[row, column, c], light[c] * share)
    return out
