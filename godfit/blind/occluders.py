"""Occluders from the shadows they throw.

Under a given light the picture is linear in what of the mask is open, so that where colour and
edges do not tell (glare, panels, lines, objects of the background's own colour) the shadows do: how
open each such pixel is, between 0 and 1, by least squares over the pixels that the light pass can
be read from, at a price for each that is not as it was thought before; see ``lasso.py``. What
throws no shadow that is seen stays as it was thought. At the disc's rim, which the model does not
draw as the picture's renderer did, texels may be more than open: as bright as the disc.

The light may move at the same time: a disc that grows and a shadow that goes look much alike, and
where each waits for the other they creep.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy import sparse

from godfit.blind import outline
from godfit.blind.lasso import Along, lasso
from godfit.inference.evaluate import taps_of
from godfit.inference.observation import Picture
from godfit.io.image import LEVELS
from godfit.models.background import terms
from godfit.models.bare_picture import FAINTEST_VEIL
from godfit.models.disc_light import DiscLight
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.mask_jacobian import PartlyKnownMask, PixelTaps, mask_jacobian

ROUNDS = 3
# Levels at which a pixel that is off no longer counts in full; of a textured picture, in units of
# its texture. What it costs, in log-likelihood of all of a picture's pixels, that a texel is solid
# that was thought to be open, or open: by how much, so that a few change for good rather than all
# of them a little, and, for the sake of a unique answer, a little by its square.
HUBER, FLIP, PULL = 1.0, 36.0, 2.0
# Rows of a mask whose texels are told one by one, at least, and less than twice as many.
TOLD = 270
# Taps that are gone through at once, most: those that read what is unknown are held.
HELD = 1 << 23


class Shadows(NamedTuple):
    """``mask`` (h, w), how open every texel is, the ``step`` (q,) of what moved along, and the
    ``weight`` (n,) of every pixel: less than 1 where it is off by much."""

    mask: np.ndarray
    step: np.ndarray
    weight: np.ndarray


class Question(NamedTuple):
    """How open ``texels`` (k,) of ``picture.mask`` are, those of one of m cells, ``cell`` (k,),
    alike: ``thought`` (m,) before, each worth ``counts`` (m,). What the light pass is at row-major
    ``pixels`` (n,), less what is known of it, is the ``goal`` (n,) in levels, and what they add to
    it the ``design`` (n, m); where the picture is another, the light pass is by the sum of
    ``weights`` (n, c) times that. ``noise`` is in levels; glare hides those of ``hidden`` (m,)."""

    picture: Picture
    texels: np.ndarray
    cell: np.ndarray
    thought: np.ndarray
    counts: np.ndarray
    pixels: np.ndarray
    goal: np.ndarray
    design: sparse.csc_matrix
    weights: np.ndarray
    noise: float
    hidden: np.ndarray

    def answered(
        self,
        slopes: Callable[[np.ndarray], np.ndarray] | None = None,
        near: Shadows | None = None,
    ) -> Shadows:
        """``slopes`` of row-major pixels (n,), (q, n, c), are the derivatives of their levels by
        what may move at the same time. One round does from another answer that is ``near``."""
        picture, goal, design, noise = self.picture, self.goal, self.design, self.noise
        moves = np.zeros((len(goal), 0), np.float32)
        if slopes is not None:
            moves = (slopes(self.pixels) * self.weights).sum(-1).T.astype(np.float32)
        out = (picture.mask if near is None else near.mask).reshape(-1).copy()
        many = np.bincount(self.cell)
        share = np.bincount(self.cell, out[self.texels]) / many * self.counts
        # As precise as what was thought: what is as it was thought is told by that.
        share, step = share.astype(np.float32), np.zeros(0)
        weight = np.ones_like(goal) if near is None else near.weight
        each = many * noise**2 * len(goal) / (picture.size[0] * picture.size[1])
        for _ in range(ROUNDS if near is None else 1):
            along = Along(moves, weight, noise)
            thought, flip = self._prices(out)
            share = lasso(design, goal, along, thought, share, PULL * each, flip * each)
            out[self.texels] = (share / self.counts)[self.cell]
            step = along.step(goal - design @ share)
            off = np.abs(goal - design @ share - moves @ step)
            weight = np.minimum(1, noise * HUBER / np.maximum(off, 1e-9)).astype(np.float32)
        return Shadows(out.reshape(picture.mask.shape).astype(np.float32), step, weight)

    def _prices(self, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) each: what every cell is thought to be, and what it costs to be otherwise, where
        what is hidden is thought to be as what is around it in ``mask`` (h w,)."""
        size, asked = self.picture.mask.shape, self.hidden[self.cell]
        where = np.zeros(mask.size, bool)
        where[self.texels[asked]] = True
        each = outline.thought(np.minimum(mask, 1).reshape(size), where.reshape(size))
        cell, many = self.cell[asked], np.bincount(self.cell)
        side, by = (np.bincount(cell, a, len(many)) / many for a in each)
        thought = np.where(self.hidden, (side > 0.5) * self.counts, self.thought)
        return thought.astype(np.float32), FLIP * np.where(self.hidden, by, 1)


