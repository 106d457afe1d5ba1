"""The images in the form that a fit works on: numbers at chosen pixels, in 8-bit levels."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.io.filters import blurred, blurred_at, over_channels, shrink, smoothed
from godfit.io.image import LEVELS, Image, encode
from godfit.models.base import AbstractModel
from godfit.runtime.device import on_device
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.upsample import Texels, is_larger

SEARCH_SIZE = 1024
"""Pixels a side to which larger pictures are reduced for the search: coordinates do not depend on
the size."""
SLOPES_SIZE = 256
"""Pixels a side of the copy whose gradients choose pixels: rounding hides slopes on a finer one."""
CLIPPED = ("above", "clipped", "readable")
"""Properties that depend on a picture's levels alone, and not on its mask."""
PIXEL_DRAWS = 4
"""Draws of informative pixels before the rest is filled up at random."""
REPEATED_LINES = 4
"""Times that a picture's lines repeat, at least, to count: a few equal lines at an edge are
ordinary."""
BLUR_CLIPPED_SHARE = 0.01
"""Share of clipped pixels under the blur from which a blurred value is not used."""


GPU, EXACT = "gpu", "exact"
ARITHMETICS = (GPU, EXACT)
"""How a target was computed: by the shader in the arithmetic of a GPU, or to rounding."""
PLATEAU_PIXELS = 16
"""Pixels that share the largest level, at least, for it to be a plateau: fewer agree by chance."""
PLATEAU_SHARE = {True: 2e-4, False: 1e-2}
"""The same as a share of the picture, at the top and at the bottom: a small light may be clipped,
while black that was lifted is where most of the picture is dark."""


class Observation(eqx.Module):
    """Intervals [lo, hi) in levels for ``pixels`` (row-major indices) of a ``size`` image, channel
    by channel, and what a model needs to predict them."""

    mask: Float[Array, "h w"] | Float[Array, "h w c"]
    background: Float[Array, "..."] | None
    pixels: Int[Array, " n"]
    lo: Float[Array, " m"]
    hi: Float[Array, " m"]
    size: tuple[int, int] = eqx.field(static=True)
    channels: int = eqx.field(static=True)
    transfer: str = eqx.field(static=True)
    # Whether the pixels are all of the image, in their order: then no index is needed.
    whole: bool = eqx.field(static=True)
    # Share of pixels that may be of any level, see ``likelihood.py``.
    foreign: float = eqx.field(static=True, default=0.0)
    # The texels that the pixels read of a light pass smaller than the picture, if they are few.
    texels: Texels | None = None
    # Noise of each value in levels beside the common one, None without: ``allowances``.
    own_noise: Float[Array, " m"] | None = None
    # The part of it in levels that the values of a column share (even rows of the array), and those
    # of a row of pixels (odd ones): one draw serves them all. None without.
    shared_noise: Float[np.ndarray, "lines m"] | None = None

    def predict(self, model: AbstractModel) -> Float[Array, " m"]:
        """Levels of the model's image before rounding, (pixels x channels,)."""
        some = None if self.whole else self.pixels
        # Models without a smaller light pass have no argument for its texels.
        texels = {} if self.texels is None else {"texels": self.texels}
        image = model(self.mask, self.background, size=self.size, pixels=some, **texels)
        image = image.reshape(self.pixels.shape[0], -1)
        image = jnp.broadcast_to(image, (self.pixels.shape[0], self.channels))
        return LEVELS * encode(image, self.transfer).reshape(-1)

    def only(self, rows: np.ndarray) -> Observation:
        """The observation of those pixels that are in ``rows``."""
        pixels = np.asarray(self.pixels)[rows]
        values = (np.asarray(rows)[:, None] * self.channels + np.arange(self.channels)).reshape(-1)
        own = [] if self.own_noise is None else [self.own_noise]
        lo, hi, *own = (
            np.asarray(z).reshape(-1, self.channels)[rows].reshape(-1)
            for z in (self.lo, self.hi, *own)
        )
        return dataclasses.replace(
            self,
            pixels=on_device(pixels),
            lo=on_device(lo),
            hi=on_device(hi),
            whole=False,
            texels=_texels(pixels, self.size, np.asarray(self.mask)),
            own_noise=on_device(own[0]) if own else None,
            shared_noise=None if self.shared_noise is None else self.shared_noise[:, values],
        )

    def with_noise(
        self, own_noise: np.ndarray | None, shared_noise: np.ndarray | None = None
    ) -> Observation:
        """The same values with their own noise (m,) in levels, of which columns and rows share
        ``shared_noise`` (lines, m), or without."""
        if own_noise is None and self.own_noise is None:
            return self
        own = None if own_noise is None else on_device(own_noise)
        return dataclasses.replace(self, own_noise=own, shared_noise=shared_noise)

    def with_mask(self, mask: np.ndarray) -> Observation:
        """The same pixels of the same picture under another mask, of any size."""
        texels = _texels(np.asarray(self.pixels), self.size, mask)
        return dataclasses.replace(self, mask=on_device(mask), texels=texels)


