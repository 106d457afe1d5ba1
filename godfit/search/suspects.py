"""What may be wrong with the images of a fit whose residual is no noise, tried one by one.

Each suspect is a small change of target or mask, under which the picture is searched anew on a few
thousand pixels. The one that leaves the least noise is named, if that is far less than what the
images as they are leave. The changes keep the shapes of all arrays, so that nothing is compiled.

Noise is always that of the target's own levels, whatever the change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from godfit.inference import diagnostics
from godfit.inference.fitted import Found
from godfit.inference.noise import WITHIN_ROUNDING, best_sigma
from godfit.inference.observation import Picture
from godfit.inference.problem import SEARCH_PIXELS
from godfit.inference.settle import Settled, settle
from godfit.inference.strategy import Report
from godfit.io.filters import shrink
from godfit.io.image import LEVELS, decode, encode
from godfit.io.sources import FLIPS
from godfit.models.mitchell import Mitchell
from godfit.search import multigrid
from godfit.search.scatter import scattered

REMEDIED = 0.5
"""Share of the noise that a change must leave at most to be named."""
TONE_CURVES = ("srgb", "reinhard", "aces", "aces-hill", "filmic")
"""Transfers that are tried, the tone curves also with sRGB after them."""
BLURS = (0.7, 1.0, 1.5, 2.0, 3.0)
"""Standard deviations in pixels of the Gaussian that the target may have been blurred with."""
CORRECTIONS = 3
"""Corrections of a target for what was done to it after the light pass: each brings the rendering,
and so the next correction, closer."""
BLOCKS = (2, 3, 4)
"""Sides in pixels of the equal blocks that enlarging by nearest neighbour leaves."""
EQUAL_BLOCKS = 0.999
"""Share of a target's blocks of equal pixels from which it was enlarged so."""
EQUAL_ANYWHERE = 0.9
"""The same share with the blocks moved by a pixel, at most: flat areas are equal anywhere."""
GAIN_CHANGE = 0.02
"""Change of the background's gain from which it is another."""
DARK_REST = 0.05
"""Least share of light that a background lets through for a screen blend to be undone."""
GREY = 0.01
"""Difference of a light's channels, as a share, up to which it is grey."""

Starts = Callable[[Picture], list[np.ndarray]]
"""Starting points for a picture."""


class Suspect(NamedTuple):
    """One possible change: a ``code``, the ``words`` with the option that makes it, the changed
    ``picture``, and the ``transfer`` that it was decoded with, "none" where its levels are those of
    the target."""

    code: str
    words: str
    picture: Picture
    transfer: str = "none"


class Tried(NamedTuple):
    """A suspect with the noise that it leaves."""

    sigma: float
    suspect: Suspect


def flipped(picture: Picture, axes: tuple[int, ...]) -> Picture:
    """The picture with target and background turned over, and the mask as it is."""

    def turn(image):
        return np.ascontiguousarray(np.flip(image, axes))

    back, rounding = picture.background, picture.rounding
    return dataclasses.replace(
        picture,
        levels=turn(picture.levels),
        valid=turn(picture.valid),
        background=None if back is None else turn(back),
        rounding=None if rounding is None else (turn(rounding[0]), turn(rounding[1])),
    )


def decoded(picture: Picture, transfer: str) -> Picture:
    """The picture as if its levels had been encoded with ``transfer``: linear levels, each with the
    interval that its rounding leaves."""
    below, above = (np.float32(picture.half),) * 2
    if picture.rounding is not None:
        below, above = picture.rounding

    def linear(levels):
        values = decode(np.clip(levels, 0, LEVELS).astype(np.float64) / LEVELS, transfer)
        return (values * LEVELS).astype(np.float32)

    middle = linear(picture.levels)
    ends = [float(linear(np.float32(np.clip(end, 0, LEVELS)))) for end in picture.ends]
    inside = float(linear(np.float32(min(picture.ends[1], LEVELS) - picture.half)))
    back = picture.background
    if back is not None:
        back = decode(encode(back.astype(np.float64), picture.transfer), transfer)
    return dataclasses.replace(
        picture,
        levels=middle,
        half=0.0,
        rounding=(middle - linear(picture.levels - below), linear(picture.levels + above) - middle),
        floor=ends[0],
        ceiling=inside if np.isfinite(picture.ends[1]) else None,
        background=None if back is None else back.astype(np.float32),
        transfer="none",
    )


def framed_in_black(mask: np.ndarray) -> np.ndarray:
    """The mask with its outermost pixels black: nearly the same as a black border outside."""
    inner = np.zeros_like(mask)
    inner[1:-1, 1:-1] = mask[1:-1, 1:-1]
    return inner


def tint_of(picture: Picture) -> np.ndarray | None:
    """(3,) the channels of a target's light against its green; None where it is grey, where the
    mask has colours, or where the target is black in a channel."""
    if picture.channels != 3 or picture.mask.ndim != 2 or picture.background is not None:
        return None
    known = picture.valid & ~picture.clipped
    light = decode(picture.levels[known].astype(np.float64) / LEVELS, picture.transfer)
    power = float((light[:, 1] ** 2).sum())
    if power == 0:
        return None
    tint = (light * light[:, 1:2]).sum(0) / power
    return tint if (tint > 0).all() and np.abs(tint - 1).max() > GREY else None


