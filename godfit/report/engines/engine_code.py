"""Code for other engines: an effect's own parameters under its own names, ready to paste.

Each function takes the parameters by godfit's names, ``samples`` among them, and the light (u, v)
in the engine's direction of v, and gives lines of code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from godfit.scattering.conventions import CONVENTIONS
from godfit.scattering.conventions.composed import SUN_SHAFTS_REACH


class Slot(NamedTuple):
    """A number that is not known yet: a page fills it in when it is copied. ``before`` and
    ``after`` are what is computed of it: 1 less it, 1 by it, it by a number."""

    name: str
    before: str = ""
    after: str = ""

    def __str__(self) -> str:
        return f"{{{{{self.before}{self.name}{self.after}}}}}"

    def __rsub__(self, one: int) -> Slot:
        return Slot(self.name, before="1-")

    def __rtruediv__(self, one: int) -> Slot:
        return Slot(self.name, before="1/")

    def __truediv__(self, by: float) -> Slot:
        return Slot(self.name, after=f"/{float(by)!r}")


Values = Mapping[str, Any]
"""Numbers, or slots for them, by name."""
Light = tuple[Any, Any]


def number(value: float | int | Slot) -> str:
    """A number with the digits of single precision, and a point."""
    if isinstance(value, Slot):
        return str(value)
    text = f"{value:.9g}"
    return text if any(c in text for c in ".en") else f"{text}.0"


def samples(values: Values) -> str:
    """The number of samples."""
    value = values["samples"]
    return str(value) if isinstance(value, Slot) else str(int(value))


def place(light: Light) -> str:
    return f"{number(light[0])}, {number(light[1])}"


def _names(values: Values, form: str, names: Mapping[str, str]) -> list[str]:
    """A line for every value, in ``form`` with its own name."""
    return [form.format(names[key], number(values[key])) for key in names if key in values]


NUMBERS = ("exposure", "decay", "density", "weight")


def uniforms(values: Values, light: Light, shader: str) -> list[str]:
    """Constants under the uniforms' names."""
    own = CONVENTIONS[shader].names
    known = {key: own[key] for key in NUMBERS if key in own}
    return [
        *_names(values, "const float {} = {};", known),
        f"const int {own['samples']} = {samples(values)};",
        f"const vec2 {own['light']} = vec2({place(light)});",
    ]


def hlsl(values: Values, light: Light, shader: str) -> list[str]:
    own = CONVENTIONS[shader].names
    known = {key: own[key] for key in NUMBERS if key in own}
    return [
        *_names(values, "static const float {} = {};", known),
        f"#define {own['samples']} {samples(values)}",
        f"static const float2 {own['light']} = float2({place(light)});",
    ]


def babylon(values: Values, light: Light, shader: str) -> list[str]:
    return [
        "const rays = new BABYLON.VolumetricLightScatteringPostProcess(",
        f'  "rays", 1.0, camera, mesh, {samples(values)},',
        "  BABYLON.Texture.BILINEAR_SAMPLINGMODE, engine, false);",
        *_names(values, "rays.{} = {};", {key: key for key in NUMBERS}),
        f"// The mesh lies at ({place(light)}) of the screen, u to the right and v up.",
    ]


def pmndrs(values: Values, light: Light, shader: str) -> list[str]:
    blend = "SCREEN" if shader == "screen" else "ADD"
    return [
        "const effect = new GodRaysEffect(camera, lightSource, {",
        f"  samples: {samples(values)},",
        *_names(values, "  {}: {},", {key: key for key in NUMBERS}),
        "  clampMax: 1, blur: false, resolutionScale: 1,",
        f"  blendFunction: BlendFunction.{blend},",
        "});",
        f"// The light source lies at ({place(light)}) of the screen, u to the right and v up.",
    ]


def glsl_godrays(values: Values, light: Light, shader: str) -> list[str]:
    density, weight, decay, exposure = (
        number(values[key]) for key in ("density", "weight", "decay", "exposure")
    )
    return [
        f"vec3 rays = godrays({density}, {weight}, {decay}, {exposure}, "
        f"{samples(values)}, occlusionTexture, vec2({place(light)}), uv);",
    ]


def moonshine(values: Values, light: Light, shader: str) -> list[str]:
    return [
        "effect = moonshine(moonshine.effects.godsray)",
        *_names(values, "effect.godsray.{} = {}", {key: key for key in NUMBERS}),
        f"effect.godsray.samples = {samples(values)}",
        f"effect.godsray.light_position = {{{place(light)}}}",
    ]


def panda3d(values: Values, light: Light, shader: str) -> list[str]:
    density, decay, exposure = (number(values[key]) for key in ("density", "decay", "exposure"))
    return [
        "filters = CommonFilters(base.win, base.cam)",
        f"filters.setVolumetricLighting(caster, numsamples={samples(values)}, "
        f"density={density}, decay={decay}, exposure={exposure})",
        f"# The caster lies at ({place(light)}) of the screen, u to the right and v up.",
    ]


def tsl_radial_blur(values: Values, light: Light, shader: str) -> list[str]:
    weight, decay, exposure = (number(values[key]) for key in ("weight", "decay", "exposure"))
    return [
        "const rays = radialBlur(texture, {",
        f"  center: vec2({place(light)}), weight: float({weight}), decay: float({decay}),",
        f"  count: int({samples(values)}), exposure: float({exposure}),",
        "});",
    ]


