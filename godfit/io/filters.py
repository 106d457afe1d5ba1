"""Images averaged over cells or channels, and blurred."""

from __future__ import annotations

import functools
import math

import numpy as np

GAUSSIAN_REACH = 4.0
"""Standard deviations at which a Gaussian is cut off: beyond, it is below 1e-4 of its top."""


def shrink(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(h, w, ...) averaged over cells onto at most ``size`` rows and columns; float32."""
    out = image
    for axis in (0, 1):
        length = image.shape[axis]
        count = min(size[axis], length)
        if count == length:
            continue
        if length % count == 0:
            # Adding whole lines takes a tenth of the time of ``reduceat``.
            step, lines = length // count, np.moveaxis(out, axis, 0)
            total = lines[::step].astype(np.float64)
            for first in range(1, step):
                total += lines[first::step]
            out = np.moveaxis(total / step, 0, axis)
        else:
            edges = np.linspace(0, length, count + 1).astype(int)
            out = np.add.reduceat(out, edges[:-1], axis=axis, dtype=np.float64)
            out /= np.diff(edges).reshape((-1,) + (1,) * (out.ndim - 1 - axis))
    return out.astype(np.float32)


def over_channels(combine: np.ufunc, image: np.ndarray) -> np.ndarray:
    """(h, w) the channels of an image (h, w, c) combined, as in ``over_channels(np.add, image)``.

    NumPy's own reduction over an axis of length three takes fifteen times as long.
    """
    return functools.reduce(combine, np.moveaxis(image, -1, 0))


def grey(image: np.ndarray) -> np.ndarray:
    """(h, w) mean of the channels."""
    return image if image.ndim == 2 else image.mean(-1)


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """(h, w, ...) blurred with a standard deviation of about ``sigma`` pixels, clamped to the edge.

    The kernel is a tent, the convolution of two boxes, whose cost does not grow with its width. It
    stands in for a Gaussian where two images are blurred alike and the shape does not matter.
    """
    width = _box_width(sigma)
    if image.ndim == 3:
        return np.stack([blurred(image[..., c], sigma) for c in range(image.shape[-1])], -1)
    image = np.pad(image, width - 1, mode="edge")
    for _ in range(2):
        # Along rows, then, transposed, along columns: across rows it takes four times as long.
        for _ in range(2):
            image = _box_means(image, width)
        image = np.ascontiguousarray(image.T)
    return image


def _box_means(lines: np.ndarray, width: int) -> np.ndarray:
    """(h, w - width + 1) means of so many values in a row: what scipy.ndimage.uniform_filter1d
    computes, whose import takes a tenth of a short command."""
    sums = np.cumsum(lines, 1, dtype=np.float64)
    sums /= width
    means = np.empty((len(lines), lines.shape[1] - width + 1), lines.dtype)
    means[:, 0] = sums[:, width - 1]
    np.subtract(sums[:, width:], sums[:, :-width], out=means[:, 1:], casting="same_kind")
    return means


def smoothed(image: np.ndarray, sigma: float) -> np.ndarray:
    """(h, w) convolved with a Gaussian of ``sigma`` pixels, mirrored at the edge: what
    scipy.ndimage.gaussian_filter computes."""
    reach = round(GAUSSIAN_REACH * sigma)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        ends = [(reach, reach) if i == axis else (0, 0) for i in (0, 1)]
        lines = np.moveaxis(np.pad(image, ends, mode="symmetric"), axis, 0)
        length = image.shape[axis]
        total = sum(w * lines[k : k + length] for k, w in enumerate(weights))
        image = np.moveaxis(np.asarray(total), 0, axis)
    return image


def blurred_at(image: np.ndarray, sigma: float, pixels: np.ndarray) -> np.ndarray:
    """(n, c) ``blurred`` of an image (h, w, c), at row-major ``pixels`` (n,) alone."""
    width = _box_width(sigma)
    tent_width = 2 * width - 1
    tent = np.convolve(np.ones(width), np.ones(width)).astype(np.float32) / width**2
    row, column = np.divmod(pixels, image.shape[1])
    channels = []
    for channel in np.moveaxis(image, -1, 0):
        padded = np.pad(channel, width - 1, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, (tent_width, tent_width))
        channels.append(windows[row, column] @ tent @ tent)
    return np.stack(channels, -1)


def doubled(image: np.ndarray) -> np.ndarray:
    """(2h, 2w) an image (h, w) read bilinearly at twice as many pixels, clamped to the edge."""
    out = image
    for axis in (0, 1):
        near = np.moveaxis(out, axis, 0).astype(np.float64)
        before = np.concatenate([near[:1], near[:-1]])
        after = np.concatenate([near[1:], near[-1:]])
        both = np.stack([0.75 * near + 0.25 * before, 0.75 * near + 0.25 * after], 1)
        out = np.moveaxis(both.reshape(-1, *near.shape[1:]), 0, axis)
    return out.astype(image.dtype)


def read_at(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(n,) an image (h, w) read bilinearly at columns and rows ``at`` (n, 2), clamped to the
    edge."""
    last = np.array(image.shape[::-1]) - 1
    place = np.clip(at.astype(np.float64), 0, last)
    whole = np.floor(place).astype(int)
    (i, j), (f, g) = whole.T, (place - whole).T
    (i_next, j_next) = np.minimum(whole + 1, last).T
    upper = (1 - f) * image[j, i] + f * image[j, i_next]
    lower = (1 - f) * image[j_next, i] + f * image[j_next, i_next]
    return ((1 - g) * upper + g * lower).astype(image.dtype)


def _box_width(sigma: float) -> int:
    """Width in pixels, odd, of the boxes of a blur: two of them have the variance ``sigma``^2."""
    return 2 * round((math.sqrt(6 * sigma**2 + 1) - 1) / 2) + 1
