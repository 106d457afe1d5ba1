"""Which number of samples made a picture? Its taps leave bands, as far apart as they are.

The number is an integer that nothing can be differentiated by, so it is scanned: a few hundred
pixels for every number and the densities about the one that goes with it, exposure and gain solved
for exactly (variable projection), then more pixels for the best few.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from godfit.inference.observation import Picture
from godfit.io.filters import grey
from godfit.io.image import LEVELS
from godfit.models.mitchell import Mitchell, resampled
from godfit.runtime.parallel import cores, parallel_map
from godfit.scattering.radial.spacings_kernel import residual_squares

FEW, MORE, KEEP = 128, 4096, 12
LEAST, MOST = 8, 320
# Densities that are tried for a number, in distances between two taps.
OFFSETS = np.linspace(-1, 1, 9)
# Gain in log-likelihood of MORE values below which no other number is worth a fit.
WORTH = 8.0


class Spacing(NamedTuple):
    """A number of samples and the distance between two taps, of the ray."""

    samples: int
    step: float


class _Scan:
    """Costs of spacings at ``count`` pixels that are not clipped, all else as in ``model``."""

    def __init__(self, model: Mitchell, picture: Picture, count: int, seed: int) -> None:
        decay, density = float(model.decay), float(model.density)
        self.kappa = -model.samples * math.log(max(decay, 1e-12)) / density
        self.drop, self.shows_own = model.convention.drop, model.convention.own_pixel
        u, v = (float(z) for z in np.asarray(model.light)[0])
        self.light = u, v
        pixels = picture.informative(count, seed)
        pixels = pixels[~picture.clipped.reshape(-1)[pixels]]
        h, w = picture.size
        low = picture.mask.shape
        # Its border twice, as the compiled sum has it.
        mask = np.pad(grey(picture.mask), ((1, 1), (1, 2)), mode="edge")
        self.mask = np.ascontiguousarray(mask, np.float32)
        self.size = low
        x = (pixels % w + 0.5) * low[1] / w - 0.5
        y = (pixels // w + 0.5) * low[0] / h - 0.5
        self.at = np.stack([x, y]).astype(np.float32)
        levels = picture.levels.reshape(-1, picture.channels)[pixels].mean(-1)
        self.target = levels.astype(np.float64) / LEVELS

    def costs(self, tried: list[Spacing]) -> np.ndarray:
        """(n,) sums of squares left, exposure and gain free."""
        h, w = self.size[:2]
        u, v = self.light
        parts = np.array_split(np.arange(len(tried)), min(len(tried), 4 * cores()))

        def of(part: np.ndarray) -> np.ndarray:
            steps = np.array([tried[i].step for i in part])
            counts = np.array([tried[i].samples - self.drop for i in part])
            numbers = np.zeros((len(part), 5))
            numbers[:, 0], numbers[:, 1] = u * w - 0.5, (1 - v) * h - 0.5
            numbers[:, 2], numbers[:, 3] = np.exp(-self.kappa * steps), steps
            return residual_squares(
                self.mask, self.at, numbers, counts, self.shows_own, self.target
            )

        return np.concatenate(parallel_map(of, parts))


def other_samples(model: Mitchell, picture: Picture, seed: int = 0) -> Mitchell | None:
    """``model`` with the number of samples that suits the picture best, or None where no other is
    better than its own by more than noise would make it. Of one light and no background."""
    if picture.background is not None or picture.transfer != "none" or model.convention.box:
        return None
    if model.light.shape[0] != 1:
        return None
    few, more = _Scan(model, picture, FEW, seed), _Scan(model, picture, MORE, seed)
    tried = [taps for n in range(LEAST, MOST + 1) for taps in _about(model, n)]
    kept = [tried[i] for i in np.argsort(few.costs(tried), kind="stable")[:KEEP]]
    own = more.costs(_about(model, model.samples)).min()
    left = more.costs(kept)
    best, least = kept[int(left.argmin())], left.min()
    # Rounding is noise as well.
    floor = len(more.target) / 12 / LEVELS**2
    gain = 0.5 * len(more.target) * math.log(max(own, floor) / max(least, floor))
    if gain < WORTH or best.samples == model.samples:
        return None
    other = resampled(model, best.samples)
    density = best.step * best.samples
    decay = math.exp(-few.kappa * best.step)
    return eqx.tree_at(
        lambda m: (m.density, m.decay), other, (jnp.float32(density), jnp.float32(decay))
    )


def _about(model: Mitchell, samples: int) -> list[Spacing]:
    """Spacings for a number of samples about the one whose rays end where the model's do: half a
    step beyond the last tap."""
    drop = model.convention.drop
    end = float(model.density) / model.samples * (model.samples - drop + 0.5)
    step = end / (samples - drop + 0.5)
    steps = np.minimum(step * (1 + OFFSETS / samples), 1 / samples)
    return [Spacing(samples, float(s)) for s in np.unique(steps)]