def asked(
    model: DiscLight,
    picture: Picture,
    unknown: np.ndarray,
    prior: np.ndarray,
    rows: int,
    seed: int,
    texture: float = 0.0,
) -> Question | None:
    """How open every texel is: ``picture.mask`` where it is known, between 0 and 1 where
    ``unknown``, up to what is as bright as the disc at its rim, by so many pixels (``rows``) of the
    picture. All are (h, w), the light pass's size, which may be less than the picture's.
    ``texture`` is the background's, in levels. None where nothing is unknown, or nothing is seen of
    it."""
    h, w = picture.mask.shape[:2]
    rim, worth = _rim(model, (h, w))
    unknown = unknown | rim
    texels = np.flatnonzero(unknown)
    usable = np.flatnonzero(picture.valid & ~picture.clipped)
    if not len(texels) or len(usable) < 100:
        return None
    cell = _cells(texels, prior, rim)
    rng = np.random.default_rng(seed)
    count = min(rows, len(usable), _affordable(model, picture.size, (h, w)))
    pixels = np.sort(rng.choice(usable, count, replace=False, shuffle=False))
    light, weights = light_read(model, picture, pixels)
    known, design = _sums(model, pixels, picture, texels, cell)
    goal = (light - known * LEVELS).astype(np.float32)
    # One of each: those of a cell are worth as much, and were thought to be as open.
    _, each = np.unique(cell, return_index=True)
    counts = worth.ravel()[texels[each]]
    design.data /= np.repeat(counts, np.diff(design.indptr))
    thought = prior.ravel()[texels[each]].astype(np.float32) * counts
    hidden = (outline.hidden(picture, unknown, (h, w)) & ~rim).ravel()[texels[each]]
    noise = max(1.0, texture)
    return Question(
        picture, texels, cell, thought, counts, pixels, goal, design, weights, noise, hidden
    )


