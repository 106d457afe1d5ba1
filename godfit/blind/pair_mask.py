"""The mask of a light pass whose light and numbers are known, in texels of the pass."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage

from godfit.blind.light_pass import LightPass
from godfit.blind.mask_kernel import decide
from godfit.io.filters import shrink
from godfit.io.image import LEVELS

SHARPENED = 6
"""Steps by which the mean over a texel's pixels is corrected for the bilinear read between them:
the error shrinks by a quarter with each."""
HALF_SIZE_ERROR = 3.0
"""Difference, in half-widths of the pixels, between a light pass and its copy of half the size read
bilinearly, up to which it is such a copy. Rounding twice leaves two."""
HALF_SIZE_SHARE = 0.999
"""Share of the pixels that must be as near: an edge of the mask is a few in a thousand."""


@dataclasses.dataclass(frozen=True, eq=False)
class TexelLight:
    """A light pass in texels: ``values`` (h, w, c) in levels; ``sure`` 1 where known, 0 where a
    lower bound, -1 where nothing is known; ``factor`` pixels are a texel."""

    values: np.ndarray
    sure: np.ndarray
    factor: int


def upsampled(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(h, w, c) read bilinearly at the pixels of a picture of ``size``, clamped to the edge."""
    h, w = values.shape[:2]
    rows = (np.arange(size[0]) + 0.5) * h / size[0] - 0.5
    columns = (np.arange(size[1]) + 0.5) * w / size[1] - 0.5
    for axis, at in ((0, rows), (1, columns)):
        at = np.clip(at, 0, values.shape[axis] - 1)
        low = np.minimum(at.astype(int), values.shape[axis] - 2)
        share = (at - low).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        first, second = np.take(values, low, axis), np.take(values, low + 1, axis)
        values = first + share * (second - first)
    return values


