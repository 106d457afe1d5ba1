"""What made a residual without correlation: jittered taps, or rounding between passes.

Jitter moves all taps of a pixel by one random share of a step, so that the residual's size follows
the change of the sum from one tap to the next. Rounding leaves a bounded residual, whose fourth
moment is less than that of noise.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.errors import Remark
from godfit.inference.diagnostics import Suspect
from godfit.inference.fitted import Found
from godfit.inference.information import MAX_CORRELATION, evidence, misfit
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.observation import Picture
from godfit.inference.settle import settle
from godfit.io.image import LEVELS
from godfit.io.jpeg import was_jpeg
from godfit.models.mitchell import Mitchell
from godfit.scattering.radial import radial_sum

SCATTER_PIXELS = 1 << 12
"""Pixels that are compared, at most."""
JITTERS = (0.05, 0.1, 0.15, 0.2, 0.29, 0.4, 0.6)
"""Standard deviations of the jitter that are tried, in steps: 0.29 is that of a whole step."""
FLOOR_LEVELS = 12**-0.5
"""Standard deviation of a rounding, in levels: no residual has less."""
JITTER_GAIN = 60.0
"""Gain in log-likelihood of SCATTER_PIXELS from which jitter is named: noise that grows with
brightness gains some as well."""
UNIFORM_EXCESS = -1.2
"""Kurtosis of a rounding's error less that of noise, 3."""
BOUNDED = 0.6
"""Share of that by which a residual must be bounded, beyond its own rounding: noise has none of it,
and one rounding more all."""
LEAST_SHARE = 0.4
"""Share of the residual's power beyond its own rounding, at least, for its form to show."""
MOST_ROUNDING = 1.0
"""Noise in levels up to which one rounding more may have caused it: that of a pass whose light is
doubled afterwards, and of a few passes."""

JITTER = "jittered"
"""Name of this cause."""
JITTERED = (
    "the residual grows where the sum changes from one tap to the next, as if taps were jittered "
    "by {:.2g} of a step (standard deviation): numbers are those without the jitter"
)
"""Words with the standard deviation of the jitter in steps."""
ROUNDED = (
    "the residual is bounded as that of rounding is ({:.2g} levels, tails of {:.2g} where noise "
    "has 3): the light pass was rounded to bytes before its last step"
)
"""Words with the noise in levels and the kurtosis."""


class Jitter(NamedTuple):
    """How far the taps of a pixel lie from where they should, ``spread`` (a standard deviation in
    steps), and the ``noise`` (m,) in levels that this makes of each value."""

    spread: float
    noise: np.ndarray

    @property
    def suspect(self) -> Suspect:
        return Suspect(1.0, JITTER, JITTERED.format(self.spread))


def jitter_of(found: Found) -> Jitter | None:
    """Jitter, where it explains the residual's size from pixel to pixel; None where it does not."""
    problem, observation = found.problem, found.observation
    model, picture = problem.at(found.settled.coordinates), problem.picture
    if not isinstance(model, Mitchell) or not model.convention.plain or picture.channels != 1:
        return None
    if picture.mask.shape[:2] != picture.size or picture.transfer != "none":
        return None
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    known = np.flatnonzero(np.isfinite(lo) & np.isfinite(hi))
    if len(known) > SCATTER_PIXELS:
        known = np.sort(np.random.default_rng(0).choice(known, SCATTER_PIXELS, replace=False))
    residual = np.asarray(found.evidence.prediction)[known] - ((lo + hi) / 2)[known]
    every = _change(model, picture, np.asarray(observation.pixels))
    change, squares = every[known], residual.astype(np.float64) ** 2

    def likelihood(jitter: float) -> float:
        # What is left without jitter, if that is more than rounding.
        own = max(float(np.mean(squares)) - float(np.mean((jitter * change) ** 2)), 0.0)
        variance = np.maximum(own, FLOOR_LEVELS**2) + (jitter * change) ** 2
        return float(-0.5 * np.sum(np.log(variance) + squares / variance))

    best = max(JITTERS, key=likelihood)
    if likelihood(best) < likelihood(0.0) + JITTER_GAIN:
        return None
    from scipy.optimize import minimize_scalar

    # Between the neighbours of the best on the list.
    ratio = JITTERS[1] / JITTERS[0]
    found_spread = minimize_scalar(
        lambda spread: -likelihood(spread), bounds=(best / ratio, best * ratio), method="bounded"
    )
    spread = float(found_spread.x)
    return Jitter(spread, np.abs(spread * every).astype(np.float32))


def _change(model: Mitchell, picture: Picture, pixels: np.ndarray) -> np.ndarray:
    """(n,) levels by which the sum changes at ``pixels`` when all taps move by one step."""
    w = picture.size[1]
    places = jnp.asarray(np.stack([pixels % w, pixels // w], -1).astype(np.float32))
    mask = picture.mask if picture.mask.ndim == 2 else picture.mask[..., 0]
    change = np.zeros(len(pixels))
    (taps,) = model.taps
    for light in np.asarray(model.light):
        ends = [
            np.asarray(radial_sum(mask, light, eqx.tree_at(lambda t: t.lag, taps, lag), at=places))
            for lag in (-0.5, 0.5)
        ]
        change += LEVELS * (ends[0] - ends[1])
    return change


def allowing_for_jitter(found: Found) -> Found | None:
    """The fit settled anew with the noise that jitter makes of each value, where the residual is
    such noise; None where it is not."""
    form = misfit(found.evidence.prediction, found.observation)
    jitter = jitter_of(found) if form.correlation <= MAX_CORRELATION else None
    if jitter is None:
        return None
    own = found.observation.own_noise
    noise = jitter.noise if own is None else np.hypot(jitter.noise, np.asarray(own))
    observation = found.observation.with_noise(noise)
    settled, tangent = settle(found.settled.coordinates, found.problem, observation)
    at = evidence(settled, tangent, observation).thinned(found.problem.picture.repeats)
    remark = Remark(jitter.suspect.words, jitter.suspect.name)
    return found.replaced(
        observation=observation, settled=settled, evidence=at, remarks=(*found.remarks, remark)
    )


def scattered(found: Found) -> Suspect | None:
    """The cause of a residual that is more than rounding and has no correlation; None where it is
    noise as any other."""
    sigma, picture = found.settled.sigma, found.problem.picture
    if sigma <= WITHIN_ROUNDING or (picture.half > 0 and was_jpeg(picture.levels[..., 0])):
        return None
    form = misfit(found.evidence.prediction, found.observation)
    if form.correlation > MAX_CORRELATION:
        return None
    # The residual holds the target's own rounding beside what is left.
    share = sigma**2 / (sigma**2 + (2 * picture.half) ** 2 / 12)
    bounded = 3 + UNIFORM_EXCESS * ((1 - share) ** 2 + BOUNDED * share**2)
    if share > LEAST_SHARE and sigma <= MOST_ROUNDING and form.tails < bounded:
        return Suspect(1.0, "rounded", ROUNDED.format(sigma, form.tails))
    jitter = jitter_of(found)
    return None if jitter is None else jitter.suspect


def explained(found: Found) -> Found:
    """The fit with a remark on what scatters its residual, and with the noise that jitter makes;
    as it is where the residual is noise as any other."""
    cause = scattered(found)
    if cause is None:
        return found
    jittered = allowing_for_jitter(found) if cause.name == JITTER else None
    remark = Remark(cause.words, cause.name)
    return jittered or found.replaced(remarks=(*found.remarks, remark))