def untinted(picture: Picture, tint: np.ndarray) -> Picture:
    """The picture with every channel of its light scaled to green."""
    tint = tint.astype(np.float32)
    half = np.float32(picture.half)
    levels = picture.levels / tint
    wide = np.broadcast_to(half / tint, levels.shape)
    valid = picture.valid & ~picture.clipped
    return dataclasses.replace(picture, levels=levels, rounding=(wide, wide), valid=valid)


def block_side(picture: Picture) -> int | None:
    """The side of the blocks of equal pixels that the target consists of; None without such."""
    h, w = picture.size

    def equal(side: int, offset: int) -> float:
        z = picture.levels[offset : offset + (h - 1) // side * side, offset:]
        z = z[:, : (w - 1) // side * side]
        blocks = z.reshape(z.shape[0] // side, side, z.shape[1] // side, side, -1)
        return float((np.ptp(blocks, axis=(1, 3)) == 0).all(-1).mean())

    sides = [s for s in BLOCKS if min(h, w) > 4 * s and equal(s, 0) >= EQUAL_BLOCKS]
    return max((s for s in sides if equal(s, 1) < EQUAL_ANYWHERE), default=None)


class Trial:
    """Suspects of a fit ``found``, each searched anew from its ``starts``."""

    def __init__(self, found: Found, starts: Starts, report: Report) -> None:
        self.found, self.problem, self.starts = found, found.problem, starts
        self.report, self.small = report, found.problem.small
        self.own = self._anew(self.small.picture).sigma

    def best(self) -> Tried | None:
        """The suspect that leaves the least noise; None where none leaves far less than the images
        as they are."""
        best: Tried | None = None
        for make in (self._turned, self._edges, self._coloured, self._encoded, self._after):
            for tried in make():
                if best is None or tried.sigma < best.sigma:
                    best = tried
            if best is not None and best.sigma < min(WITHIN_ROUNDING, REMEDIED * self.own):
                break
        return best if best is not None and best.sigma < REMEDIED * self.own else None

    def _anew(self, picture: Picture) -> Settled:
        problem = self.small.replaced(picture=picture)
        point = multigrid.climb(problem, self.starts(picture), lambda text: None)
        return settle(point.coordinates, problem, problem.observe(SEARCH_PIXELS))[0]

    def _tried(self, suspect: Suspect) -> Tried:
        settled = self._anew(suspect.picture)
        if suspect.transfer == "none":
            return Tried(settled.sigma, suspect)
        problem = self.small.replaced(picture=suspect.picture)
        observation = problem.observe(SEARCH_PIXELS)
        linear = np.asarray(observation.predict(problem.at(settled.coordinates)), np.float64)
        levels = (LEVELS * encode(linear / LEVELS, suspect.transfer)).astype(np.float32)
        own = self.small.picture.observe(np.asarray(observation.pixels))
        return Tried(best_sigma(levels, own)[0], suspect)

    def _turned(self) -> Iterator[Tried]:
        for value, (words, axes) in FLIPS.items():
            words = f"the target is {words} against its mask; --flip {value} turns it"
            yield self._tried(Suspect("flip", words, flipped(self.small.picture, axes)))

    def _edges(self) -> Iterator[Tried]:
        picture = self.small.picture
        if min(picture.mask.shape[:2]) < 8:
            return
        mask = framed_in_black(picture.mask)
        if not np.array_equal(mask, picture.mask):
            words = "beyond the mask's edge its shader reads black, and not the edge repeated; "
            words += "--border black does so"
            yield self._tried(Suspect("border", words, picture.with_mask(mask)))

    def _coloured(self) -> Iterator[Tried]:
        picture = self.small.picture
        tint = tint_of(picture)
        if tint is not None:
            words = (
                "the light has a colour, {:.3g} : {:.3g} : {:.3g}, and the mask has none; --tint "
            )
            words = words.format(*tint) + "fits it"
            yield self._tried(Suspect("tint", words, untinted(picture, tint)))

    def _encoded(self) -> Iterator[Tried]:
        picture = self.small.picture
        if picture.transfer != "none":
            words = "the target is linear; --transfer none takes it so"
            yield self._tried(
                Suspect("transfer", words, dataclasses.replace(picture, transfer="none"))
            )
        curves = [*TONE_CURVES, *(f"{curve}+srgb" for curve in TONE_CURVES[1:])]
        for transfer in curves:
            if transfer == picture.transfer:
                continue
            kind = "gamma-encoded" if transfer == "srgb" else "tone-mapped"
            words = f"the target is {kind}; --transfer {transfer} undoes it"
            yield self._tried(Suspect("transfer", words, decoded(picture, transfer), transfer))

    def _after(self) -> Iterator[Tried]:
        """What was done to the picture after the light pass."""
        from scipy import ndimage

        picture = self.problem.picture
        if picture.transfer != "none" or self.small.picture is not picture:
            return
        for blur in BLURS:
            words = f"the target was blurred after the light pass, by a Gaussian of {blur:g} pixels"
            words += "; give the picture before that"

            def blurred(full: np.ndarray, blur: float = blur) -> np.ndarray:
                return ndimage.gaussian_filter(full, (blur, blur, 0), mode="nearest")

            yield Tried(self._corrected(blurred), Suspect("blurred", words, picture))
        if picture.mask.shape[:2] == picture.size:
            for factor in (2, 4):
                yield from self._enlarged(factor)
        if picture.background is not None:
            yield from self._on_another_background()

    def _enlarged(self, factor: int) -> Iterator[Tried]:
        from scipy import ndimage

        h, w = self.problem.picture.size
        if min(h, w) < 4 * factor:
            return
        scale = 1 / factor

        def smaller(full: np.ndarray) -> np.ndarray:
            small = shrink(full, (h // factor, w // factor))
            zoom = (h / small.shape[0], w / small.shape[1], 1)
            return np.asarray(ndimage.zoom(small, zoom, order=1, mode="nearest", grid_mode=True))

        words = diagnostics.WORDS["upsampled"].format(scale=scale)
        yield Tried(self._corrected(smaller), Suspect("upsampled", words, self.problem.picture))

    def _corrected(self, change: Callable[[np.ndarray], np.ndarray]) -> float:
        """The noise that is left where the target has had ``change`` done to it: the target is
        corrected by the change of the rendering, the more exactly the closer that is."""
        picture, z = self.problem.picture, self.found.settled.coordinates
        sigma = np.inf
        for _ in range(CORRECTIONS):
            full = picture.rendered(self.problem.at(z))
            levels = (picture.levels + full - change(full)).astype(np.float32)
            problem = self.problem.replaced(picture=dataclasses.replace(picture, levels=levels))
            settled, _ = settle(z, problem, problem.observe(SEARCH_PIXELS))
            z, before, sigma = settled.coordinates, sigma, settled.sigma
            if sigma > REMEDIED**0.5 * min(before, self.own):
                break
        return sigma

    def _on_another_background(self) -> Iterator[Tried]:
        picture, model = self.problem.picture, self.problem.model
        back = picture.background
        if back is None or not isinstance(model, Mitchell):
            return
        if model.convention.blend != "screen":
            rest = np.maximum(1 - back, DARK_REST)
            levels = np.float32(LEVELS) * (picture.levels / np.float32(LEVELS) - back) / rest
            wide = picture.half / rest
            other = dataclasses.replace(
                picture, levels=levels, background=np.zeros_like(back), rounding=(wide, wide),
                valid=picture.valid & (back < 1 - DARK_REST).all(-1) & ~picture.clipped,
            )  # fmt: skip
            words = (
                "the light pass was blended with the background by screen, as pmndrs does; give "
            )
            words += "a --shader that does"
            yield self._tried(Suspect("background", words, other.small))
        gain, z, sigma = 1.0, self.found.settled.coordinates, np.inf
        for _ in range(CORRECTIONS):
            other = dataclasses.replace(picture, background=np.float32(gain) * back)
            problem = self.problem.replaced(picture=other)
            settled, _ = settle(z, problem, problem.observe(SEARCH_PIXELS))
            z, sigma = settled.coordinates, settled.sigma
            known = picture.valid & ~picture.clipped
            error = (picture.levels - other.rendered(problem.at(z)))[known] / LEVELS
            shown = back[known] - back[known].mean(0)
            gain += float((shown * error).sum() / max(float((shown**2).sum()), 1e-12))
        if abs(gain - 1) > GAIN_CHANGE:
            whole = gain * model.convention.background_gain
            words = f"the background has a gain of {whole:.3g}, where {model.shader} has "
            words += (
                f"{model.convention.background_gain:g}; give a --shader or --background with it"
            )
            yield Tried(sigma, Suspect("background", words, other))


def suspected(found: Found, starts: Starts, report: Report) -> diagnostics.Suspect | None:
    """The change of the images that explains far more than the images as they are, in words with
    the option that makes it and the levels that it explains; None without such."""
    side = block_side(found.problem.picture)
    if side is not None:
        h, w = found.problem.picture.size
        words = (
            f"the target consists of {side}x{side} blocks of equal pixels: its light pass of "
            f"{w // side}x{h // side} pixels was enlarged by nearest neighbour; give it at that "
            "size"
        )
        return diagnostics.Suspect(1.0, "nearest", words)
    cause = scattered(found)
    if cause is not None:
        return cause
    trial = Trial(found, starts, report)
    best = trial.best()
    if best is None:
        return None
    explained = f"(noise of {best.sigma:.2g} levels in place of {trial.own:.2g})"
    return diagnostics.Suspect(1.0, best.suspect.code, f"{best.suspect.words} {explained}")