def texels_of(light: LightPass, valid: np.ndarray | None) -> TexelLight:
    """The light pass at half its size if that, read bilinearly, is what it shows, else as it is."""
    shown = np.ones_like(light.known) if valid is None else light.known | valid[..., None]
    whole = TexelLight(light.values, np.where(light.known, 1, np.where(shown, 0, -1)), 1)
    h, w = light.size
    small = (h // 2, w // 2)
    if h % 2 or w % 2:
        return whole
    share = shrink(light.known.astype(np.float32), small)
    mean = shrink(light.values.astype(np.float32), small).astype(float)
    values = mean.copy()
    for _ in range(SHARPENED):
        again = shrink(upsampled(values, light.size).astype(np.float32), small)
        values += np.where(share == 1, mean - again, 0)
    near = ndimage.minimum_filter(share, (3, 3, 1)) == 1
    check = light.known & np.repeat(np.repeat(near, 2, 0), 2, 1)
    if not check.any():
        return whole
    error = ((upsampled(values, light.size) - light.values) / np.maximum(light.half, 0.5))[check]
    if np.quantile(np.abs(error), HALF_SIZE_SHARE) > HALF_SIZE_ERROR:
        return whole
    hidden = shrink((whole.sure < 0).astype(np.float32), small) > 0
    # The correction reads the neighbours: beside what is clipped there is a bound alone.
    sure = np.where(near, 1, np.where(hidden, -1, 0))
    return TexelLight(values, sure, 2)


def solved_mask(
    texels: TexelLight, model, start: np.ndarray, levels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The mask (h, w, c) under ``model``, and the light pass that it makes, in levels."""
    h, w, channels = texels.values.shape
    (taps,) = model.taps
    u, v = np.asarray(model.light[0], float)
    place = (u * w - 0.5, (1 - v) * h - 0.5)
    t, c = np.asarray(taps.t, float), np.asarray(taps.c, float)
    packed = (place, float(taps.own), t, c)
    rows, columns = np.divmod(np.arange(h * w), w)
    order = np.argsort((columns - place[0]) ** 2 + (rows - place[1]) ** 2, kind="stable")
    mask, total = np.empty((h, w, channels)), np.empty((h, w, channels))
    for k in range(channels):
        one = np.ascontiguousarray(start[..., min(k, start.shape[-1] - 1)], float)
        light = np.ascontiguousarray(texels.values[..., k]) / LEVELS
        sure = np.ascontiguousarray(texels.sure[..., k])
        total[..., k] = decide(one, light, sure, order, packed, levels)
        mask[..., k] = one
    return mask, total * LEVELS


BOXED_STEPS = 600
"""Steps of the projected gradient on texels of which a bound alone is known."""
NEAR_CLIPPED = 1.5
"""Distance from the light, in that of the farthest clipped texel, up to which texels are near."""
AROUND = 6000
"""Texels about the clipped ones whose light pass decides them, at most."""


def dim_level(mask: np.ndarray, sure: np.ndarray) -> float:
    """The value of the mask where it is open and no light: the most frequent one below a half."""
    shown = mask[(sure == 1) & (mask < 0.5)]
    if not len(shown):
        return 0.0
    count, edges = np.histogram(shown, 100, (0, 0.5))
    # Black texels are as frequent as open ones; what is above them is the background.
    count[:1] = 0
    top = int(count.argmax())
    near = shown[np.abs(shown - (edges[top] + edges[top + 1]) / 2) < 0.01]
    return float(np.median(near)) if count[top] > 0.02 * len(shown) else 0.0


def clipped_texels(texels, k, mask, model, seed=0):
    """Values (h, w) of the mask's channel k, with those that are only bounded solved for: least
    squares, 0 to 1, of the light pass of the known texels about them."""
    from scipy import sparse

    from godfit.scattering.mask_jacobian import PartlyKnownMask, PixelTaps, mask_jacobian

    h, w = mask.shape
    sure = texels.sure[..., k].reshape(-1)
    open_ = np.flatnonzero(sure == 0)
    if not len(open_):
        return mask
    (taps,) = model.taps
    u, v = np.asarray(model.light[0], float)
    place = np.array([u * w - 0.5, (1 - v) * h - 0.5])
    rows, columns = np.divmod(np.arange(h * w), w)
    radius = np.hypot(columns - place[0], rows - place[1])
    reach = radius[open_].max() / max(1 - float(model.density), 0.05)
    pixels = np.flatnonzero((sure == 1) & (radius < reach))
    if len(pixels) > AROUND:
        # The nearest ones resolve the shape, those farther out what tells one radius from another.
        near = pixels[radius[pixels] < NEAR_CLIPPED * radius[open_].max()]
        drawn = np.random.default_rng(seed).permutation(len(pixels))
        near = near[np.random.default_rng(seed).permutation(len(near))[: AROUND // 2]]
        pixels = np.union1d(near, pixels[drawn[: AROUND - len(near)]])
    unknown = np.full(h * w, -1, np.int64)
    unknown[open_] = np.arange(len(open_))
    t = np.concatenate([[0.0], np.asarray(taps.t, float)])
    c = np.concatenate([[float(taps.own)], np.asarray(taps.c, float)])
    known, starts, cols, values = mask_jacobian(
        pixels,
        PixelTaps(place, t, c),
        PartlyKnownMask((h, w), mask.reshape(-1), unknown, len(open_), np.ones(h * w)),
    )
    a = sparse.csr_matrix((values, cols, starts), shape=(len(pixels), len(open_)))
    want = texels.values[..., k].reshape(-1)[pixels] / LEVELS - known
    at = a.T.tocsr()
    # Steps of each texel by what all of them add to its pixels: convergent, and never too short.
    size = np.maximum(at @ (a @ np.ones(len(open_))), 1e-12)
    x = mask.reshape(-1)[open_].astype(float)
    y, last = x.copy(), 1.0
    for _ in range(BOXED_STEPS):
        new = np.clip(y + (at @ (want - a @ y)) / size, 0, 1)
        next_ = (1 + np.sqrt(1 + 4 * last * last)) / 2
        y = new + (last - 1) / next_ * (new - x)
        x, last = new, next_
    out = mask.copy().reshape(-1)
    out[open_] = x
    return out.reshape(h, w)


def mask_under(texels: TexelLight, model, at) -> np.ndarray:
    """The mask (h, w, c) under a ``model``, begun with the disc of a candidate ``at`` where the
    light pass is clipped, and its dim background elsewhere."""
    h, w, channels = texels.values.shape
    rows, columns = np.mgrid[:h, :w]
    away = np.hypot((columns + 0.5) / w - at.u, ((h - rows - 0.5) / h - at.v) * h / w)
    begun = np.where(texels.sure == 0, (away < at.radius)[..., None], at.dim / at.bright)
    begun = begun.astype(float)
    for k in range(channels):
        begun[..., k] = clipped_texels(texels, k, begun[..., k], model)
    return solved_mask(texels, model, begun, np.array([1.0]))[0]


WITHIN_DIM = 1.6
"""Value of the mask, in that of its dim background, up to which a texel is one or black: brighter
ones are a light's."""
INNER_TURNS = 2
"""Turns of clipped and known texels until both agree."""


def labelled_mask(texels: TexelLight, model, begun: np.ndarray, at) -> np.ndarray:
    """The mask (h, w, c) under a ``model``, from one ``begun``, with texels of the dim background
    at its value or black, and no light farther from the light than the disc of ``at`` reaches."""
    mask = begun.copy()
    h, w, channels = mask.shape
    rows, columns = np.mgrid[:h, :w]
    away = np.hypot((columns + 0.5) / w - at.u, ((h - rows - 0.5) / h - at.v) * h / w)
    for _ in range(INNER_TURNS):
        for k in range(channels):
            mask[..., k] = clipped_texels(texels, k, mask[..., k], model)
        mask, _ = solved_mask(texels, model, mask, np.array([1.0]))
        for k in range(channels):
            sure, one = texels.sure[..., k] == 1, mask[..., k]
            dim = dim_level(one, texels.sure[..., k])
            flat = np.where(one > dim / 2, dim, 0.0)
            low = (one <= WITHIN_DIM * dim) | (away > FAR_OFF * at.radius)
            mask[..., k] = np.where(sure & low, flat, one)
    for k in range(channels):
        mask[..., k] = clipped_texels(texels, k, mask[..., k], model)
    return mask


FAR_OFF = 1.5
"""Distance from the light, in radii of its disc, beyond which no texel is a light's."""
