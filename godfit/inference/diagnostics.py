"""Why a model cannot be right: known defects, estimated from the residual.

Each possible defect has a direction: the change of the image if the target had that defect and the
model had not. The part that a step of the fitted parameters explains as well is projected out. The
share of the residual's power along the rest is the evidence for the defect (a score test: Rao,
Proc. Camb. Phil. Soc. 44 (1948), 50). A fit whose residual is noise is not diagnosed. The blocks of
a JPEG are found in the target itself, see ``godfit/io/jpeg.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from godfit.inference.observation import Picture, render
from godfit.inference.solver import Tangent
from godfit.io.filters import shrink
from godfit.io.image import LEVELS, decode
from godfit.io.jpeg import was_jpeg
from godfit.models.mitchell import Mitchell
from godfit.scattering.radial.nearest import read_rays

DIAGNOSED_PIXELS = 1 << 12
"""Pixels that the directions are evaluated at, at most: they limit the time."""
LARGEST_SHIFT = 4
"""Pixels by which mask and target may be shifted against each other: every shift is tried."""
NAMED_SHARE = 0.15
"""Share of the residual's power that a defect must explain: chance explains far less."""
SHARE_OF_BEST = 0.6
"""Share of the best defect's evidence from which another is named as well."""
TRANSFER_IMPROVEMENT = 0.7
"""Residual power under the other transfer, relative to that under the given one, at most."""
PARAMETERS_SUFFICE = 1e-6
"""Relative power of a direction below which the parameters explain it: a thousandth of it."""
SECOND_LIGHT_SIDE = 32
"""Pixels a side of the copy on which a second light is searched for: every place is tried."""


class Suspect(NamedTuple):
    """A possible defect: the share of the residual it explains, its name, the warning."""

    share: float
    name: str
    words: str


WORDS = {
    "transfer": "the residual follows brightness as if a gamma-encoded target had been taken as "
    "linear; try --transfer srgb",
    "linear": "the residual follows brightness as if a linear target had been decoded as sRGB; "
    "try --transfer none",
    "register": "the residual follows the picture's edges as if mask and target were shifted "
    "against each other; check that both come from the same frame and size",
    "moved": "mask and target are shifted against each other: with the mask moved {right} pixels "
    "to the right and {down} down far more is explained; check that both come from the same frame",
    "upsampled": "the target is smoother at edges than the mask allows: its light pass was likely "
    "rendered at {scale} of the size; try --pass-scale {scale}",
    "convention": "the residual resembles {what}: the shader has another convention; see `godfit "
    "shaders`",
    "light": "the residual resembles the rays of a second light near ({u:.2f}, {v:.2f}); try "
    "--lights 2",
    "background": "where the background is at the top of its scale the target is brighter than "
    "the clipped background allows; --ignore those pixels",
    "jpeg": "the target has the 8x8 blocks of a JPEG: its errors are correlated, which the quoted "
    "ones allow for; a lossless copy would give smaller errors",
    "unknown": "the residual has structure that none of the known causes explains",
}


