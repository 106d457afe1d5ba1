"""The light pass of two screenshots, one with the effect on and one with it off."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from godfit.io.image import LEVELS, Image, decode
from godfit.scattering.conventions import Convention

ENCODINGS = (("none", "none"), ("srgb", "srgb"), ("srgb", "none"))
"""Transfers of the picture with the effect on and of the ordinary pass that are tried: a dump of a
linear buffer is an ordinary pass too."""
CLEAR = 0.02
"""Linear light that the ordinary pass must leave below white for a screen blend to show the
rest."""
SAME_CHANNELS = 3.0
"""Levels by which channels differ, at most, where they are one grey light pass: a few times the
rounding of two pictures."""
OFTEN = 0.9999
"""Share of the pixels in which they do so: a coloured light may be a thousandth of the picture."""


class Blend(NamedTuple):
    """How a light pass L was laid on the ordinary pass B: ``kind`` "add" is gain B + L, "screen" is
    B + L - B L, in linear light. The composite is decoded by ``transfer``, B by ``scene``."""

    kind: str
    gain: float
    transfer: str
    scene: str


@dataclasses.dataclass(frozen=True, eq=False)
class LightPass:
    """A light pass in levels of linear light, (h, w, channels).

    ``values`` lie within ``half`` of the truth where ``known``; elsewhere, where the picture was
    clipped, they are what the light pass has at least.
    """

    values: np.ndarray
    half: np.ndarray
    known: np.ndarray
    blend: Blend

    @property
    def size(self) -> tuple[int, int]:
        return self.values.shape[0], self.values.shape[1]

    @property
    def grey(self) -> bool:
        """Whether there is one channel."""
        return self.values.shape[-1] == 1


def light_pass(
    on: Image,
    off: Image,
    shader: Convention,
    encodings: tuple[tuple[str, str], ...],
    valid: np.ndarray | None,
) -> LightPass:
    """The light pass of the picture with the effect ``on``, given the ordinary pass ``off``.

    The transfers are those of ``encodings`` under which the channels agree best: a light adds to
    three channels alike, and what the blend leaves of the scene's texture does not.
    """
    on_levels, off_levels = (np.atleast_3d(im.encoded).astype(float) * LEVELS for im in (on, off))
    on_levels, off_levels = np.broadcast_arrays(on_levels, off_levels)
    shown = np.ones(on_levels.shape[:2], bool) if valid is None else valid
    blends = [Blend(shader.blend, shader.background_gain, *both) for both in encodings]
    passes = [_pass_of(on_levels, off_levels, shown, blend) for blend in blends]
    best = min(passes, key=_disagreement)
    return _merged(best)


def _pass_of(on: np.ndarray, off: np.ndarray, shown: np.ndarray, blend: Blend) -> LightPass:
    def light(levels, transfer):
        return decode(np.clip(levels, 0, LEVELS) / LEVELS, transfer)

    low, high = light(on - 0.5, blend.transfer), light(on + 0.5, blend.transfer)
    scene = light(off, blend.scene)
    if blend.transfer != "none":
        # Such a composite is made of the ordinary pass before that was rounded.
        doubt = light(off + 0.5, blend.scene) - scene
        low, high = low - doubt, high + doubt
    room = np.ones_like(scene)
    if blend.kind == "screen":
        room = np.maximum(1 - scene, CLEAR / 2)
        low, high = (low - scene) / room, (high - scene) / room
    else:
        low, high = low - blend.gain * scene, high - blend.gain * scene
    known = (on < LEVELS - 0.5) & (room > CLEAR) & shown[..., None]
    values = LEVELS * np.where(known, (low + high) / 2, np.maximum(low, 0))
    return LightPass(values, LEVELS * (high - low) / 2, known, blend)


def _disagreement(one: LightPass) -> float:
    """How much channels differ where all are known, against how much the light pass varies."""
    known = one.known.all(-1)
    if one.grey or not known.any():
        return 0.0
    values = one.values[known]
    return float(np.ptp(values, axis=-1).mean() / max(values.mean(-1).std(), 1e-6))


def _merged(one: LightPass) -> LightPass:
    """One channel where all agree: wherever one is known, the light pass is."""
    if one.grey:
        return one
    both = one.known.all(-1)
    apart = np.ptp(one.values[both], axis=-1) - 2 * one.half[both].max(-1)
    if not both.any() or np.quantile(apart, OFTEN) > SAME_CHANNELS:
        return one
    weight = np.where(one.known, 1 / np.maximum(one.half, 1e-3) ** 2, 0)
    total = weight.sum(-1)
    known = total > 0
    least = one.values.max(-1)
    values = np.where(known, (weight * one.values).sum(-1) / np.maximum(total, 1e-12), least)
    half = np.where(known, np.where(one.known, one.half, np.inf).min(-1), one.half.min(-1))
    return LightPass(values[..., None], half[..., None], known[..., None], one.blend)


def encodings_of(transfer: str, shader: Convention) -> tuple[tuple[str, str], ...]:
    """Transfers of composite and ordinary pass that are tried: the given one, and where none is
    given and the shader's engine works in linear light, which screen blends do, all."""
    if transfer != "none":
        return tuple(both for both in ENCODINGS if both[0] == transfer)
    return ENCODINGS if shader.blend == "screen" else ENCODINGS[:1]
