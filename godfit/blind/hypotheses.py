"""What the light pass may have read: hypotheses of the occlusion mask, all under one misfit.

- *bright*: what is bright in the picture, within a radius of the light. Right wherever the light is
  in sight, whatever the background.
- *sky*: a monotone function of the brightness, wherever it is. Right for photographs, whose rays
  are those of all that is bright.
- *colour*: a disc on a veil, open where the picture has the colour of its background, or is
  clipped. White light adds the same to every channel, so that an open pixel keeps the differences
  between the channels. Right for objects on a ground of one colour.
- *darkness*: the same, open where the picture is not dark. Right for dark objects on any ground.

A hypothesis is a few maps, each with a gain of its own, that are summed along the rays to the
light; some of them only within a radius of it. It also says which pixels are data: under *bright* a
pixel of the mask never is one, as the picture would explain itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from godfit.blind.reduced import Reduced

TOP, NEAR_TOP = 0.998, 0.95
"""Quantiles of the brightness: where the bright map is full, and of how much of the picture is
bright at most."""
LOW_SHARE, HIGH_SHARE = 0.77, 0.95
"""Where the bright map begins, as a share of where it is full: at least, and at most."""
COLOUR_BIN = 0.02
"""Width of a bin of colour differences: five levels, a few spreads of a flat ground."""
COLOUR_WIDTH = 0.02
"""Largest distance of a colour difference from the ground's: light adds none, rounding half a
level."""
DARKER = 0.04
"""How much darker than the ground an object of its colour is, at least: ten levels."""
DARK_CENTRES = (0.05, 0.95)
"""Quantiles of the brightness at which the centres of dark and light pixels start."""
CENTRE_ROUNDS = 30
"""Rounds of the two centres: they stand still after about ten."""
SKY_STEPS, FEWER_SKY_STEPS = 4, 2
"""Steps of a sky's brightness: a threshold between two of them is their mixture. The light that
fewer steps give tells how much it depends on them."""
LEAST_SHARE = 0.03
"""Share of the picture that is open and usable, at least, for a hypothesis to be tried."""


class Hypothesis(NamedTuple):
    """``maps`` (k, h, w) and whether only texels within the radius count, ``windowed`` (k,);
    ``values`` (h, w) whose differences are data where ``usable`` (h, w), and lower bounds where
    ``bounded`` (h, w); ``ceiling`` (h, w) what light is at most; ``steps`` (h, w), whose height is
    free; ``open_`` (h, w) the mask without the disc, for the picture of the answer."""

    name: str
    maps: np.ndarray
    windowed: np.ndarray
    values: np.ndarray
    usable: np.ndarray
    bounded: np.ndarray
    ceiling: np.ndarray
    steps: tuple[np.ndarray, ...]
    open_: np.ndarray


def bright(copy: Reduced, occluded: np.ndarray) -> Hypothesis:
    """What is bright, softly, above a threshold, but at most about 5% of the picture."""
    passed = bright_pass(copy.values[..., 0], copy.valid) * ~occluded
    usable = copy.usable & ~grown(passed > 0)
    values = copy.values @ calmest_channel(copy.values, usable)
    return Hypothesis(
        "bright", _maps(passed), np.array([1]), values, usable, np.zeros_like(usable),
        copy.values.min(-1), (), passed,
    )  # fmt: skip


def sky(copy: Reduced, occluded: np.ndarray, count: int = SKY_STEPS) -> Hypothesis | None:
    """A sum of ``count`` steps of the brightness, between what is dark and what is brightest; only
    what is dark is data. None where there is too little of either."""
    if not copy.usable.any():
        return None
    mean = copy.values.mean(-1)
    dark = dark_threshold(mean[copy.valid])
    lit = (mean > dark) & copy.valid & ~occluded
    if min(lit.mean(), (copy.usable & ~lit).mean()) < LEAST_SHARE:
        return None
    steps = np.quantile(mean[lit], np.arange(count) / count)
    maps = [(lit & (mean >= step)).astype(np.float64) for step in steps]
    usable = copy.usable & ~grown(lit)
    values = copy.values @ calmest_channel(copy.values, usable)
    return Hypothesis(
        "sky", _maps(*maps), np.zeros(count, int), values, usable, np.zeros_like(usable),
        copy.values.min(-1), (), maps[0],
    )  # fmt: skip


def coarse_sky(copy: Reduced, occluded: np.ndarray) -> Hypothesis | None:
    """The same with fewer steps."""
    return sky(copy, occluded, FEWER_SKY_STEPS)


def bright_pass(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """(h, w) from 0 to 1, softly, between two quantiles of ``values`` (h, w)."""
    low, high = np.quantile(values[valid], (NEAR_TOP, TOP))
    low = min(max(LOW_SHARE * high, low), HIGH_SHARE * high)
    return np.clip((values - low) / max(high - low, 1e-6), 0, 1) * valid


def calmest_channel(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """(3,) weights of the channels, none negative, that sum to 1 and leave the least texture.

    White light adds the same to every channel, and texture does not: of all combinations that keep
    the light, this one has the least spread (generalised least squares of the differences of
    neighbours, with robust weights).
    """
    apart = max(3, max(usable.shape) // 20)
    both = usable[:, apart:] & usable[:, :-apart]
    differences = (values[:, apart:] - values[:, :-apart])[both]
    if len(differences) < 10:
        return np.full(3, 1 / 3)
    weight = np.ones(len(differences))
    noise = 1e-6 * np.eye(3)
    for _ in range(5):
        spread = (differences * weight[:, None]).T @ differences / weight.sum() + noise
        size = np.einsum("ni,ij,nj->n", differences, np.linalg.inv(spread), differences)
        weight = 1 / (1 + size)
    spread += 0.03 * np.trace(spread) / 3 * np.eye(3)
    weights = np.maximum(np.linalg.solve(spread, np.ones(3)), 0)
    return weights / weights.sum()


def colour(copy: Reduced, occluded: np.ndarray) -> Hypothesis | None:
    """Open where the picture has the commonest colour differences; None where few pixels have."""
    open_ = ground_colour(copy.values, copy.valid, copy.clipped) & ~occluded
    return _disc_on_veil("colour", copy, open_)


def ground_colour(values: np.ndarray, valid: np.ndarray, clipped: np.ndarray) -> np.ndarray:
    """(h, w) pixels of the ground's colour, at least as bright as it."""
    usable = valid & ~clipped
    if not usable.any():
        return valid
    across = values[..., :2] - values[..., 1:]
    bins = np.arange(-1, 1 + COLOUR_BIN, COLOUR_BIN)
    counts, *_ = np.histogram2d(*across[usable].T, bins=[bins, bins])
    i, j = np.unravel_index(counts.argmax(), counts.shape)
    middle = np.array([bins[i], bins[j]]) + COLOUR_BIN / 2
    for _ in range(3):
        near = usable & (np.abs(across - middle).max(-1) < 1.5 * COLOUR_BIN)
        if not near.any():
            break
        middle = np.median(across[near], axis=0)
    open_ = (np.abs(across - middle).max(-1) < COLOUR_WIDTH) | clipped
    mean = values.mean(-1)
    if (open_ & usable).any():
        open_ &= mean > np.quantile(mean[open_ & usable], 0.02) - DARKER
    return open_ & valid