def reshade(values: Values, light: Light, shader: str) -> list[str]:
    return [
        "[PPFX_Godrays.fx]",
        f"pGodraysSampleAmount={samples(values)}",
        f"pGodraysSource={number(light[0])},{number(light[1])}",
        f"pGodraysExposure={number(values['exposure'])}",
        f"pGodraysFreq={number(1 / values['density'])}",
        "pGodraysThreshold=0.0",
        f"pGodraysFalloff={number(1 / values['decay'])}",
    ]


def unity_urp(values: Values, light: Light, shader: str) -> list[str]:
    return [
        "resolutionScale = 1f;",
        f"intensity = {number(values['exposure'])}f;  // _Intensity",
        f"blurWidth = {number(values['density'])}f;  // _BlurWidth",
        f"// NUM_SAMPLES {samples(values)}; _Center ({place(light)})",
    ]


def sun_shafts(values: Values, light: Light, shader: str) -> list[str]:
    return [
        "sunShafts.radialBlurIterations = 2;",
        f"sunShafts.sunShaftBlurRadius = {number(values['density'] / SUN_SHAFTS_REACH)}f;",
        f"sunShafts.sunShaftIntensity = {number(values['exposure'])}f;",
        "sunShafts.maxRadius = 1f;",
        f"// sunTransform projects to ({place(light)}), u to the right and v up.",
    ]


def unreal(values: Values, light: Light, shader: str) -> list[str]:
    return [
        f"BloomScale={number(values['exposure'])}",
        "BloomThreshold=0",
        "r.LightShaftBlurPasses=3",
        "r.LightShaftNumSamples=12",
        f"; the light projects to ({place(light)}), u to the right and v up",
    ]


def blender(values: Values, light: Light, shader: str) -> list[str]:
    return [
        "node = scene.node_tree.nodes.new('CompositorNodeSunBeams')",
        f"node.source = ({place(light)})",
        f"node.ray_length = {number(values['density'])}",
        "mix = scene.node_tree.nodes.new('CompositorNodeMixRGB')",
        "mix.blend_type = 'ADD'",
        f"mix.inputs[0].default_value = {number(values['exposure'])}",
    ]


def natron(values: Values, light: Light, shader: str) -> list[str]:
    # The last of its taps lies at 1 - 1/scale of the ray.
    scale = 1 / max(1 - values["density"], 1e-6)
    return [
        f"center: {place(light)} of the picture, from the bottom left",
        f"scale: {number(scale)}",
        "steps: 5",
        f"toColor: {number(values['exposure'])}",
        "gamma: 1",
    ]


def three(values: Values, light: Light, shader: str) -> list[str]:
    return [
        f"uniforms.fGodRayIntensity.value = {number(values['exposure'])};",
        f"uniforms.vSunPositionScreenSpace.value.set({place(light)}, 0);",
    ]


def godot3(values: Values, light: Light, shader: str) -> list[str]:
    return [
        f"shader_param/exposure = {number(values['exposure'])}",
        "shader_param/attenuate = 1.0",
        f"shader_param/num_samples = {samples(values)}",
        "shader_param/dither = 0.0",
        f"; the light projects to ({place(light)}), v down",
    ]


def godot4(values: Values, light: Light, shader: str) -> list[str]:
    return [
        "half_size = false",
        f"radial_blur_samples = {samples(values)}",
        "radial_blur_radius = 150.0",
        f"radial_blur_effect_amount = {number(values['density'])}",
        f"# overlay.glsl: {number(values['exposure'])} in place of 1.5",
        f"# the sun projects to ({place(light)}), v down",
    ]


def jmonkey(values: Values, light: Light, shader: str) -> list[str]:
    near = (1 - abs(light[0] - 0.5)) * (1 - abs(light[1] - 0.5))
    return [
        f"filter.setNbSamples({samples(values)});",
        "filter.setBlurStart(0.02f);",
        f"filter.setBlurWidth({number(values['density'])}f);",
        f"filter.setLightDensity({number(values['exposure'] / max(near, 1e-6))}f);",
        f"// lightPosition projects to ({place(light)}), u to the right and v up.",
    ]


Template = Callable[[Values, Light, str], list[str]]
TEMPLATES: dict[str, Template] = {
    "uniforms": uniforms,
    "hlsl": hlsl,
    "babylon": babylon,
    "pmndrs": pmndrs,
    "glsl-godrays": glsl_godrays,
    "moonshine": moonshine,
    "panda3d": panda3d,
    "tsl-radial-blur": tsl_radial_blur,
    "reshade": reshade,
    "unity-urp": unity_urp,
    "sun-shafts": sun_shafts,
    "unreal": unreal,
    "blender": blender,
    "natron": natron,
    "three": three,
    "godot3": godot3,
    "godot4": godot4,
    "jmonkey": jmonkey,
}
"""The code of each effect, by the name that an engine has for it."""
COMMENTS = {
    "panda3d": "#", "blender": "#", "natron": "#", "godot4": "#", "moonshine": "--",
    "reshade": ";", "unreal": ";", "godot3": ";",
}  # fmt: skip
"""How a comment begins, where not with ``//``."""
