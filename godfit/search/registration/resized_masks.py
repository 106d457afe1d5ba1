"""Masks as they were before an image program resized them.

A shader read the mask at one size, and a stranger has it at another: its edges are grey then, and
rays of wrong edges are no noise. A resize is linear, and one by little loses nearly nothing: only
what alternates from pixel to pixel, and only where new pixels lie halfway between old ones.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from godfit.io.image import LEVELS
from godfit.io.resampling import ROUNDED_ONCE, ROUNDED_TWICE, Resize
from godfit.search.registration.resized_targets import bytes_before

MOST_VALUES = 8
"""Values of a mask that is in few colours, at most: a clear colour, a light, and a few objects."""
SAME_BYTE = 1e-3
"""Levels within which values are whole: those of bytes that float32 holds."""


class Before(NamedTuple):
    """A ``mask`` (h, w, ...) as it was before a resize, and the ``variance`` of its texels, None
    where nothing is known of it."""

    mask: np.ndarray
    variance: np.ndarray | None = None


def before_resize(mask: np.ndarray, size: tuple[int, int], once: bool = False) -> list[Before]:
    """The ``mask`` (H, W, ...) as it was at ``size`` (h, w), if it was resized from that by each of
    the kernels of ``ROUNDED_TWICE``, in few colours first where it has few. Of programs that
    rounded ``once`` only masks in few colours are found: others are the same. Empty where the mask
    has that size."""
    if mask.shape[:2] == size:
        return []
    levels = mask.reshape(*mask.shape[:2], -1) * np.float32(LEVELS)
    whole_bytes = bool(np.abs(levels - np.round(levels)).max() < SAME_BYTE)
    values = few_values(mask)

    def allowed(mask: np.ndarray) -> np.ndarray:
        mask = mask.clip(0, 1)
        return np.round(mask * LEVELS) / LEVELS if whole_bytes else mask

    found = []
    for name in ROUNDED_ONCE if once else ROUNDED_TWICE:
        resize = Resize.of(size, mask.shape[:2], name)
        grey = resize.undone(mask, allowed).astype(np.float32)
        whole = None
        if values is not None and whole_bytes:
            whole = _in_few(grey, np.round(levels), resize, values, once)
        if whole is not None:
            found.append(whole)
        elif not once:
            if values is not None:
                few = resize.undone(mask, partial(snapped, values=values)).astype(np.float32)
                # What the resize left undetermined lies between two colours.
                found.append(Before(few, (few - grey) ** 2))
            found.append(Before(grey))
    return found


def _in_few(
    grey: np.ndarray, levels: np.ndarray, resize: Resize, values: np.ndarray, once: bool
) -> Before | None:
    """The mask in few colours, ``values``, nearest to ``grey`` (h, w, ...) within the bounds that
    the bytes after the resize give; None where these exclude each other: it was another kernel, or
    had more colours."""
    every = np.ones(levels.shape[:2], bool)
    bounds = bytes_before(levels, every, resize, np.round(values * LEVELS), once)
    if bounds.contradicted > 0:
        return None
    ends = (z.reshape(grey.shape) / LEVELS for z in (bounds.low, bounds.high))
    low, high = (z.astype(np.float32) for z in ends)
    variance = ((high - low) / 2) ** 2
    if once:
        # Only pixels at the edge read what is there, and show a wrong guess.
        variance[~resize.interior()] = 0
    return Before(snapped(grey, values).clip(low, high), variance)


def few_values(mask: np.ndarray) -> np.ndarray | None:
    """The values of a mask that was drawn with few colours and without anti-aliasing, and resized:
    those of its flat parts, where a pixel and its neighbours have one value, and its ends, as what
    is small has no flat part. None where there are many."""
    from scipy import ndimage

    around = (3, 3) + (1,) * (mask.ndim - 2)
    flat = ndimage.maximum_filter(mask, around) == ndimage.minimum_filter(mask, around)
    values = np.unique(mask[flat])
    if not 0 < len(values) <= MOST_VALUES:
        return None
    return np.unique(np.append(values, [mask.min(), mask.max()]))


def snapped(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The ``mask`` with each value replaced by the nearest of ``values``: as it was before a resize
    made its edges grey."""
    middles = (values[1:] + values[:-1]) / 2
    return values[np.searchsorted(middles, mask)].astype(np.float32)