def diagnose(picture: Picture, model, pixels: np.ndarray, tangent: Tangent) -> list[Suspect]:
    """Possible defects, the largest share first; empty where nothing is found.

    ``pixels`` (n,) are those of the fit, ``tangent`` the model there: levels (n c,), derivatives
    (p, n c). It is meant for a residual that is not white. Clipped values are left out.
    """
    target = picture.levels.reshape(-1, picture.channels)
    drawn = np.arange(len(pixels))
    if len(drawn) > DIAGNOSED_PIXELS:
        drawn = np.sort(
            np.random.default_rng(0).choice(len(drawn), DIAGNOSED_PIXELS, replace=False)
        )
    at = pixels[drawn]
    c = picture.channels
    prediction = tangent.prediction.reshape(-1, c)
    known = np.ones((len(at), c), bool)
    floor, ceiling = picture.ends
    if np.isfinite(floor) or np.isfinite(ceiling):
        known = (target[at] > floor + picture.half) & (target[at] < ceiling - picture.half)
    rows = np.flatnonzero(known.ravel())
    if len(rows) < 4 * len(tangent.jacobian) + 16:
        return []
    jacobian = tangent.jacobian.reshape(len(tangent.jacobian), -1, c)[:, drawn].reshape(
        len(tangent.jacobian), -1
    )
    full = np.full((picture.size[0] * picture.size[1], c), np.nan, np.float32)
    full[pixels] = prediction
    if np.isnan(full).any():
        full = picture.rendered(model).reshape(-1, c)
    full = full.reshape(*picture.size, c).astype(np.float64)
    residual = (target[at] - prediction[drawn]).ravel()[rows].astype(np.float64)
    span = Span(jacobian[:, rows], residual)

    w = picture.size[1]

    def values(image: np.ndarray) -> np.ndarray:
        image = np.atleast_3d(image)
        return np.broadcast_to(image[at // w, at % w], (len(at), c)).ravel()[rows]

    suspects = [
        _register(picture, full, values, span),
        *_upsampled(picture, full, values, span),
        *_conventions(picture, model, full, values, span),
        *_transfer(picture, target[at].ravel()[rows], values(full), jacobian[:, rows], residual),
        *_background(picture, values, span),
    ]
    if isinstance(model, Mitchell) and not model.convention.composed:
        suspects += _second_light(picture, model, full, pixels, tangent)
    suspects.sort(key=lambda s: -s.share)
    return suspects


def named(suspects: list[Suspect]) -> list[Suspect]:
    """Those worth naming: the one that explains most, and all that explain nearly as much."""
    if not suspects or suspects[0].share < NAMED_SHARE:
        return []
    return [s for s in suspects if s.share >= max(NAMED_SHARE, SHARE_OF_BEST * suspects[0].share)]


class Span:
    """The span of parameter steps (rows of ``jacobian``, (p, m)), projected out of ``residual``
    (m,)."""

    def __init__(self, jacobian: np.ndarray, residual: np.ndarray):
        self.basis = _orthonormal(np.asarray(jacobian, np.float64).T)
        self.residual = self.beyond(residual)
        self.power = float(residual @ residual)

    def beyond(self, values: np.ndarray) -> np.ndarray:
        return values - self.basis @ (self.basis.T @ values)

    def share(self, columns: list[np.ndarray]) -> float:
        """Share of the residual's power that ``columns`` explain beyond the parameters."""
        raw = np.stack(columns, -1).astype(np.float64)
        rest = self.beyond(raw)
        # A direction that parameters reproduce to a thousandth is no evidence.
        raw_power = (raw**2).sum(0)
        rest = rest[:, (rest**2).sum(0) > PARAMETERS_SUFFICE * np.maximum(raw_power, 1e-12)]
        if not rest.shape[1] or self.power == 0:
            return 0.0
        return float(((_orthonormal(rest).T @ self.residual) ** 2).sum() / self.power)

    def step(self, column: np.ndarray) -> float:
        """Coefficient of ``column`` (m,) in the residual's least-squares fit."""
        rest = self.beyond(column.astype(np.float64))
        return float(rest @ self.residual / max(float(rest @ rest), 1e-30))


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """(m, q) basis of the columns' span."""
    size = np.sqrt((columns**2).sum(0))
    columns = columns[:, size > 0] / size[size > 0]
    values, vectors = np.linalg.eigh(columns.T @ columns)
    keep = values > 1e-10 * max(values.max(initial=0), 1e-30)
    return columns @ (vectors[:, keep] / np.sqrt(values[keep]))


def _register(picture, full, values, span):
    """Picture and mask moved by whole pixels, and the shift that explains most."""
    mask = np.broadcast_to(np.atleast_3d(picture.mask), (*picture.mask.shape[:2], full.shape[2]))
    best = 0.0
    for down in range(-LARGEST_SHIFT, LARGEST_SHIFT + 1):
        for right in range(-LARGEST_SHIFT, LARGEST_SHIFT + 1):
            if down == right == 0:
                continue
            columns = [values(np.roll(full, (down, right), (0, 1)) - full)]
            if mask.shape == full.shape:
                columns.append(values(np.roll(mask, (down, right), (0, 1)) - mask))
            best = max(best, span.share(columns))
    return Suspect(best, "register", WORDS["register"])


def _upsampled(picture, full, values, span):
    """The light pass rendered small and enlarged bilinearly, where the model has full size."""
    h, w = picture.size
    if picture.mask.shape[:2] != (h, w):
        return
    from scipy import ndimage

    for factor in (2, 4):
        if min(h, w) < 2 * factor:
            continue
        small = shrink(full, (h // factor, w // factor))
        large = ndimage.zoom(small, (h / small.shape[0], w / small.shape[1], 1), order=1,
                             mode="nearest", grid_mode=True)  # fmt: skip
        column = values(large - full)
        # The coefficient must be near one: the whole change, not a part of its direction.
        if 0.4 < span.step(column) < 2.5:
            words = WORDS["upsampled"].format(scale=1 / factor)
            yield Suspect(span.share([column]), "upsampled", words)


def _conventions(picture, model, full, values, span):
    """Tap at the pixel itself, gain or blend of the background, Sousa's passes."""
    if not isinstance(model, Mitchell):
        return
    whole = picture.mask.shape[:2] == picture.size
    if not model.convention.own and whole and not model.convention.composed:
        words = WORDS["convention"].format(what="the mask itself, a tap at each pixel")
        yield Suspect(span.share([values(picture.mask)]), "convention", words)
    if picture.background is not None:
        back = picture.background
        ray = full / LEVELS - model.convention.background_gain * back
        words = WORDS["convention"].format(what="the background with another gain or blend")
        share = span.share([values(back), values(back * ray)])
        yield Suspect(share, "convention", words)
    if not whole:
        return
    place = np.asarray(model.light)
    others = []
    if model.convention.composed:
        for decay in (1.0, 0.98, 0.95):
            others.append(Mitchell(0.01, decay, 0.9, 1.0, place, "mitchell", 60))
        what = "Mitchell's sum along whole rays"
    else:
        others.append(Mitchell(0.5 / len(place), 1.0, 1.0, 1.0, place, "three"))
        what = "Sousa's short box passes"
    images = [values(render(o, picture.mask, None, picture.size)) for o in others]
    yield Suspect(span.share(images), "convention", WORDS["convention"].format(what=what))


def _transfer(picture, target, prediction, jacobian, residual):
    """The other transfer: whether the span of image and derivatives explains the target better when
    it is decoded the other way. The share is one minus the ratio of the two residual powers."""
    coded = picture.transfer != "none"
    if coded:
        given = decode(target / LEVELS, "srgb")
        slope = np.gradient(decode(np.linspace(0, 1, 256), "srgb"), 1 / 255)
        chain = np.interp(prediction, np.arange(256), slope)
        here = [jacobian * chain[None], decode(np.clip(prediction, 0, LEVELS) / LEVELS, "srgb")]
        other, name = target / LEVELS, "linear"
    else:
        here = [jacobian, prediction]
        given, other, name = target, decode(target / LEVELS, "srgb"), "transfer"
    basis = _orthonormal(np.vstack([here[0], np.asarray(here[1])[None]]).T.astype(np.float64))

    def residual_power(y: np.ndarray) -> float:
        y = np.asarray(y, np.float64)
        rest = y - basis @ (basis.T @ y)
        return float(rest @ rest) / max(float(((y - y.mean()) ** 2).sum()), 1e-30)

    # Relative to the variance, which decoding changes too.
    ratio = residual_power(other) / max(residual_power(given), 1e-30)
    if ratio < TRANSFER_IMPROVEMENT:
        yield Suspect(1 - ratio, name, WORDS[name])


def _background(picture, values, span):
    if picture.background is None:
        return
    top = (picture.background >= 254.5 / 255).astype(np.float32)
    column = values(top)
    if 0.002 < column.mean() < 0.9 and span.step(column) > 1:
        yield Suspect(span.share([column]), "background", WORDS["background"])


def _second_light(picture, model, full, pixels, tangent):
    """Rays of the same shape about each place of a lattice, on a small copy."""
    h, w, c = full.shape
    side = min(SECOND_LIGHT_SIDE, h, w)

    def small(flat: np.ndarray) -> np.ndarray:
        image = np.zeros(h * w, np.float64)
        image[pixels] = flat
        return shrink(image.reshape(h, w), (side, side)).ravel()

    def channelled(flat: np.ndarray) -> np.ndarray:
        return flat.reshape(-1, c).mean(1)

    residual = picture.levels.reshape(-1, c)[pixels].mean(1) - channelled(tangent.prediction)
    if picture.half:
        residual = np.where(picture.clipped.ravel()[pixels], 0, residual)
    coarse = small(residual)
    span = Span(np.stack([small(channelled(row)) for row in tangent.jacobian]), coarse)
    # The power of the whole residual: shares then compare with those of the other directions.
    power = float(residual @ residual) / max(len(pixels), 1) * side * side
    if span.power == 0 or power == 0:
        return
    lattice = (np.arange(14) - 2.5) / 9
    lights = np.stack(np.meshgrid(lattice, lattice), -1).reshape(-1, 2)
    mask = picture.mask if picture.mask.ndim == 2 else picture.mask.mean(-1)
    mask = shrink(mask, (2 * side, 2 * side)).astype(np.float32)
    y, x = np.divmod(np.arange(side * side), side)
    points = np.stack([x, y], -1).astype(np.float32)
    if mask.shape != (2 * side, 2 * side):
        return
    rays = np.asarray(read_rays(mask, lights.astype(np.float32), points), np.float64)
    # The rays have equal steps to the light and end at density.
    steps = rays.shape[1]
    t = (np.arange(steps) + 0.5) / steps
    kappa = -model.samples * np.log(max(float(model.decay), 1e-6)) / max(float(model.density), 1e-3)
    best = Suspect(0.0, "light", "")
    for k in (0.0, kappa, 2 * kappa + 1):
        weights = np.exp(-min(k, 40.0) * t) * (t <= max(float(model.density), 0.3))
        images = np.einsum("s,lsp->lp", weights, rays)
        rest = images - (images @ span.basis) @ span.basis.T
        size = (rest**2).sum(1)
        fits = rest @ span.residual
        good = (fits > 0) & (size > 1e-4 * (images**2).sum(1))
        share = np.where(good, fits**2 / np.maximum(size, 1e-30), 0) / max(power, 1e-30)
        i = int(np.argmax(share))
        if share[i] > best.share:
            words = WORDS["light"].format(u=lights[i, 0], v=lights[i, 1])
            best = Suspect(float(min(share[i], 1.0)), "light", words)
    yield best


def jpeg(picture: Picture) -> Suspect | None:
    """The warning of a JPEG, where the target has its 8x8 blocks."""
    if picture.half == 0 or not was_jpeg(picture.levels[..., 0]):
        return None
    return Suspect(1.0, "jpeg", WORDS["jpeg"])
