"""Other engines' names for the numbers of a sum, and the algebra between conventions.

Inside Mitchell's family a translation is algebra. From the numbers of a set of taps (own, first,
ratio, step, count), with a convention's own factor, gain, exponent offset e and dropped samples:

    samples = count + drop        decay = ratio        density = step * samples
    exposure = own / gain         weight = first * decay**(e - 1) / (gain * exposure)

Where there is no own pixel, the exposure is the target's default and the weight follows from it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

from godfit.errors import InputError
from godfit.scattering.conventions import CONVENTIONS, Convention
from godfit.scattering.taps import Taps

ROUNDING = 1e-6
"""Rounding error by which a translated number may exceed its range, or a fixed one differ."""
LEAST_FACTOR = 1e-30
"""Least factor that is divided by: an exposure or a weight of 0 is allowed."""
BRIGHTEST = 0.999
"""Share of a saturated sum's limit above which no exposure reaches it."""


class TapNumbers(NamedTuple):
    """The five numbers of a set of taps and its lag, see ``Taps``."""

    own: float
    first: float
    ratio: float
    step: float
    count: int
    lag: float = 0.0

    @staticmethod
    def of(taps: Taps) -> TapNumbers:
        """Those of taps whose count is known."""
        own, first, ratio, step, lag = (
            float(z) for z in (taps.own, taps.first, taps.ratio, taps.step, taps.lag)
        )
        return TapNumbers(own, first, ratio, step, int(taps.count), lag)


class Translation(NamedTuple):
    """Parameters and samples of another convention, by godfit's names, and ``own_pixel``: the
    factor of the pixel's own value there, less that of the taps. All other taps are the same."""

    values: dict[str, float]
    own_pixel: float


def translated(taps: TapNumbers, target: Convention, exposure: float | None = None) -> Translation:
    """The parameters with which ``target`` has the same taps, the pixel's own perhaps excepted.

    ``exposure`` is what no tap determines where the target has no own pixel; by default the
    target's own default, or 1. A threshold and a luma of the target are taken to be off. Raises
    InputError, with the reason, where no parameters give these taps.
    """
    name = target.name

    def impossible(expected: str, got: str) -> InputError:
        return InputError(f"{name}: expected {expected}, got {got}")

    target = dataclasses.replace(target, threshold=0.0, luma=False)
    if target.composed or target.power != 1:
        raise InputError(f"{name}: expected a single sum of taps, got a composition of several")
    if abs(taps.lag - target.lag) > ROUNDING:
        raise impossible(f"taps at a lag of {target.lag:g}", f"a lag of {taps.lag:g}")
    if target.most_taps is not None and taps.count > target.most_taps:
        raise impossible(f"at most {target.most_taps} taps", f"{taps.count}")
    samples = max(taps.count + target.drop, 2)
    density = taps.step * (samples - target.step_drop)
    found = {"decay": taps.ratio, "density": density}
    for key, value in found.items():
        fixed = target.absent.get(key)
        if fixed is not None and abs(value - fixed) > ROUNDING:
            raise impossible(f"a {key} of {fixed:g}, as it has no other", f"{value:.6g}")
    if density > target.most_density * (1 + ROUNDING):
        raise impossible(f"a density of at most {target.most_density:g}", f"{density:.6g}")
    found["density"] = min(density, target.most_density)
    # Exposure, with what scales it, times weight; then the exposure alone.
    product = taps.first * taps.ratio ** (target.order - 1) if taps.ratio else taps.first
    factor = target.gain / (samples if target.averaged else 1)
    if "weight" in target.absent:
        scale = product / target.absent["weight"]
    elif target.own_pixel and taps.own > 0:
        scale = taps.own / target.own
    else:
        default = target.defaults.get("exposure", 1.0) if exposure is None else exposure
        scale = factor * default
    found["weight"] = product / max(scale, LEAST_FACTOR)
    own = target.own * (scale if target.own_scaled else 1.0)
    if target.saturated:
        total = float(target.weights(taps.ratio, target.count(samples)))
        if scale * total > BRIGHTEST:
            raise impossible("a sum of weights below 1, its limit", f"{scale * total:.4g}")
        scale = scale / (1 - scale * total)
    found["exposure"] = scale / factor
    order = {key: found[key] for key in target.parameters}
    return Translation({**order, "samples": float(samples)}, own - taps.own)


class Engine(NamedTuple):
    """An engine's effect, or a language: what ``--to NAME`` gives.

    ``convention`` is the name of its sum, "" for a port of the user's own. ``template`` names the
    code that is printed. ``options`` are what makes the engine exact, ``v_down`` is whether its
    v runs down, and ``blends`` are the blends that it can be given.
    """

    name: str
    title: str
    convention: str = ""
    template: str = ""
    options: tuple[str, ...] = ()
    v_down: bool = False
    blends: tuple[str, ...] = ("add",)

    @property
    def kind(self) -> str:
        """``"exact"`` where the translation is algebra, ``"near"`` where a refit, or ``"port"``."""
        if not self.convention:
            return "port"
        shader = CONVENTIONS[self.convention]
        return "near" if shader.composed or shader.lag or self.template == "natron" else "exact"


