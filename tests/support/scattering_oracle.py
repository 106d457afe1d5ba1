"""The shaders' arithmetic written out from their formulas with numpy and scipy: what godfit, with
which it shares no code, is held against. Images have row 0 at the top; u points right, v up."""

import numpy as np
from scipy import ndimage

# Convention: own-pixel factor f, taps dropped from n, exponent offset e, gain g of the light pass.
FACTORS = {
    "mitchell": (1, 0, 1, 1.0),
    "dawntime": (1, 1, 0, 1.0),
    "vesper": (1, 1, 1, 1.0),
    "article-glsl": (1, 0, 1, 0.4),
    "article-hlsl": (1, 0, 1, 0.4),
    "babylon": (1, 0, 1, 0.4),
    "pmndrs": (0, 0, 1, 1.0),
}

LIGHTS = {
    "centre": (0.5, 0.5),
    "texel centre": (4.5 / 13, 1 - 6.5 / 11),
    "border": (0.0, 0.31),
    "corner": (1.0, 1.0),
    "off screen": (-0.6, 1.7),
    "far off screen": (3.0, -2.0),
}


def texture(image, u, v):
    """A bilinear texture read with CLAMP_TO_EDGE; texel centres lie at (i + 1/2)/N."""
    h, w = image.shape
    return ndimage.map_coordinates(image, [(1 - v) * h - 0.5, u * w - 0.5], order=1, mode="nearest")


def pixel_centres(h, w):
    """u and v, (h, w) each, of the pixel centres of an image."""
    return np.meshgrid((np.arange(w) + 0.5) / w, 1 - (np.arange(h) + 0.5) / h)


def tap_sum(image, light, own, weights, fractions):
    """own M(x) + sum_k weights_k M(x + fractions_k (l - x)) at every pixel."""
    u, v = pixel_centres(*image.shape)
    total = own * texture(image, u, v)
    for c, t in zip(weights, fractions, strict=True):
        total = total + c * texture(image, u + t * (light[0] - u), v + t * (light[1] - v))
    return total


def light_pass(mask, shader, exposure, decay, density, weight, light, samples):
    """E g (f M(x) + w sum_{i=1..K} d^(i-e) M(x - i Delta)), Delta = (x - l) rho / n."""
    f, dropped, e, g = FACTORS[shader]
    u, v = pixel_centres(*mask.shape)
    total = f * texture(mask, u, v)
    for i in range(1, samples - dropped + 1):
        delta_u = (u - light[0]) * density / samples
        delta_v = (v - light[1]) * density / samples
        total = total + weight * decay ** (i - e) * texture(mask, u - i * delta_u, v - i * delta_v)
    return exposure * g * total


def smooth_mask(h, w, seed=0, scale=1.5):
    """A random mask without edges, from 0 to 1."""
    noise = np.random.default_rng(seed).random((h, w))
    smooth = ndimage.gaussian_filter(noise, scale, mode="nearest")
    return (smooth - smooth.min()) / np.ptp(smooth)


def hard_mask(h, w, seed=0):
    """A random mask of zeros and ones."""
    return (np.random.default_rng(seed).random((h, w)) > 0.5).astype(float)