def darkness(copy: Reduced, occluded: np.ndarray) -> Hypothesis | None:
    """Open where the picture is not dark: the lighter of two classes of brightness (k-means)."""
    if not copy.usable.any():
        return None
    mean = copy.values.mean(-1)
    open_ = ((mean > dark_threshold(mean[copy.usable])) | copy.clipped) & copy.valid & ~occluded
    return _disc_on_veil("darkness", copy, open_)


def dark_threshold(brightness: np.ndarray) -> float:
    """The middle between the means of dark and light pixels."""
    centres = np.quantile(brightness, DARK_CENTRES)
    for _ in range(CENTRE_ROUNDS):
        light = brightness > centres.mean()
        if not light.any() or light.all():
            break
        centres = np.array([brightness[~light].mean(), brightness[light].mean()])
    return float(centres.mean())


def _disc_on_veil(name: str, copy: Reduced, open_: np.ndarray) -> Hypothesis | None:
    usable = copy.usable
    if (open_ & usable).mean() < LEAST_SHARE:
        return None
    step = open_.astype(np.float64)
    values = copy.values.mean(-1)
    return Hypothesis(
        name, _maps(step, step), np.array([0, 1]), values, usable, copy.clipped & copy.valid,
        values, (step,), step,
    )  # fmt: skip


def grown(region: np.ndarray) -> np.ndarray:
    """``region`` (h, w) and all pixels that touch it."""
    return np.asarray(ndimage.binary_dilation(region, np.ones((3, 3))))


def _maps(*maps: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.stack(maps), np.float32)
