"""Fits to a JPEG: what compression did to the answer is found by compressing once more.

JPEG smooths edges and rounds the cosines of whole blocks (ITU-T T.81). What it leaves is no noise:
an estimate made as if it were is off in one direction, by many of its errors. But compression is
known: the fitted picture, compressed as the target was, and fitted in the same way, is off by as
much. That is taken away (indirect inference: Gourieroux, Monfort & Renault, J. Appl. Econometrics 8
(1993), S85), and pictures from points around scatter as the answer does (parametric bootstrap). The
quality is the one at which the target, compressed again, stays as it is (Farid, IEEE Trans. Inf.
Forensics Secur. 4 (2009), 154).
"""

from __future__ import annotations

import dataclasses
import io

import jax.numpy as jnp
import numpy as np
from PIL import Image
from scipy.stats import norm, t

from godfit.blocks import was_jpeg
from godfit.inference import evidence
from godfit.observation import LEVELS
from godfit.search import WITHIN_ROUNDING, Tangent
from godfit.solver import linearise, solve_tangent
from godfit.verdict import Found

QUALITIES = range(30, 101)
# Colour at full and at half resolution, as Pillow numbers them.
SUBSAMPLINGS = (0, 2)
# Levels, in the mean, by which a picture changes at most that is compressed as it was before, and
# the most that this is of what qualities two apart change; tables of neighbours nearly agree.
SAME, TELLING = 0.15, 0.55
# Pictures compressed for each correction, the first of them of points so far away, in the
# coordinates' scales.
DRAWS, FIRST, AWAY = 18, 5, 0.02
CORRECTIONS = 8
# Of what those pictures differ among themselves, the most by which the answer's may differ from the
# target.
ALIKE = 0.65


def compressed(levels: np.ndarray, quality: int, subsampling: int) -> np.ndarray:
    """(h, w, c) levels, rounded, after a JPEG."""
    data = np.floor(levels + 0.5).clip(0, LEVELS).astype(np.uint8)
    file = io.BytesIO()
    picture = Image.fromarray(data[..., 0] if data.shape[2] == 1 else data)
    picture.save(file, "JPEG", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(file), np.float32).reshape(levels.shape)


def settings_of(levels: np.ndarray) -> tuple[int, int] | None:
    """Quality and subsampling of the JPEG that ``levels`` (h, w, c) were; None if they were none,
    or of another maker's tables."""
    found = []
    for subsampling in SUBSAMPLINGS[: 1 if levels.shape[2] == 1 else 2]:
        changes = [
            float(np.abs(compressed(levels, quality, subsampling) - levels).mean())
            for quality in QUALITIES
        ]
        for before, change, after, quality in zip(
            changes, changes[2:], changes[4:], QUALITIES[2:], strict=False
        ):
            if change < min(SAME, TELLING * before, TELLING * after):
                found.append((change, quality, subsampling))
    return min(found)[1:] if found else None


def corrected(found: Found) -> Found:
    """The fit with what compression did to it taken away, and with the scatter that it causes; as
    it was where the target is no JPEG whose settings are known, or where the fitted picture,
    compressed, is another than the target."""
    picture, settled = found.picture, found.settled
    if picture.half == 0 or settled.sigma <= WITHIN_ROUNDING or not found.free.any():
        return found
    if not was_jpeg(picture.levels[..., 0]):
        return found
    settings = settings_of(picture.levels)
    if settings is None:
        return found
    bounds = [np.asarray(b, np.float64) for b in found.model.bounds()]
    first = settled.coordinates.astype(np.float64)
    z, errors, apart = first, np.zeros((0, len(first))), 0.0
    for _ in range(CORRECTIONS):
        estimate, errors, apart = _simulated(found, z, settings)
        before, z = z, np.where(found.free, np.clip(estimate - errors.mean(0), *bounds), first)
        if np.all(np.abs(z - before) <= errors.std(0)):
            break
    else:
        return found
    off = _compressed_at(found, z, settings) - picture.levels
    if np.sqrt(np.mean(off[picture.valid] ** 2)) > ALIKE * max(apart, 2 * WITHIN_ROUNDING):
        return found
    tangent = _tangent(found, z)
    settled = settled._replace(coordinates=z.astype(np.float32), quiet=True)
    at = evidence(settled, tangent, found.seen)
    # So few draws leave their own covariance in doubt, and the mean that was taken away.
    count = len(errors)
    wider = (t.ppf(0.975, count - 1) / norm.ppf(0.975)) ** 2 * (1 + 1 / count)
    scatter = wider * np.atleast_2d(np.cov(errors.T))
    return dataclasses.replace(found, settled=settled, at=at, scatter=scatter)


def _tangent(found: Found, z: np.ndarray) -> Tangent:
    at = z.astype(np.float32)
    scale = found.model.scales(at)
    prediction, jacobian = linearise(at, found.held, scale, found.model, found.seen)
    return Tangent(np.asarray(prediction), np.asarray(jacobian), scale)


def _compressed_at(found: Found, z: np.ndarray, settings: tuple[int, int]) -> np.ndarray:
    """(h, w, c) the picture of coordinates ``z``, compressed; the target's where it is ignored."""
    picture = found.picture
    model = found.model.moved(jnp.asarray(z, jnp.float32), jnp.asarray(found.held, jnp.float32))
    levels = np.where(picture.valid[..., None], picture.rendered(model), picture.levels)
    return compressed(levels, *settings)


def _simulated(
    found: Found, z: np.ndarray, settings: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, float]:
    """(p,) the estimate from the target on the tangent at ``z``, (draws, p) by how much such
    estimates from compressed pictures of points around ``z`` are off, and the root mean square
    (levels) by which two such pictures differ but for what their points make them."""
    tangent, free = _tangent(found, z), np.flatnonzero(found.free)
    rng = np.random.default_rng(0)
    errors: list[np.ndarray] = []
    left: list[np.ndarray] = []
    pixels = np.asarray(found.seen.pixels)
    centre = z.astype(np.float32)

    def estimate(lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
        return solve_tangent(
            centre, found.free, found.model, tangent.scale, tangent.prediction, tangent.jacobian,
            lo, hi, found.settled.sigma, found.seen.foreign,
        ).coordinates  # fmt: skip

    for draw in range(DRAWS):
        step = np.zeros(len(z))
        if draw < FIRST:
            step[free] = AWAY * rng.standard_normal(len(free))
        else:
            block = np.atleast_2d(np.cov(np.array(errors)[:, free].T))
            step[free] = rng.multivariate_normal(np.zeros(len(free)), block, check_valid="ignore")
        there = np.clip(z + step * tangent.scale, *found.model.bounds())
        levels = _compressed_at(found, there, settings).reshape(-1, found.picture.channels)[pixels]
        lo, hi = (levels - 0.5).ravel(), (levels + 0.5).ravel()
        lo, hi = np.where(lo < 0, -np.inf, lo), np.where(hi > LEVELS, np.inf, hi)
        end = estimate(lo.astype(np.float32), hi.astype(np.float32))
        errors.append((end - there) / tangent.scale)
        left.append(levels.ravel() - tangent.moved(there - z))
    spread = float(np.sqrt(np.mean((np.array(left) - np.mean(left, 0)) ** 2) * DRAWS / (DRAWS - 1)))
    own = estimate(np.asarray(found.seen.lo), np.asarray(found.seen.hi))
    return own.astype(np.float64), np.array(errors) * tangent.scale, np.sqrt(2) * spread