def _cells(texels: np.ndarray, prior: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """(k,) in which cell, from 0 on, each of ``texels`` (k,) is: of a large mask rays that can be
    read are too few to tell single ones. What was thought open is not with what was thought solid,
    and at the ``rim`` each is told for itself, as are those half open."""
    (h, w), one = prior.shape[:2], np.arange(len(texels))
    side = max(1, h // TOLD)
    if side == 1:
        return one
    thought, alone = prior.ravel()[texels], rim.ravel()[texels]
    place = texels // w // side * -(-w // side) + texels % w // side
    shared = 2 * place + (thought == 1)
    key = np.where(alone | (thought > 0) & (thought < 1), 2 * h * w + one, shared)
    return np.unique(key, return_inverse=True)[1]


def light_read(
    model: DiscLight, picture: Picture, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the light pass is, in levels (n,), at row-major ``pixels`` (n,) of ``picture`` over the
    model's background: the sum of ``weights`` (n, c), returned as well, times what is over it, in
    the channels that are not clipped."""
    k, c = model.background.shape
    back = terms(pixels, picture.size, k) @ np.asarray(model.background)
    back = back * model.convention.background_gain
    colour = np.asarray(model.colour, np.float64) * ~picture.above.reshape(-1, c)[pixels]
    colour /= np.maximum((colour**2).sum(1, keepdims=True), 1e-6)
    over = np.maximum(1 - back, 0.05) if model.convention.blend == "screen" else np.ones_like(back)
    weights = colour / over
    light = (picture.levels.reshape(-1, c)[pixels] - LEVELS * back) * weights
    return light.sum(1), weights


def texels_of(
    pixels: np.ndarray, size: tuple[int, int], low: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows (n,), of a light pass of the size ``low``, of row-major ``pixels`` (n,)."""
    x = (pixels % size[1] + 0.5) * low[1] / size[1] - 0.5
    y = (pixels // size[1] + 0.5) * low[0] / size[0] - 0.5
    return x, y


def price(
    model: DiscLight, mask: np.ndarray, thought: np.ndarray, hidden: np.ndarray, share: float
) -> float:
    """What it costs, in log-likelihood of that ``share`` of a picture's pixels, that ``mask``
    (h, w) is not what was ``thought`` (h, w) under ``model``, at the rim by how bright it is, and
    how much longer its outline is where that is ``hidden`` (h, w)."""
    rim, worth = _rim(model, (mask.shape[0], mask.shape[1]))
    hidden = hidden & ~rim
    change = np.where(hidden, 0, np.abs(np.minimum(mask * worth, 1) - thought * worth))
    longer = outline.length(np.minimum(mask, 1), hidden) - outline.length(thought, hidden)
    return share * float(FLIP * (change.sum() + longer) + PULL / 2 * (change**2).sum())


def _rim(model: DiscLight, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) each: where the disc's edge may cut texels, and what there, by how bright it is, one
    that is open is worth. How they are cut the model does not know: they may be anything from dark
    to as bright as the disc, so that some are more than open."""
    rim, lit = (np.asarray(each) for each in _disc_of(model, size))
    return rim, np.where(rim, np.maximum(lit, FAINTEST_VEIL), 1).astype(np.float32)


def lit_by(model: DiscLight, size: tuple[int, int]) -> np.ndarray:
    """(h, w) how bright the light pass finds what is open."""
    return np.asarray(_disc_of(model, size)[1])


@cached_jit
def _disc_of(model: DiscLight, size: tuple[int, int]):
    return model.rim(size), model.occlusion(jnp.ones(size, jnp.float32)).astype(jnp.float32)


def _affordable(model: DiscLight, size: tuple[int, int], low: tuple[int, int]) -> int:
    """Pixels whose taps may be held at once; where the light pass is smaller, each reads four of
    its texels, of which there are only so many."""
    most = HELD // (model.samples + 1)
    if size == low:
        return most
    return size[0] * size[1] if low[0] * low[1] <= most else most // 4


def _sums(
    model: DiscLight, pixels: np.ndarray, picture: Picture, unknown: np.ndarray, cell: np.ndarray
) -> tuple[np.ndarray, sparse.csc_matrix]:
    """What the light pass, of the mask's size and read bilinearly, is at row-major ``pixels`` (n,)
    of the picture for what is known of the mask, and what the openness of every ``cell`` (k,) of
    ``unknown`` texels (k,) adds to it in levels (n, cells)."""
    low = (picture.mask.shape[0], picture.mask.shape[1])
    texels, mixed = pixels, None
    if picture.size != low:
        read, share = _bilinear(*texels_of(pixels, picture.size, low), low)
        texels, column = np.unique(read, return_inverse=True)
        starts = np.arange(len(pixels) + 1) * 4
        shape = (len(pixels), len(texels))
        mixed = sparse.csr_matrix((share.ravel(), column.ravel(), starts), shape)
    place = np.full(picture.mask.size, -1, np.int32)
    place[unknown] = cell
    count = int(cell.max()) + 1
    light = np.asarray(model.light, np.float64)[0] * (low[1], -low[0]) + (-0.5, low[0] - 0.5)
    lit = lit_by(model, low).ravel()
    t, c = (np.asarray(a, np.float64) for a in taps_of(model))
    values = np.asarray(picture.mask, np.float32).ravel()
    taps, mask = PixelTaps(light, t, c), PartlyKnownMask(low, values, place, count, lit)
    known, starts, read, share = mask_jacobian(texels, taps, mask)
    shape = (len(texels), count)
    share *= np.float32(LEVELS)
    sums = sparse.csr_matrix((share, read, starts), shape)
    if mixed is not None:
        known, sums = mixed @ known, mixed.astype(np.float32) @ sums
    return known, sparse.csc_matrix(sums)


def _bilinear(x: np.ndarray, y: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """(n, 4) texels of an image of ``size`` that are read at columns ``x`` and rows ``y`` (n,), and
    their shares."""
    h, w = size
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - i, y - j
    at = [
        np.clip(j + dj, 0, h - 1) * w + np.clip(i + di, 0, w - 1) for dj in (0, 1) for di in (0, 1)
    ]
    shares = [(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy]
    return np.stack(at, 1), np.stack(shares, 1)