ENGINES: dict[str, Engine] = {
    engine.name: engine
    for engine in (
        Engine("mitchell", "GPU Gems 3, listing 13-1", "mitchell", "hlsl", v_down=True),
        Engine("dawntime", "DawnTime's sliders", "dawntime", "uniforms"),
        Engine("vesper", "Vesper's sliders", "vesper", "uniforms"),
        Engine("article-glsl", "the article's GLSL", "article-glsl", "uniforms"),
        Engine("article-hlsl", "the article's HLSL", "article-hlsl", "hlsl", v_down=True),
        Engine(
            "babylon", "Babylon.js VolumetricLightScatteringPostProcess", "babylon", "babylon",
            ("ratio 1.0, so that the light pass has the picture's size",),
        ),
        Engine(
            "pmndrs", "pmndrs/postprocessing GodRaysEffect, @react-three/postprocessing GodRays",
            "pmndrs", "pmndrs",
            ("blur: false, resolutionScale: 1, clampMax: 1",), blends=("screen", "add"),
        ),
        Engine("additive", "a hand-written additive shader", "additive", "uniforms"),
        Engine("glsl-godrays", "glsl-godrays", "glsl-godrays", "glsl-godrays"),
        Engine("moonshine", "LÖVE moonshine, godsray", "moonshine", "moonshine", v_down=True),
        Engine(
            "panda3d", "Panda3D CommonFilters.setVolumetricLighting", "panda3d", "panda3d",
        ),
        Engine(
            "tsl-radial-blur", "three.js TSL radialBlur", "radial-blur", "tsl-radial-blur",
            ("its taps are jittered by up to a step: equal in the mean, not pixel by pixel",),
        ),
        Engine(
            "reshade", "ReShade PPFX_Godrays", "reshade", "reshade",
            ("pGodraysThreshold 0: the mask is what the pass reads",
             "the rays are grey: the luma of a coloured mask",
             "its border is black: rays that leave the picture are darker"),
            v_down=True,
        ),
        Engine(
            "unity-urp", "Unity URP VolumetricLightScattering", "mean", "unity-urp",
            ("resolutionScale 1",),
        ),
        Engine("unity-sun-shafts", "Unity Standard Assets SunShafts", "sun-shafts", "sun-shafts",
               ("resolution High, radialBlurIterations 2, maxRadius 1, sunThreshold black",),
               blends=("screen", "add")),
        Engine("unreal", "Unreal light shaft bloom", "light-shafts", "unreal",
               ("r.LightShaftDownSampleFactor 1, r.LightShaftBlurPasses 3, "
                "r.LightShaftNumSamples 12, BloomThreshold 0",)),
        Engine("blender", "Blender Sun Beams node", "sun-beams", "blender",
               ("add the node's image with a Mix node, Add, of this factor",)),
        Engine("natron", "Natron GodRays", "mean", "natron", ("steps 5: 2^5 taps",)),
        Engine("three", "three.js GodRaysShader", "three", "three"),
        Engine("godot3", "Godot 3, Godot-God-Rays-Plugin", "godot3", "godot3",
               ("dither 0, attenuate 1, a light that fills the mask",), v_down=True),
        Engine("godot4", "Godot 4, RERadialSunRays", "godot4", "godot4",
               ("half_size false",), v_down=True, blends=("modulate",)),
        Engine("jmonkey", "jMonkeyEngine LightScatteringFilter", "jmonkey", "jmonkey",
               blends=("towards",)),
        Engine("glsl", "a fragment shader, GLSL ES 3.00", template="glsl"),
        Engine("shadertoy", "Shadertoy, mainImage", template="shadertoy"),
        Engine("godot", "Godot 4 canvas_item shader", template="godot", v_down=True),
        Engine("unity-hlsl", "Unity HLSL, Full Screen Pass", template="unity-hlsl", v_down=True),
        Engine("reshade-fx", "a ReShade FX effect", template="reshade-fx", v_down=True),
        Engine("obs", "an OBS shader filter effect", template="obs", v_down=True),
        Engine("wgsl", "a WGSL fragment function", template="wgsl", v_down=True),
        Engine("tsl", "a three.js TSL function", template="tsl"),
    )
}  # fmt: skip
"""What a fit can be exported to, by name, exact ones before near ones before ports."""


def equivalents(
    taps: TapNumbers, shader: Convention, background: bool, exposure: float | None = None
) -> Mapping[str, Translation]:
    """The shipped conventions whose picture is that of these taps of ``shader``, with their
    parameters; with a ``background``, those that also blend it alike. ``exposure`` as in
    ``translated``."""
    found: dict[str, Translation] = {}
    blending = (shader.blend, shader.background_gain)
    for other in CONVENTIONS.values():
        if other.key == shader.key or not other.plain or other.own_scaled != shader.own_scaled:
            continue
        if background and (other.blend, other.background_gain) != blending:
            continue
        try:
            one = translated(taps, other, exposure)
        except InputError:
            continue
        if abs(one.own_pixel) <= ROUNDING * max(abs(taps.own), abs(taps.first)):
            found[other.name] = one
    return found