@dataclass(frozen=True, eq=False)
class Picture:
    """Target, mask and background, reduced to the channels that differ.

    ``levels`` (h, w, c) is the target in 8-bit levels of its own encoding, ``half`` half the
    distance between two of its levels (0 for floats), ``valid`` (h, w) is False where the user
    excluded pixels. ``mask`` (h', w') or (h', w', c) and ``background`` (h, w, c) or None are
    linear. ``foreign`` is the share of pixels that may be of any level. ``rounding`` are levels
    below and above each value, (h, w, c), within which the true one lies, where that is not
    ``half`` everywhere. ``floor`` and ``ceiling``
    are the levels at which the target was clipped: None stands for the ends of the scale of a
    target with levels, and for none of a target of floats. ``arithmetic`` is one of ARITHMETICS,
    that of the program that drew the target. ``texel_variance`` has the shape of the mask: the
    variance of each of its texels, where they are not known as they are given.
    """

    levels: np.ndarray
    half: float
    valid: np.ndarray
    mask: np.ndarray
    background: np.ndarray | None
    transfer: str
    foreign: float = 0.0
    floor: float | None = None
    ceiling: float | None = None
    rounding: tuple[np.ndarray, np.ndarray] | None = None
    arithmetic: str = EXACT
    texel_variance: np.ndarray | None = None

    @staticmethod
    def make(
        target: Image,
        mask: np.ndarray,
        background: np.ndarray | None,
        valid: np.ndarray | None,
        channels: int = 1,
    ) -> Picture:
        """Channels that agree in target, mask and background are kept once, but for a model that
        has ``channels`` of its own."""
        encoded, grey_target = _grey(target.encoded)
        mask, grey_mask = _grey(mask)
        if background is not None:
            background, grey_background = _grey(background)
            grey_target &= grey_background
        channels = channels if grey_mask and grey_target else 3
        size = target.values.shape[:2]
        levels = np.broadcast_to(np.atleast_3d(encoded), (*size, channels)) * np.float32(LEVELS)
        if background is not None:
            background = np.broadcast_to(np.atleast_3d(background), levels.shape)
        if valid is None:
            valid = np.ones(levels.shape[:2], bool)
        half = 0.0 if target.quantum is None else target.quantum * LEVELS / 2
        rounding = None
        if target.rounding is not None and target.transfer == "none":
            below, above = (
                np.broadcast_to(np.atleast_3d(z)[..., :channels], levels.shape) * np.float32(LEVELS)
                for z in target.rounding
            )
            rounding = below, above
        # A GPU writes bytes; other depths come from programs that compute in full precision.
        bytes_of_gpu = target.quantum == 1 / LEVELS and not target.exact
        return Picture(
            levels, half, valid, mask, background, target.transfer, rounding=rounding,
            arithmetic=GPU if bytes_of_gpu else EXACT,
        )  # fmt: skip

    @functools.cached_property
    def small(self) -> Picture:
        """The picture averaged down to at most SEARCH_SIZE pixels a side, itself if it is."""
        return self.shrunk(-(-max(self.size) // SEARCH_SIZE))

    def shrunk(self, factor: int) -> Picture:
        """The picture averaged over cells of ``factor`` x ``factor`` pixels."""
        if factor == 1:
            return self

        def smaller(image: np.ndarray) -> np.ndarray:
            h, w = (max(1, n // factor) for n in image.shape[:2])
            return shrink(image, (h, w))

        # A cell with a channel that is clipped in part has a meaningless mean.
        clipped = smaller(self.above.astype(np.float32))
        whole = over_channels(np.logical_and, (clipped == 0) | (clipped == 1))
        valid = (smaller(self.valid.astype(np.float32)) == 1) & whole
        return dataclasses.replace(
            self,
            levels=smaller(self.levels),
            valid=valid if valid.any() else np.ones_like(valid),
            mask=smaller(self.mask),
            background=None if self.background is None else smaller(self.background),
            rounding=None if self.rounding is None else tuple(map(smaller, self.rounding)),
            texel_variance=None,
        )

    @property
    def size(self) -> tuple[int, int]:
        return self.levels.shape[0], self.levels.shape[1]

    def pass_size(self, model: AbstractModel) -> tuple[int, int]:
        """(h, w) of the light pass: a larger mask is read by a pass of the picture's size."""
        low = self.mask.shape[0], self.mask.shape[1]
        return self.size if model.reads_between or is_larger(low, self.size) else low

    def independent(self, model: AbstractModel) -> float:
        """Share of the pixels that are independent: those of an upsampled pass share its texels."""
        return float(np.prod(self.pass_size(model)) / np.prod(self.size))

    @property
    def channels(self) -> int:
        return self.levels.shape[-1]

    def with_mask(self, mask: np.ndarray) -> Picture:
        """The same picture under another mask, of any size, whose texels are known."""
        other = dataclasses.replace(self, mask=mask, texel_variance=None)
        # These depend on the levels alone and are computed once.
        vars(other).update({name: getattr(self, name) for name in CLIPPED})
        return other

    @property
    def ends(self) -> tuple[float, float]:
        """Levels at which a value means "at most" and "at least"; infinite where there is none."""
        floor, ceiling = (0.0, LEVELS) if self.half > 0 else (-np.inf, np.inf)
        return (
            floor if self.floor is None else self.floor,
            ceiling if self.ceiling is None else self.ceiling,
        )

    def intervals(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, c) bounds of the values behind ``pixels``; one-sided where the target was clipped."""
        t = self.levels.reshape(-1, self.channels)[pixels]
        floor, ceiling = self.ends
        below = above = np.float32(self.half)
        if self.rounding is not None:
            below, above = (z.reshape(-1, self.channels)[pixels] for z in self.rounding)
        elif self.half == 0 and not np.isfinite(ceiling) and not np.isfinite(floor):
            return t, t
        lo = np.where(self._at_floor(t), -np.inf, t - below)
        hi = np.where(self._at_ceiling(t), np.inf, t + above)
        return lo.astype(np.float32), hi.astype(np.float32)

    def _at_floor(self, levels: Any) -> Any:
        floor = self.ends[0]
        return levels < floor + self.half if self.half > 0 else levels <= floor

    def _at_ceiling(self, levels: Any) -> Any:
        return levels >= self.ends[1] - self.half

    def plateau(self, top: bool) -> tuple[float, int] | None:
        """The largest level (the smallest where not ``top``) and how many valid pixels share it;
        None where they are few, or where it is the end of the scale in any case."""
        shown = self.levels[self.valid]
        if not shown.size:
            return None
        level = float(shown.max() if top else shown.min())
        known = self._at_ceiling if top else self._at_floor
        # No model goes below black.
        if known(np.float32(level)) or (not top and level <= 0):
            return None
        count = int(np.count_nonzero((shown == level).any(-1)))
        return (
            (level, count)
            if count >= max(PLATEAU_PIXELS, PLATEAU_SHARE[top] * len(shown))
            else None
        )

    @functools.cached_property
    def above(self) -> np.ndarray:
        """(h, w, c): values at the level from which the target was clipped."""
        return self._at_ceiling(self.levels)

    @functools.cached_property
    def clipped(self) -> np.ndarray:
        """(h, w): pixels at the top of the scale in some channel."""
        return over_channels(np.logical_or, self.above)

    @functools.cached_property
    def glare(self) -> np.ndarray:
        """(h, w): pixels at the top of the scale in every channel."""
        return over_channels(np.logical_and, self.above)

    @functools.cached_property
    def readable(self) -> np.ndarray:
        """(h, w): valid pixels that are not at the top of the scale in every channel."""
        return self.valid & ~self.glare

    @functools.cached_property
    def repeats(self) -> float:
        """How many times each line of the picture is repeated. A line of pixels that equals the
        line before it in target, mask and background is no new information. 1 for most pictures."""
        images = [self.levels, self.mask, *([] if self.background is None else [self.background])]
        largest = 1.0
        for axis in (0, 1):
            fresh = 1
            for image in images:
                lines = np.moveaxis(image, axis, 0)
                others = tuple(range(1, image.ndim))
                changed = np.count_nonzero((lines[1:] != lines[:-1]).any(others))
                fresh = max(fresh, changed + 1)
            largest = max(largest, self.size[axis] / fresh)
        return largest if largest >= REPEATED_LINES else 1.0

    def observe(self, pixels: np.ndarray, blur: float = 0.0) -> Observation:
        """The picture at ``pixels``; with ``blur`` (pixels, the standard deviation of a Gaussian),
        of target and mask both blurred; values with clipped neighbours then have no bounds."""
        mask, background = self.mask, self.background
        if blur == 0:
            lo, hi = self.intervals(pixels)
        else:
            smooth = blurred_at(self.levels, blur, pixels)
            lo, hi = smooth - max(self.half, 0.5), smooth + max(self.half, 0.5)
            if self.clipped.any():
                near = self._share_clipped(pixels, round(2 * blur))[:, None] > BLUR_CLIPPED_SHARE
                lo, hi = np.where(near, -np.inf, lo), np.where(near, np.inf, hi)
            lo, hi = lo.astype(np.float32), hi.astype(np.float32)
            mask = blurred(mask, blur * mask.shape[0] / self.size[0])
            background = None if background is None else blurred(background, blur)
        return Observation(
            on_device(mask),
            None if background is None else on_device(background),
            on_device(pixels, np.int32),
            on_device(lo.reshape(-1)),
            on_device(hi.reshape(-1)),
            self.size,
            self.channels,
            self.transfer,
            bool(np.array_equal(pixels, np.arange(self.size[0] * self.size[1]))),
            self.foreign,
            _texels(pixels, self.size, mask),
        )

    def _share_clipped(self, pixels: np.ndarray, reach: int) -> np.ndarray:
        """(n,) share of clipped pixels among those within ``reach`` of ``pixels``."""
        h, w = self.size
        row, column = pixels // w, pixels % w
        top, bottom = np.maximum(row - reach, 0), np.minimum(row + reach + 1, h)
        left, right = np.maximum(column - reach, 0), np.minimum(column + reach + 1, w)
        table = self._clipped_table
        count = table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left]
        return count / ((bottom - top) * (right - left))

    @functools.cached_property
    def _clipped_table(self) -> np.ndarray:
        """(h + 1, w + 1) clipped pixels above and to the left."""
        counts = self.clipped.cumsum(0, dtype=np.int32).cumsum(1, dtype=np.int32)
        return np.pad(counts, ((1, 0), (1, 0)))

    def rendered(self, model: AbstractModel) -> np.ndarray:
        """(h, w, c) levels of the model's whole image, clipped as the target is, not rounded."""
        back = None if self.background is None else on_device(self.background)
        image = np.atleast_3d(np.asarray(_image(model, on_device(self.mask), back, self.size)))
        levels = LEVELS * np.asarray(encode(np.maximum(image, 0), self.transfer))
        levels = np.broadcast_to(np.clip(levels, *self.ends), self.levels.shape)
        return levels.astype(np.float32)

    def informative(self, count: int, seed: int) -> np.ndarray:
        """Sorted indices of ``count`` valid pixels: half at random, half where the target varies,
        since pixels of flat areas repeat each other."""
        if (count, seed) not in self._chosen:
            self._chosen[count, seed] = self._informative(count, seed)
        return self._chosen[count, seed]

    @functools.cached_property
    def _chosen(self) -> dict[tuple[int, int], np.ndarray]:
        return {}

    def _informative(self, count: int, seed: int) -> np.ndarray:
        candidates = np.flatnonzero(self.valid)
        if len(candidates) <= count:
            return candidates
        rng = np.random.default_rng(seed)
        chosen = candidates[rng.choice(len(candidates), count // 2, replace=False, shuffle=False)]
        (h, w), (rows, columns) = self.size, self._slopes.shape
        below = np.cumsum(self._slopes, dtype=np.float64)
        for _ in range(PIXEL_DRAWS if below[-1] > 0 else 0):
            # A cell where the target varies, then a pixel in it; pixels drawn before are skipped.
            some = rng.random((3, 2 * count))
            cell = np.searchsorted(below, below[-1] * some[0], side="right")
            row = ((cell // columns + some[1]) * h / rows).astype(int)
            pixel = row * w + ((cell % columns + some[2]) * w / columns).astype(int)
            pixel = pixel[self.valid.reshape(-1)[pixel]]
            found, first = np.unique(np.concatenate([chosen, pixel]), return_index=True)
            chosen = found[np.argsort(first)][:count]
            if len(chosen) == count:
                return np.sort(chosen)
        rest = np.setdiff1d(candidates, chosen, assume_unique=True)
        more = rng.choice(len(rest), count - len(chosen), replace=False, shuffle=False)
        return np.sort(np.concatenate([chosen, rest[more]]))

    @functools.cached_property
    def _slopes(self) -> np.ndarray:
        """How much the target varies, 0 where all of it is clipped, on a copy of SLOPES_SIZE at
        most."""
        small = self.shrunk(-(-max(self.size) // SLOPES_SIZE))
        if min(small.size) < 2:
            return np.zeros(small.size, np.float32)
        # Differences over a few pixels resolve slopes that single levels hide.
        bright = np.minimum(small.levels.mean(-1), min(LEVELS, small.ends[1]) - 1)
        down, along = np.gradient(smoothed(bright, 1.0))
        return np.where(over_channels(np.logical_and, small.above), 0, np.hypot(down, along))


def _texels(pixels: np.ndarray, size: tuple[int, int], mask: np.ndarray) -> Texels | None:
    low = mask.shape[0], mask.shape[1]
    return None if low == size or is_larger(low, size) else Texels.of(pixels, size, low)


def render(
    model: AbstractModel, mask: np.ndarray, background: np.ndarray | None, size: tuple[int, int]
) -> np.ndarray:
    """The model's image, (h, w) or (h, w, 3), linear, clamped to [0, 1]."""
    back = None if background is None else on_device(background)
    return np.clip(np.asarray(_image(model, on_device(mask), back, size)), 0, 1)


@cached_jit
def _image(model, mask, background, size):
    return model(mask, background, size=size)


def _grey(image: np.ndarray) -> tuple[np.ndarray, bool]:
    """The image without channels where they agree, and whether they do."""
    if image.ndim == 2:
        return image, True
    if all(np.array_equal(image[..., 0], image[..., c]) for c in (1, 2)):
        # A copy, so that the channels that are not needed do not stay in memory.
        return image[..., 0].copy(), True
    return image, False
