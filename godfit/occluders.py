"""Occluders from the shadows they throw.

Under a given light the picture is linear in what of the mask is open, so that where colour and
edges do not tell (glare, panels, lines, objects of the background's own colour) the shadows do: how
open each such pixel is, between 0 and 1, by least squares over the pixels that the light pass can
be read from, with a weak pull to what was thought before. What throws no shadow that is seen stays
as it was thought.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from scipy import sparse

from godfit.disc import DiscLight, terms
from godfit.observation import LEVELS, Picture

ROUNDS, STEPS = 3, 40
# Levels at which a pixel that is off no longer counts in full, and at which the pull to the prior
# is worth as much as one pixel of the picture; of a textured one, in units of its texture.
HUBER, PULL = 1.0, 3.0
# Taps that are held at once, most: some hundred bytes each.
HELD = 1 << 21


def refined(
    model: DiscLight,
    picture: Picture,
    unknown: np.ndarray,
    prior: np.ndarray,
    rows: int,
    seed: int,
    texture: float = 0.0,
) -> np.ndarray:
    """(h, w) how open every texel is: ``picture.mask`` where it is known, between 0 and 1 where
    ``unknown``, by so many pixels (``rows``) of the picture. All are (h, w), the light pass's
    size, which may be less than the picture's. ``texture`` is the background's, in levels."""
    h, w = picture.mask.shape[:2]
    columns = np.flatnonzero(unknown)
    usable = np.flatnonzero(picture.valid & ~picture.clipped)
    if not len(columns) or len(usable) < 100:
        return picture.mask
    rng = np.random.default_rng(seed)
    pixels = np.sort(rng.permutation(usable)[: min(rows, _affordable(model, picture.size, (h, w)))])
    k, c = model.background.shape
    back = np.array(terms(jnp.asarray(pixels), picture.size, k) @ model.background)
    back *= model.convention.background_gain
    light = picture.levels.reshape(-1, c)[pixels] / LEVELS - back
    if model.convention.blend == "screen":
        light /= np.maximum(1 - back, 0.05)
    goal = light.mean(1).astype(np.float64)
    sums = _sums(model, pixels, picture.size, (h, w))
    known = np.where(unknown, 0.0, picture.mask).reshape(-1)
    goal = (goal - sums @ known) * LEVELS
    design = (sums.tocsc()[:, columns] * LEVELS).tocsr()
    thought = prior.reshape(-1)[columns].astype(np.float64)
    share = thought.copy()
    weight = np.ones(len(goal))
    noise = max(1.0, texture)
    for _ in range(ROUNDS):
        share = _bounded(design, goal, weight, thought, share, noise * PULL)
        off = np.abs(goal - design @ share)
        weight = np.minimum(1.0, noise * HUBER / np.maximum(off, 1e-9))
    out = picture.mask.reshape(-1).copy()
    out[columns] = share
    return out.reshape(h, w).astype(np.float32)


def _affordable(model: DiscLight, size: tuple[int, int], low: tuple[int, int]) -> int:
    """Pixels whose taps may be held at once; where the light pass is smaller, each reads four of
    its texels, of which there are only so many."""
    most = HELD // (model.samples + 1)
    if size == low:
        return most
    return size[0] * size[1] if low[0] * low[1] <= most else most // 4


def _bounded(design, goal, weight, thought, start, pull) -> np.ndarray:
    """Least squares with a pull to ``thought`` inside [0, 1]: accelerated projected gradient (Beck
    & Teboulle, SIAM J. Imaging Sci. 2 (2009), 183), scaled by the diagonal."""
    weighted = design.T.multiply(weight).tocsr()
    # Row sums of |A'WA| bound what a diagonal step may be.
    size = weighted @ np.asarray(design.sum(1)).ravel() + pull**2
    share = ahead = start
    momentum = 1.0
    for _ in range(STEPS):
        slope = weighted @ (design @ ahead - goal) + pull**2 * (ahead - thought)
        moved = np.clip(ahead - slope / size, 0, 1)
        grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
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
