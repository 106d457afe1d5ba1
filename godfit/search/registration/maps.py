"""Where the pixels of a target lie in a mask of another size or frame, and which sizes are taken
for the same scene."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from godfit.errors import InputError

NEAR, NEAR_ASPECT = 0.02, 0.01
"""Differences of the sides and of the aspects of mask and target, as a share, up to which the mask
is registered unasked: a crop by a few pixels or a resize by as much happens unnoticed."""
REGISTERED = 0.1
"""The same where registration was asked for: farther the two are different frames."""


class Map(NamedTuple):
    """Where the target's pixels lie in the mask: by axis, rows first, ``scale`` and ``shift``, in
    the mask's pixels for each of the target's and in the mask's pixels."""

    scale: np.ndarray
    shift: np.ndarray

    def corners(self, size: tuple[int, int]) -> np.ndarray:
        """(4,) places of the target's first and last edge by axis, which are what is fitted: scale
        and shift trade with each other."""
        return np.concatenate([self.shift, self.scale * size + self.shift])

    @staticmethod
    def of(corners: np.ndarray, size: tuple[int, int]) -> Map:
        """The map with these ``corners`` for a target of ``size``."""
        return Map((corners[2:] - corners[:2]) / size, corners[:2])

    @property
    def whole(self) -> bool:
        """Whether it is a shift by whole pixels."""
        return bool((self.scale == 1).all() and (self.shift == np.round(self.shift)).all())

    def applied(self, mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """(h, w, ...) the ``mask`` at the target's pixels, its edge repeated."""
        from scipy import ndimage

        offset = 0.5 * self.scale + self.shift - 0.5

        def one(channel):
            places: Any = offset
            moved: Any = ndimage.affine_transform(
                channel, self.scale, places, size, order=1, mode="nearest"
            )
            return moved

        if mask.ndim == 2:
            return one(mask)
        return np.stack([one(mask[..., c]) for c in range(mask.shape[-1])], -1)


IDENTITY = Map(np.ones(2), np.zeros(2))
"""The map of a mask of the target's size and frame."""


def may_register(mask: tuple[int, ...], target: tuple[int, ...], asked: bool) -> bool:
    """Whether a mask of a size (h, w) can be registered with a target of another; unasked only
    where the two differ, by little: a light pass at lower resolution is smaller by more."""
    ratio = np.array(mask[:2]) / np.array(target[:2])
    if asked:
        return bool((np.abs(ratio - 1) <= REGISTERED).all())
    near = (np.abs(ratio - 1) <= NEAR).all() and abs(ratio[0] / ratio[1] - 1) <= NEAR_ASPECT
    return bool(near and mask[:2] != target[:2])


def fitted_size(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The mask at the target's size, as one frame: what registration begins with."""
    return Map(np.array(mask.shape[:2]) / size, np.zeros(2)).applied(mask, size)


def unregistered(
    mask: np.ndarray, size: tuple[int, ...], asked: bool, pass_scale: float
) -> np.ndarray | None:
    """The mask, where it is to be registered with a target of a ``size``; None where it is taken as
    it is. Raises InputError where registration was ``asked`` for and is not possible."""
    if pass_scale != 1:
        if asked:
            raise InputError("register: expected no --pass-scale with it; leave one of them out")
        return None
    if asked:
        check_registered(mask.shape, size)
    elif not may_register(mask.shape, size, asked=False):
        return None
    return mask


def check_registered(mask: tuple[int, ...], target: tuple[int, ...]) -> None:
    """Raise InputError for a mask that is too far from its target's size to be registered."""
    if not may_register(mask, target, asked=True):
        (h, w), (height, width) = mask[:2], target[:2]
        raise InputError(
            f"register: expected a mask within {REGISTERED:.0%} of the target's {width}x{height} "
            f"pixels, got {w}x{h}; crop or scale it first"
        )
