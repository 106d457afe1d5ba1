"""What made a residual without correlation: jittered taps, or rounding between passes.

Jitter moves all taps of a pixel by one random share of a step, so that the residual's size follows
the change of the sum from one tap to the next. Rounding leaves a bounded residual, whose fourth
moment is less than that of noise.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from godfit.errors import Remark
from godfit.inference.diagnostics import Suspect
from godfit.inference.fitted import Found
from godfit.inference.information import MAX_CORRELATION, evidence, misfit
from godfit.inference.noise import SIGMAS, WITHIN_ROUNDING
from godfit.inference.observation import Picture
from godfit.inference.settle import settle
from godfit.io.image import LEVELS
from godfit.io.jpeg import was_jpeg
from godfit.models.mitchell import UNIFORM, Mitchell

SCATTER_PIXELS = 1 << 12
"""Pixels that are compared, at most."""
JITTERS = (0.05, 0.1, 0.15, 0.2, 0.29, 0.4, 0.6)
"""Standard deviations of the jitter that are tried, in steps: 0.29 is that of a whole step."""
WHOLE_STEP = 12**-0.5
"""Standard deviation of a jitter over a whole step."""
FLOOR_LEVELS = 12**-0.5
"""Standard deviation of a rounding, in levels: no residual has less."""
JITTER_ROUNDS = 2
"""Rounds of numbers and jitter in turn: the first residual has bands, which jitter takes away."""
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
    pixels = np.asarray(observation.pixels)
    change = _deviation(model, picture, pixels[known], WHOLE_STEP) / WHOLE_STEP
    squares = residual.astype(np.float64) ** 2

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
    return Jitter(spread, _deviation(model, picture, pixels, spread))


def _deviation(model: Mitchell, picture: Picture, pixels: np.ndarray, spread: float) -> np.ndarray:
    """(n,) standard deviation in levels of the light pass at ``pixels`` by a jitter of ``spread``
    steps."""
    places, weights = UNIFORM
    lags = [spread * place for place in places]
    levels = LEVELS * model.moved_sums(picture.mask, lags, pixels)
    mean = np.average(levels, 0, weights)
    return np.sqrt(np.average((levels - mean) ** 2, 0, weights))


def allowing_for_jitter(found: Found) -> Found | None:
    """The fit settled anew with the noise that jitter makes of each value, where the residual is
    such noise; None where it is not."""
    # Its residual may be correlated: bands that a sum without jitter has and the target has not.
    jitter = jitter_of(found)
    if jitter is None:
        return None
    own, repeats = found.observation.own_noise, found.problem.picture.repeats
    for _ in range(JITTER_ROUNDS):
        model = dataclasses.replace(found.problem.model, jitter=np.float32(jitter.spread))
        problem = found.problem.replaced(model=model)
        noise = np.hypot(jitter.noise, SIGMAS[0] if own is None else np.asarray(own))
        observation = found.observation.with_noise(noise.astype(np.float32))
        settled, tangent = settle(found.settled.coordinates, problem, observation)
        at = evidence(settled, tangent, observation).thinned(repeats)
        found = found.replaced(
            problem=problem, observation=observation, settled=settled, evidence=at
        )
        jitter = jitter_of(found) or jitter
    remark = Remark(jitter.suspect.words, jitter.suspect.name)
    return found.replaced(remarks=(*found.remarks, remark))


def scattered(found: Found) -> Suspect | None:
    """The cause of a residual that is more than rounding and has no correlation; None where it is
    noise as any other."""
    cause = _rounded(found)
    form = misfit(found.evidence.prediction, found.observation)
    if cause is None and _unexplained(found) and form.correlation <= MAX_CORRELATION:
        jitter = jitter_of(found)
        cause = None if jitter is None else jitter.suspect
    return cause


def _unexplained(found: Found) -> bool:
    """Whether the residual is more than rounding, and not of a JPEG."""
    picture = found.problem.picture
    jpeg = picture.half > 0 and was_jpeg(picture.levels[..., 0])
    return found.settled.sigma > WITHIN_ROUNDING and not jpeg


def _rounded(found: Found) -> Suspect | None:
    if not _unexplained(found):
        return None
    sigma, half = found.settled.sigma, found.problem.picture.half
    form = misfit(found.evidence.prediction, found.observation)
    # The residual holds the target's own rounding beside what is left.
    share = sigma**2 / (sigma**2 + (2 * half) ** 2 / 12)
    bounded = 3 + UNIFORM_EXCESS * ((1 - share) ** 2 + BOUNDED * share**2)
    random = form.correlation <= MAX_CORRELATION and sigma <= MOST_ROUNDING
    if random and share > LEAST_SHARE and form.tails < bounded:
        return Suspect(1.0, "rounded", ROUNDED.format(sigma, form.tails))
    return None


def explained(found: Found) -> Found:
    """The fit with a remark on a residual that is rounding, or with the noise that jitter makes
    where that explains it; as it is where the residual is noise as any other."""
    model = found.problem.model
    if isinstance(model, Mitchell) and model.jitter is not None:
        return found
    cause = _rounded(found)
    if cause is not None:
        return found.replaced(remarks=(*found.remarks, Remark(cause.words, cause.name)))
    jittered = allowing_for_jitter(found) if _unexplained(found) else None
    if jittered is None:
        return found
    form = misfit(jittered.evidence.prediction, jittered.observation)
    return jittered if form.like_noise or not _unexplained(jittered) else found
