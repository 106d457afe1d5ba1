"""A light pass as a GPU computes it: a loop over taps in numpy that shares no code with godfit.

A shader begins at its own pixel and subtracts one step after the other from its coordinates. In
float32 each subtraction is rounded to the grid where the coordinate is. A texture unit may also
round the fractions of a texel with which it interpolates. The words of the loop are those of the
shaders (GPU Gems 3, listing 13-1).
"""

from __future__ import annotations

import numpy as np

from tests.support.scattering_oracle import FACTORS


def read_texture(image: np.ndarray, u, v, fractions: int | None = None) -> np.ndarray:
    """A bilinear read with CLAMP_TO_EDGE at u, v (h, w); v is up. With ``fractions`` the places
    between texels are rounded to one part in so many."""
    h, w = image.shape
    x, y = np.asarray(u, np.float64) * w - 0.5, (1 - np.asarray(v, np.float64)) * h - 0.5
    i, j = np.floor(x), np.floor(y)
    across, down = x - i, y - j
    if fractions is not None:
        across, down = (np.floor(z * fractions + 0.5) / fractions for z in (across, down))
    columns = np.clip([i, i + 1], 0, w - 1).astype(int)
    rows = np.clip([j, j + 1], 0, h - 1).astype(int)
    upper = (1 - across) * image[rows[0], columns[0]] + across * image[rows[0], columns[1]]
    lower = (1 - across) * image[rows[1], columns[0]] + across * image[rows[1], columns[1]]
    return (1 - down) * upper + down * lower


def walk(
    mask: np.ndarray, shader: str, truth: dict[str, float], fractions: int | None = None,
    dtype=np.float32,
) -> np.ndarray:  # fmt: skip
    """(h, w) the light pass of ``mask`` (h, w), linear, not clamped. ``truth`` has exposure, decay,
    density, weight, light_x, light_y and samples; coordinates are of ``dtype``."""
    own, dropped, order, gain = FACTORS[shader]
    h, w = mask.shape
    u, v = np.meshgrid((np.arange(w) + 0.5) / w, 1 - (np.arange(h) + 0.5) / h)
    u, v = u.astype(dtype), v.astype(dtype)
    share = dtype(1 / truth["samples"]) * dtype(truth["density"])
    delta_u, delta_v = (u - dtype(truth["light_x"])) * share, (v - dtype(truth["light_y"])) * share
    colour = own * read_texture(mask, u, v, fractions)
    illumination = 1.0 if order else truth["decay"]
    for _ in range(int(truth["samples"]) - dropped):
        u, v = u - delta_u, v - delta_v
        colour = colour + read_texture(mask, u, v, fractions) * illumination * truth["weight"]
        illumination *= truth["decay"]
    return truth["exposure"] * gain * colour


def drifts(places: np.ndarray, light: float, density: float, samples: int, taps: int) -> np.ndarray:
    """How far columns (or rows) at ``places`` (n,) drift for each step of a float32 walk, on
    average over the walk, as displacements of their lights."""
    at = places.astype(np.float32)
    delta = (at - np.float32(light)) * (np.float32(1 / samples) * np.float32(density))
    steps = np.arange(1, taps + 1)
    walked, off = at, []
    for k in steps:
        walked = walked - delta
        off.append(walked.astype(np.float64) - (places + k * density / samples * (light - places)))
    off = np.array(off)
    return (steps @ off) / (steps @ steps) * samples / density
