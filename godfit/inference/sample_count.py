"""The number of samples, from the spacing of the bands that its taps leave.

The number is an integer, so that nothing can be differentiated by it. It is scanned: a few hundred
pixels are evaluated for every number and for the densities about the one that goes with it, with
exposure and gain solved for exactly (variable projection). The best few get more pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from godfit.inference.observation import Picture
from godfit.io.filters import grey
from godfit.io.image import LEVELS
from godfit.models.mitchell import Mitchell, resampled
from godfit.runtime.parallel import parallel_map
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.parameters import density_reach

SPACING_PIXELS = 128
"""Pixels at which every spacing is evaluated: thousands of spacings limit their number."""
FINE_SPACING_PIXELS = 4096
"""Pixels at which the best spacings are evaluated."""
FINE_SPACINGS = 12
"""Spacings that are evaluated at FINE_SPACING_PIXELS: SPACING_PIXELS do not rank the best ones."""
LEAST_SAMPLES = 8
"""Samples of the coarsest shader that is tried: fewer show their taps one by one."""
FEWEST_SAMPLES = 4
"""Taps of the coarsest shader whose number is named: those of a low preset."""
MOST_SAMPLES = 320
"""Samples of the finest shader that is tried: the scan takes time in proportion."""
SPACINGS_AT_ONCE = 128
"""Spacings of one call: enough that its cost is that of its sums, few enough for all cores."""
RELATIVE_RIDGE = 1e-12
"""Added to the diagonal of the normal equations, relative to its sum: a matrix without an own-pixel
column is singular."""
LEAST_RIDGE = 1e-300
"""The same, absolute, for a mask that is black at all points."""
SPACING_OFFSETS = np.linspace(-1, 1, 9)
"""Densities that are tried for a number of samples, in distances between two taps."""
SAMPLES_GAIN = 8.0
"""Gain in log-likelihood of FINE_SPACING_PIXELS values below which another number is not fitted."""


class Spacing(NamedTuple):
    """A number of samples and the distance between two taps, as a share of the ray."""

    samples: int
    step: float


class _Scan:
    """Costs of spacings at ``count`` pixels, but for those that are clipped, all else as in
    ``model``."""

    def __init__(
        self, model: Mitchell, picture: Picture, count: int, seed: int, own: bool | None = None
    ) -> None:
        decay, density = float(model.decay), float(model.density)
        self.kappa = -model.samples * math.log(max(decay, 1e-12)) / density
        self.drop = model.convention.drop
        self.shows_own = model.convention.own_pixel if own is None else own
        self.light = tuple(float(z) for z in np.asarray(model.light)[0])
        pixels = picture.informative(count, seed)
        h, w = picture.size
        self.mask = np.asarray(grey(picture.mask), np.float32)
        rows, columns = self.mask.shape
        x = (pixels % w + 0.5) * columns / w - 0.5
        y = (pixels // w + 0.5) * rows / h - 0.5
        self.at = np.stack([x, y]).astype(np.float32)
        # Clipped pixels count nothing. Without them each picture would compile its own program.
        self.counted = ~picture.clipped.reshape(-1)[pixels]
        levels = picture.levels.reshape(-1, picture.channels)[pixels].mean(-1)
        self.target = np.where(self.counted, levels, 0).astype(np.float64) / LEVELS

    def costs(self, tried: list[Spacing]) -> np.ndarray:
        """(n,) sums of squared residuals, exposure and gain free."""
        (h, w), (u, v) = self.mask.shape, self.light
        steps = np.array([taps.step for taps in tried])
        ratios = np.exp(-self.kappa * steps)
        place = np.broadcast_to([u * w - 0.5, (1 - v) * h - 0.5], (len(tried), 2))
        rays = np.column_stack([place, ratios, steps, np.zeros(len(tried))]).astype(np.float32)
        counts = np.array([taps.samples - self.drop for taps in tried], np.int32)
        # The mask at the points is the sum over one tap of weight 1 at no distance.
        own_ray = np.array([[*place[0], 1, 0, 0]], np.float32)
        own = self._sums(own_ray, np.ones(1, np.int32))[0] * self.shows_own

        def squares(begin: int) -> np.ndarray:
            block = slice(begin, begin + SPACINGS_AT_ONCE)
            return squares_left(self.target, own, self._sums(rays[block], counts[block]))

        return np.concatenate(parallel_map(squares, range(0, len(tried), SPACINGS_AT_ONCE)))

    def _sums(self, rays: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """(n, points) sums over taps; the last ray is repeated, as another number of rays would
        compile another program."""
        n = len(counts)
        every = np.arange(SPACINGS_AT_ONCE).clip(max=n - 1)
        sums = _sums_of_rays(self.mask, rays[every], counts[every], self.at)
        return np.asarray(sums, np.float64)[:n] * self.counted


def squares_left(
    target: Float[np.ndarray, " points"],
    own: Float[np.ndarray, " points"],
    sums: Float[np.ndarray, "n points"],
) -> Float[np.ndarray, " n"]:
    """Sums of squares that ``own`` and each of the ``sums`` leave of ``target``, both with the
    weights that leave least."""
    aa, ay = own @ own, own @ target
    ab, bb, by = sums @ own, (sums * sums).sum(-1), sums @ target
    ridge = RELATIVE_RIDGE * (aa + bb) + LEAST_RIDGE
    aa, bb = aa + ridge, bb + ridge
    determinant = aa * bb - ab * ab
    own_weight = (bb * ay - ab * by) / determinant
    sum_weight = (aa * by - ab * ay) / determinant
    residuals = target - own_weight[:, None] * own - sum_weight[:, None] * sums
    return (residuals * residuals).sum(-1)


@cached_jit
def _sums_of_rays(mask, rays, counts, at):
    from godfit.scattering.radial.strips import sums_of_rays

    return sums_of_rays(mask, rays, counts, at)


def other_samples(model: Mitchell, picture: Picture, seed: int = 0) -> Mitchell | None:
    """``model`` with the number of samples of the largest likelihood, or None where no other number
    gains more than noise would. For models with one light, for pictures without a background."""
    shader = model.convention
    # The scan has an own pixel that moves with nothing else or none, and one set of taps.
    scanned = shader.plain and (shader.own_scaled or not shader.own) and shader.most_taps is None
    if picture.background is not None or picture.transfer != "none" or not scanned:
        return None
    if model.light.shape[0] != 1:
        return None
    coarse = _Scan(model, picture, SPACING_PIXELS, seed)
    fine = _Scan(model, picture, FINE_SPACING_PIXELS, seed)
    tried = [taps for n in range(LEAST_SAMPLES, MOST_SAMPLES + 1) for taps in _about(model, n)]
    order = np.argsort(coarse.costs(tried), kind="stable")[:FINE_SPACINGS]
    candidates = [tried[i] for i in order]
    own = fine.costs(_about(model, model.samples)).min()
    costs = fine.costs(candidates)
    best, least = candidates[int(costs.argmin())], costs.min()
    # Rounding is noise as well.
    values = int(fine.counted.sum())
    floor = values / 12 / LEVELS**2
    gain = 0.5 * values * math.log(max(own, floor) / max(least, floor))
    if gain < SAMPLES_GAIN or best.samples == model.samples:
        return None
    other = resampled(model, best.samples)
    density = best.step * (best.samples - shader.step_drop)
    decay = math.exp(-coarse.kappa * best.step)
    return eqx.tree_at(
        lambda m: (m.density, m.decay), other, (jnp.float32(density), jnp.float32(decay))
    )


def spacings(model: Mitchell, picture: Picture, seed: int = 0) -> list[tuple[float, Spacing]]:
    """The spacings of the ``FINE_SPACINGS`` best numbers of samples, each with its mean square
    residual in levels, best first; the pixel's own value may have any weight. Empty where the bands
    cannot be scanned: for several lights, a background or a target that is encoded."""
    if picture.background is not None or picture.transfer != "none" or len(model.light) != 1:
        return []
    coarse = _Scan(model, picture, SPACING_PIXELS, seed, own=True)
    fine = _Scan(model, picture, FINE_SPACING_PIXELS, seed, own=True)
    least = FEWEST_SAMPLES + model.convention.drop
    tried = [taps for n in range(least, MOST_SAMPLES + 1) for taps in _about(model, n)]
    numbers: list[int] = []
    for i in np.argsort(coarse.costs(tried), kind="stable"):
        if tried[i].samples not in numbers:
            numbers.append(tried[i].samples)
        if len(numbers) == FINE_SPACINGS:
            break
    candidates = [taps for n in numbers for taps in _about(model, n)]
    costs = fine.costs(candidates) * LEVELS**2 / max(fine.counted.sum(), 1)
    best: dict[int, tuple[float, Spacing]] = {}
    for cost, taps in zip(costs, candidates, strict=True):
        if cost < best.get(taps.samples, (np.inf, taps))[0]:
            best[taps.samples] = float(cost), taps
    return sorted(best.values())


def _about(model: Mitchell, samples: int) -> list[Spacing]:
    """Spacings for a number of samples about the one whose rays end where the model's do: half a
    step beyond the last tap."""
    shader, density = model.convention, float(model.density)
    drop, parts = shader.drop, samples - shader.step_drop
    end = density / (model.samples - shader.step_drop) * (model.samples - drop + 0.5)
    step = end / (samples - drop + 0.5)
    steps = np.minimum(step * (1 + SPACING_OFFSETS / samples), density_reach(density) / parts)
    return [Spacing(samples, float(s)) for s in np.unique(steps)]
