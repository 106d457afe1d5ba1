"""Occluders from the shadows they throw.

Under a given light the picture is linear in what of the mask is open, so that where colour and
edges do not tell (glare, panels, lines, objects of the background's own colour) the shadows do: how
open each such pixel is, between 0 and 1, by least squares over the pixels that the light pass can
be read from, at a price for each that is not as it was thought before (Tibshirani, J. R. Stat. Soc.
B 58 (1996), 267). What throws no shadow that is seen stays as it was thought.

The light may move at the same time: a disc that grows and a shadow that goes look much alike, and
where each waits for the other they creep.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy import sparse

from godfit.disc import DiscLight, terms
from godfit.observation import LEVELS, Picture

ROUNDS, STEPS = 3, 60
# Levels at which a pixel that is off no longer counts in full; of a textured picture, in units of
# its texture. What it costs, in log-likelihood, that a texel is solid that was thought to be open,
# or open: by how much, so that a few change for good rather than all of them a little, and, for the
# sake of a unique answer, a little by its square.
HUBER, FLIP, PULL = 1.0, 4.5, 0.5
# Taps that are held at once, most: some hundred bytes each.
HELD = 1 << 21


class Shadows(NamedTuple):
    """``mask`` (h, w), how open every texel is, and the ``step`` (q,) of what moved along, empty
    where nothing was asked of the shadows."""

    mask: np.ndarray
    step: np.ndarray


def refined(
    model: DiscLight,
    picture: Picture,
    unknown: np.ndarray,
    prior: np.ndarray,
    rows: int,
    seed: int,
    texture: float = 0.0,
    slopes: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Shadows:
    """How open every texel is: ``picture.mask`` where it is known, between 0 and 1 where
    ``unknown``, by so many pixels (``rows``) of the picture. All are (h, w), the light pass's
    size, which may be less than the picture's. ``texture`` is the background's, in levels.

    ``slopes`` of row-major pixels (n,), (q, n, c), are the derivatives of their levels by what may
    move at the same time."""
    h, w = picture.mask.shape[:2]
    columns = np.flatnonzero(unknown)
    usable = np.flatnonzero(picture.valid & ~picture.clipped)
    if not len(columns) or len(usable) < 100:
        return Shadows(picture.mask, np.zeros(0))
    rng = np.random.default_rng(seed)
    pixels = np.sort(rng.permutation(usable)[: min(rows, _affordable(model, picture.size, (h, w)))])
    k, c = model.background.shape
    back = np.array(terms(jnp.asarray(pixels), picture.size, k) @ model.background)
    back *= model.convention.background_gain
    over = np.maximum(1 - back, 0.05) if model.convention.blend == "screen" else np.ones_like(back)
    light = (picture.levels.reshape(-1, c)[pixels] / LEVELS - back) / over
    goal = light.mean(1).astype(np.float64)
    sums = _sums(model, pixels, picture.size, (h, w))
    known = np.where(unknown, 0.0, picture.mask).reshape(-1)
    goal = (goal - sums @ known).astype(np.float32) * np.float32(LEVELS)
    # In single precision all of it stays in the cache.
    design = (sums.tocsc()[:, columns].astype(np.float32) * np.float32(LEVELS)).tocsr()
    moves = np.zeros((len(pixels), 0), np.float32)
    if slopes is not None:
        moves = (slopes(pixels).astype(np.float64) / over).mean(-1).T.astype(np.float32)
    thought = prior.reshape(-1)[columns].astype(np.float32)
    share = thought.copy()
    weight = np.ones_like(goal)
    noise = max(1.0, texture)
    for _ in range(ROUNDS):
        along = _Along(moves, weight, noise)
        share = _bounded(design, goal, weight, along, thought, share, noise * PULL, noise**2 * FLIP)
        step = along.step(goal - design @ share)
        off = np.abs(goal - design @ share - moves @ step)
        weight = np.minimum(1, noise * HUBER / np.maximum(off, 1e-9)).astype(np.float32)
    out = picture.mask.reshape(-1).copy()
    out[columns] = share
    return Shadows(out.reshape(h, w).astype(np.float32), step)


class _Along:
    """What moves along, by least squares over pixels of a ``weight`` (n,): a step of one costs as
    much as ``noise`` in one pixel."""

    def __init__(self, moves: np.ndarray, weight: np.ndarray, noise: float):
        self.moves, self.weight = moves, weight
        weighted = moves.astype(np.float64) * weight[:, None]
        gram = moves.T @ weighted + noise**2 * np.eye(moves.shape[1])
        self._solve = np.linalg.solve(gram, weighted.T).astype(moves.dtype)

    def step(self, residual: np.ndarray) -> np.ndarray:
        """(q,) the step that leaves least of a residual (n,)."""
        return self._solve @ residual

    def left(self, residual: np.ndarray) -> np.ndarray:
        """(n,) the weighted residual that it leaves."""
        return self.weight * (residual - self.moves @ self.step(residual))


def price(mask: np.ndarray, thought: np.ndarray) -> float:
    """What it costs, in log-likelihood, that ``mask`` (h, w) is not what was ``thought`` (h, w)."""
    change = np.abs(mask - thought)
    return float(FLIP * change.sum() + PULL**2 / 2 * (change**2).sum())


def _affordable(model: DiscLight, size: tuple[int, int], low: tuple[int, int]) -> int:
    """Pixels whose taps may be held at once; where the light pass is smaller, each reads four of
    its texels, of which there are only so many."""
    most = HELD // (model.samples + 1)
    if size == low:
        return most
    return size[0] * size[1] if low[0] * low[1] <= most else most // 4


def _bounded(design, goal, weight, along, thought, start, pull, flip) -> np.ndarray:
    """Least squares inside [0, 1] at a price for what is not as it was ``thought``, what moves
    along eliminated (variable projection: Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973), 413):
    accelerated proximal gradient (Beck & Teboulle, SIAM J. Imaging Sci. 2 (2009), 183), scaled by
    the diagonal."""
    adjoint = design.T.tocsr()
    # Row sums of |A'WA| bound what a diagonal step may be, and what moves along only flattens.
    size = adjoint @ (weight * np.asarray(design.sum(1)).ravel()) + pull**2
    share = ahead = start
    momentum = 1.0
    for _ in range(STEPS):
        slope = adjoint @ along.left(design @ ahead - goal) + pull**2 * (ahead - thought)
        change = ahead - slope / size - thought
        change = np.sign(change) * np.maximum(np.abs(change) - flip / size, 0)
        moved = np.clip(thought + change, 0, 1)
        grown = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
        ahead = moved + (momentum - 1) / grown * (moved - share)
        share, momentum = moved, grown
    return share


def _sums(
    model: DiscLight, pixels: np.ndarray, size: tuple[int, int], low: tuple[int, int]
) -> sparse.csr_matrix:
    """(pixels, h w): what every texel's openness adds to the light pass, of ``low`` (h, w) and read
    bilinearly, at ``pixels`` of a picture of ``size``."""
    (height, width), (h, w) = size, low
    if size == low:
        return _texel_sums(model, pixels, low)
    x = (pixels % width + 0.5) * w / width - 0.5
    y = (pixels // width + 0.5) * h / height - 0.5
    read, share = _bilinear(x[:, None], y[:, None], low)
    needed, column = np.unique(read, return_inverse=True)
    starts = np.arange(len(pixels) + 1) * 4
    shape = (len(pixels), len(needed))
    mixed = sparse.csr_matrix((share.ravel(), column.ravel(), starts), shape)
    return sparse.csr_matrix(mixed @ _texel_sums(model, needed, low))


def _texel_sums(model: DiscLight, texels: np.ndarray, size: tuple[int, int]) -> sparse.csr_matrix:
    """(texels, h w): the same at texels of the light pass itself, of ``size``."""
    h, w = size
    (taps,) = model.taps
    lit = np.asarray(model.occlusion(jnp.ones(size)), np.float64).reshape(-1)
    light = np.asarray(model.light[0], np.float64)
    row, column = texels // w, texels % w
    t = np.concatenate([[0.0], np.asarray(taps.t, np.float64)])
    c = np.concatenate([[float(taps.own)], np.asarray(taps.c, np.float64)])
    x = column[:, None] + t * (light[0] * w - 0.5 - column[:, None])
    y = row[:, None] + t * ((1 - light[1]) * h - 0.5 - row[:, None])
    read, share = _bilinear(x, y, size)
    share *= np.tile(c, 4) * lit[read]
    starts = np.arange(len(texels) + 1) * read.shape[1]
    return sparse.csr_matrix((share.ravel(), read.ravel(), starts), (len(texels), h * w))


def _bilinear(x: np.ndarray, y: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(n, 4 k) texels of an image of ``size`` that are read at columns ``x`` and rows ``y`` (n, k),
    and their shares."""
    h, w = size
    i, j = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
    fx, fy = x - i, y - j
    texels, shares = [], []
    for dj, share_y in ((0, 1 - fy), (1, fy)):
        for di, share_x in ((0, 1 - fx), (1, fx)):
            texels.append(np.clip(j + dj, 0, h - 1) * w + np.clip(i + di, 0, w - 1))
            shares.append(share_x * share_y)
    return np.concatenate(texels, 1), np.concatenate(shares, 1)
