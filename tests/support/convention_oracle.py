"""Every convention's light pass as loops over its formula, in float64 with numpy and scipy: what
godfit's conventions, with which this shares no code, are held against.

Images have row 0 at the top; u points right, v up. ``p`` holds exposure, decay, density, weight,
samples and the light.
"""

import numpy as np

from tests.support.scattering_oracle import pixel_centres, texture


def towards(mask, light, t):
    """The mask at x + t (l - x)."""
    u, v = pixel_centres(*mask.shape)
    return texture(mask, u + t * (light[0] - u), v + t * (light[1] - v))


def powers(mask, p, first, last, offset=1):
    """sum_{i=first..last} d^(i - offset) M_{i rho/n}."""
    total = np.zeros(mask.shape)
    for i in range(first, last + 1):
        t = i * p["density"] / p["samples"]
        total = total + p["decay"] ** (i - offset) * towards(mask, p["light"], t)
    return total


def additive(mask, p):
    return p["exposure"] * p["weight"] * powers(mask, p, 1, p["samples"])


def glsl_godrays(mask, p):
    return p["exposure"] * p["weight"] * powers(mask, p, 1, min(p["samples"] + 1, 100))


def moonshine(mask, p):
    return p["exposure"] * p["weight"] * powers(mask, p, 1, p["samples"], 0)


def mean(mask, p):
    n, total = p["samples"], np.zeros(mask.shape)
    for k in range(n):
        total = total + towards(mask, p["light"], p["density"] * k / (n - 1))
    return p["exposure"] * total / n


def panda3d(mask, p):
    return p["exposure"] * (mask + powers(mask, p, 1, p["samples"]))


def radial_blur(mask, p):
    n, total = p["samples"], np.zeros(mask.shape)
    for i in range(1, n + 1):
        total = total + p["decay"] ** (i - 1) * towards(mask, p["light"], i / n)
    return mask + p["exposure"] / (2 * n) * p["weight"] * total


def reshade(mask, p, threshold=0.65):
    n, rays, white, weight = p["samples"], np.zeros(mask.shape), 1.0, 1.0
    cut = np.maximum(mask - threshold, 0)
    for i in range(1, n):
        rays = rays + weight * p["exposure"] * towards(cut, p["light"], i * p["density"] / n)
        white += weight * p["exposure"]
        weight *= p["decay"]
    return rays / (white - threshold)


def godot3(mask, p, attenuate=1.0):
    n, total = p["samples"], np.zeros(mask.shape)
    for k in range(n):
        total = total + towards(mask, p["light"], (k + 0.5) / n)
    return p["exposure"] * (total / n) ** attenuate


def six(mask, light, step):
    """Unity's pass: the mean of six taps at multiples of a step."""
    return sum(towards(mask, light, j * step) for j in range(6)) / 6


def sun_shafts(mask, p):
    # The blur radius whose four passes reach as far as the density.
    radius = p["density"] * 768 / 185
    for times in (1, 6, 12, 18):
        mask = six(mask, p["light"], times * radius / 768)
    return p["exposure"] * mask


def light_shafts(mask, p):
    for index in range(3):
        length = min(0.1 * 4.8**index, 1.0)
        mask = sum(towards(mask, p["light"], k / 12 * length) for k in range(12)) / 12
    return p["exposure"] * mask


def sun_beams(mask, p):
    h, w = mask.shape
    row, column = np.mgrid[:h, :w]
    to_x, to_y = p["light"][0] * w - 0.5 - column, (1 - p["light"][1]) * h - 0.5 - row
    distance = np.hypot(to_x, to_y)
    m = np.minimum(p["density"] * np.hypot(h, w), distance)
    total, weights = np.zeros(mask.shape), np.zeros(mask.shape)
    for i in range(int(m.max()) + 1):
        weight = np.where(i <= m, (1 - i / m) ** 2, 0)
        x, y = column + i * to_x / distance, row + i * to_y / distance
        total = total + weight * texture(mask, (x + 0.5) / w, 1 - (y + 0.5) / h)
        weights = weights + weight
    return p["exposure"] * total / weights


def godot4(mask, p, radius=150.0, size=16.0, mean=False):
    """With ``mean``, each read is the mean of the nearest texels of places within half a texel."""
    h, w = mask.shape
    n, rays = p["samples"], np.zeros(mask.shape)
    row, column = np.mgrid[:h, :w]
    to_x, to_y = p["light"][0] * w - 0.5 - column, (1 - p["light"][1]) * h - 0.5 - row
    share = np.minimum(np.hypot(to_x, to_y) / radius, 1)
    for k in range(n):
        t = p["density"] * k / n * share
        y, x = row + t * to_y, column + t * to_x
        i = np.clip(np.round(y), 0, h - 1).astype(int)
        j = np.clip(np.round(x), 0, w - 1).astype(int)
        read = texture(mask, (x + 0.5) / w, 1 - (y + 0.5) / h) if mean else mask[i, j]
        rays = rays + read / n
    weights = [np.exp(-(((i - 16) / 10) ** 2) / 2) for i in range(33)]
    for axis in (0, 1):
        across, blurred = rays.shape[axis], np.zeros(mask.shape)
        for i, weight in enumerate(weights):
            at = np.clip(np.arange(across) + int(np.floor(size * (i - 16) / 16)), 0, across - 1)
            blurred = blurred + weight / sum(weights) * np.take(rays, at, axis)
        rays = blurred
    return p["exposure"] * rays


def jmonkey(mask, p, start=0.02):
    """R alone: the exposure is where R is blended."""
    n, total = p["samples"], np.zeros(mask.shape)
    for k in range(n):
        scale = start + p["density"] * k / (n - 1)
        total = total + towards(mask, p["light"], 1 - scale)
    return total / n


LIGHT_PASSES = {
    "additive": additive,
    "glsl-godrays": glsl_godrays,
    "moonshine": moonshine,
    "mean": mean,
    "panda3d": panda3d,
    "radial-blur": radial_blur,
    "reshade": reshade,
    "godot3": godot3,
    "sun-shafts": sun_shafts,
    "light-shafts": light_shafts,
    "sun-beams": sun_beams,
    "godot4": godot4,
    "jmonkey": jmonkey,
}
"""The light pass of each convention that ``scattering_oracle`` does not have."""


def composite(name, light, background, exposure):
    """The picture, from a light pass (h, w, 3) and a background."""
    if name in ("sun-shafts", "pmndrs"):
        return 1 - (1 - background) * (1 - light)
    if name == "godot4":
        return background * (1 + light)
    if name == "jmonkey":
        return background + light.mean(-1, keepdims=True) * exposure * (light - background)
    if name in ("article-glsl", "article-hlsl", "babylon"):
        return 1.1 * background + light
    return background + light
