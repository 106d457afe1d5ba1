"""The shaders of jason.today/gi (2024), transcribed line by line, in float64 loops: what
``godfit.flatland.published`` must equal.

Texels are rows of RGBA from the bottom up, as GLSL has them. Names are those of the source.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

PI = 3.14159265
TAU = 2.0 * PI
EPS = 0.001
SKY_COLOR = (0.02, 0.08, 0.2)
SUN_COLOR = (0.95, 0.95, 0.9)

Texels = list[list[tuple[float, ...]]]


class Gi(NamedTuple):
    """The uniforms of the gi shader, with the page's values."""

    rayCount: int = 32
    maxSteps: int = 32
    sunAngle: float = 4.2
    showNoise: bool = True
    showGrain: bool = True
    enableSun: bool = True
    useTemporalAccum: bool = False
    time: float = 0.0


class Naive(NamedTuple):
    """The uniforms of the naive shader, with the page's values."""

    rayCount: int = 8
    maxSteps: int = 128
    showNoise: bool = True
    accumRadiance: bool = True


def texels_of(values: np.ndarray) -> Texels:
    """Rows from the top (h, w, 4), bytes, as a texture."""
    return [[tuple(map(float, texel / 255)) for texel in row] for row in values[::-1]]


def image_of(texels: Texels) -> np.ndarray:
    """(h, w, 3) with the top row first."""
    return np.array(texels)[::-1, :, :3]


def texture(texels: Texels, uv) -> tuple[float, ...]:
    """NearestFilter and ClampToEdgeWrapping."""
    h, w = len(texels), len(texels[0])
    i, j = math.floor(uv[0] * w), math.floor(uv[1] * h)
    return texels[min(max(j, 0), h - 1)][min(max(i, 0), w - 1)]


def pixels(texels: Texels, shader) -> Texels:
    """A pass of ``shader(vUv)`` over all pixels."""
    h, w = len(texels), len(texels[0])
    return [[shader(((i + 0.5) / w, (j + 0.5) / h)) for i in range(w)] for j in range(h)]


def rand(co) -> float:
    x = math.sin(co[0] * 12.9898 + co[1] * 78.233) * 43758.5453
    return x - math.floor(x)


def mod(x, y):
    return x - y * math.floor(x / y)


def clamp(x, low, high):
    return min(max(x, low), high)


def smoothstep(edge0, edge1, x):
    t = clamp((x - edge0) / (edge1 - edge0), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def out_of_bounds(uv) -> bool:
    return uv[0] < 0.0 or uv[0] > 1.0 or uv[1] < 0.0 or uv[1] > 1.0


def naive(scene: Texels, uniforms: Naive) -> Texels:
    """The naive-raymarch-shader."""
    size = len(scene[0]), len(scene)

    def raymarch(vUv):
        light = texture(scene, vUv)
        if light[3] > 0.1:
            return light
        oneOverRayCount = 1.0 / uniforms.rayCount
        tauOverRayCount = TAU * oneOverRayCount
        noise = rand(vUv) if uniforms.showNoise else 0.1
        radiance = [0.0, 0.0, 0.0, 0.0]
        for i in range(uniforms.rayCount):
            angle = tauOverRayCount + (float(i) + noise)
            rayDirectionUv = math.cos(angle) / size[0], -math.sin(angle) / size[1]
            initialStep = 0 if uniforms.accumRadiance else max(0, uniforms.maxSteps - 1)
            for step in range(initialStep, uniforms.maxSteps):
                sampleUv = vUv[0] + rayDirectionUv[0] * step, vUv[1] + rayDirectionUv[1] * step
                if out_of_bounds(sampleUv):
                    break
                sampleLight = texture(scene, sampleUv)
                if sampleLight[3] > 0.5:
                    radiance = [a + b for a, b in zip(radiance, sampleLight, strict=True)]
                    break
        return tuple(a * oneOverRayCount for a in radiance)

    return pixels(scene, lambda vUv: (*raymarch(vUv)[:3], 1.0))


def seed_pass(surface: Texels) -> Texels:
    """The jfa-seed-shader."""

    def shader(vUv):
        alpha = texture(surface, vUv)[3]
        u, v = vUv
        return u * alpha, v * alpha, u * (1.0 - alpha), v * (1.0 - alpha)

    return pixels(surface, shader)


def jfa_pass(texels: Texels, slider: int | None = None) -> Texels:
    """The jfa-shader, as often as the class JFA runs it; ``slider`` is its jfaPassesCount()."""
    h, w = len(texels), len(texels[0])
    this_passes = math.ceil(math.log2(max(w, h)))
    passes = this_passes if slider is None else slider

    def shader(inputTexture, uOffset, skip, vUv):
        if skip:
            return (*vUv, 0.0, 1.0)
        nearestSeed = (0.0, 0.0, 0.0, 0.0)
        nearestDist = 999999.9
        for y in (-1.0, 0.0, 1.0):
            for x in (-1.0, 0.0, 1.0):
                sampleUV = vUv[0] + x * uOffset * (1.0 / w), vUv[1] + y * uOffset * (1.0 / h)
                if out_of_bounds(sampleUV):
                    continue
                sampleSeed = texture(inputTexture, sampleUV)[:2]
                if sampleSeed[0] != 0.0 or sampleSeed[1] != 0.0:
                    diff = sampleSeed[0] - vUv[0], sampleSeed[1] - vUv[1]
                    dist = diff[0] * diff[0] + diff[1] * diff[1]
                    if dist < nearestDist:
                        nearestDist = dist
                        nearestSeed = (*sampleSeed, 0.0, 0.0)
        return nearestSeed

    current, i = texels, 0
    while i < passes or (passes == 0 and i == 0):
        given, offset = current, 2.0 ** (this_passes - i - 1)
        current = pixels(
            given, lambda vUv, t=given, o=offset: shader(t, o, passes == 0, vUv)
        )  # fmt: skip
        i += 1
    return current


def df_pass(jfa: Texels) -> Texels:
    """The dfa-shader."""

    def shader(vUv):
        nearestSeed = texture(jfa, vUv)
        dist = clamp(math.hypot(vUv[0] - nearestSeed[0], vUv[1] - nearestSeed[1]), 0.0, 1.0)
        return dist, dist, dist, 1.0

    return pixels(jfa, shader)


def gi(scene: Texels, uniforms: Gi, slider: int | None = None, last: Texels | None = None):
    """The passes before, and the gi-fragment-shader; ``last`` is lastFrameTexture."""
    distanceTexture = df_pass(jfa_pass(seed_pass(scene), slider))

    def sunAndSky(rayAngle):
        angleToSun = mod(rayAngle - uniforms.sunAngle, TAU)
        sunIntensity = smoothstep(1.0, 0.0, angleToSun)
        return [s * sunIntensity + k for s, k in zip(SUN_COLOR, SKY_COLOR, strict=True)]

    def shader(uv):
        light = texture(scene, uv)
        radiance = [0.0, 0.0, 0.0]
        oneOverRayCount = 1.0 / uniforms.rayCount
        angleStepSize = TAU * oneOverRayCount
        coef = uniforms.time if uniforms.useTemporalAccum else 0.0
        offset = rand((uv[0] + coef, uv[1] + coef)) if uniforms.showNoise else 0.0
        rayAngleStepSize = angleStepSize + offset * TAU if uniforms.showGrain else angleStepSize
        if light[3] < 0.1:
            for i in range(uniforms.rayCount):
                angle = rayAngleStepSize * (float(i) + offset) + uniforms.sunAngle
                rayDirection = math.cos(angle), -math.sin(angle)
                sampleUv = uv
                radDelta = [0.0, 0.0, 0.0]
                hitSurface = False
                for _ in range(1, uniforms.maxSteps):
                    dist = texture(distanceTexture, sampleUv)[0]
                    sampleUv = (
                        sampleUv[0] + rayDirection[0] * dist, sampleUv[1] + rayDirection[1] * dist
                    )  # fmt: skip
                    if out_of_bounds(sampleUv):
                        break
                    if dist < EPS:
                        radDelta = list(texture(scene, sampleUv)[:3])
                        hitSurface = True
                        break
                if not hitSurface and uniforms.enableSun:
                    radDelta = sunAndSky(angle)
                radiance = [a + b for a, b in zip(radiance, radDelta, strict=True)]
        elif math.sqrt(light[0] ** 2 + light[1] ** 2 + light[2] ** 2) >= 0.1:
            radiance = list(light[:3])
        final = [
            max(a, b * oneOverRayCount) for a, b in zip(light[:3], radiance, strict=True)
        ]  # fmt: skip
        if uniforms.useTemporalAccum and uniforms.time > 0.0:
            assert last is not None
            prev = texture(last, uv)
            # mix(x, y, a) = x (1 - a) + y a
            final = [a * (1.0 - 0.9) + b * 0.9 for a, b in zip(final, prev[:3], strict=True)]
        return (*final, 1.0)

    return pixels(scene, shader)
