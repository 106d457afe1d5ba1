"""A fitted shader as a pass in another language, ready to paste.

The formula and the numbers are the fit's own. The loop, its arithmetic and the blend are the same
in all languages; a language says how they are written.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from godfit.errors import InputError
from godfit.models.mitchell import Mitchell
from godfit.report.engines.engine_code import Light, number
from godfit.scattering.conventions import Convention
from godfit.scattering.conventions.convention import LUMA


class Language(NamedTuple):
    """How a language writes the pass.

    ``head`` and ``tail`` stand around the body. ``real``, ``pair`` and ``colour`` are its types,
    ``loop`` begins a loop of COUNT steps over i. ``declare`` declares a variable that changes.
    """

    head: str
    tail: str
    real: str = "float"
    pair: str = "vec2"
    colour: str = "vec3"
    loop: str = "for (int i = 0; i < COUNT; i++) {"
    step: str = "float(i)"
    declare: str = "TYPE NAME = VALUE;"


BODY = """\
REAL E = EXPOSURE;  // exposure
REAL D = DECAY;  // decay, for each tap
REAL R = DENSITY;  // density, of the ray
REAL W = WEIGHT;  // weight
REAL S = SCALE;
COLOUR rays = COLOUR(0.0);
"""
PER_LIGHT = """\
PAIR to_NUMBER = PAIR(LIGHT) - uv;
REAL c_NUMBER = FIRST;
LOOP
  rays += c_NUMBER * occlusion(uv + to_NUMBER * (STEP + 1.0 - LAG) * (R / PARTS));
  c_NUMBER *= D;
}
"""
GLSL = """\
#version 300 es
precision highp float;
uniform sampler2D mask;  // what the light pass reads; linear, clamped to its edge
uniform sampler2D background;  // the ordinary pass
in vec2 uv;  // (0, 0) is the bottom left corner
out vec4 result;
vec3 occlusion(vec2 at) { return READ(texture(mask, at).rgb); }
void main() {
"""
LANGUAGES: dict[str, Language] = {
    "glsl": Language(
        GLSL,
        "vec3 b = texture(background, uv).rgb;\nresult = vec4(BLEND, 1.0);\n}\n",
    ),
    "shadertoy": Language(
        """\
// iChannel0: what the light pass reads; iChannel1: the ordinary pass; both linear and clamped.
vec3 occlusion(vec2 at) { return READ(texture(iChannel0, at).rgb); }
void mainImage(out vec4 result, in vec2 fragCoord) {
  vec2 uv = fragCoord / iResolution.xy;
""",
        "vec3 b = texture(iChannel1, uv).rgb;\nresult = vec4(BLEND, 1.0);\n}\n",
    ),
    "godot": Language(
        """\
shader_type canvas_item;
uniform sampler2D mask : filter_linear, repeat_disable;  // what the light pass reads
uniform sampler2D screen : hint_screen_texture, filter_nearest, repeat_disable;
vec3 occlusion(vec2 at) { return READ(textureLod(mask, at, 0.0).rgb); }
void fragment() {
  vec2 uv = SCREEN_UV;
""",
        "vec3 b = textureLod(screen, uv, 0.0).rgb;\nCOLOR = vec4(BLEND, 1.0);\n}\n",
    ),
    "unity-hlsl": Language(
        """\
#include "Packages/com.unity.render-pipelines.core/Runtime/Utilities/Blit.hlsl"
TEXTURE2D(_Mask);  // what the light pass reads
float3 occlusion(float2 at) {
  return READ(SAMPLE_TEXTURE2D_LOD(_Mask, sampler_LinearClamp, at, 0).rgb);
}
float4 Frag(Varyings input) : SV_Target {
  float2 uv = input.texcoord;
""",
        "float3 b = SAMPLE_TEXTURE2D_LOD(_BlitTexture, sampler_LinearClamp, uv, 0).rgb;\n"
        "return float4(BLEND, 1.0);\n}\n",
        pair="float2",
        colour="float3",
    ),
    "reshade-fx": Language(
        """\
#include "ReShade.fxh"
texture2D MaskTexture < source = "mask.png"; > { Width = BUFFER_WIDTH; Height = BUFFER_HEIGHT; };
sampler2D Mask { Texture = MaskTexture; AddressU = CLAMP; AddressV = CLAMP; };
float3 occlusion(float2 at) { return READ(tex2Dlod(Mask, float4(at, 0.0, 0.0)).rgb); }
float3 Rays(float4 position : SV_Position, float2 uv : TEXCOORD) : SV_Target {
""",
        "float3 b = tex2D(ReShade::BackBuffer, uv).rgb;\nreturn BLEND;\n}\n"
        "technique GodRays { pass { VertexShader = PostProcessVS; PixelShader = Rays; } }\n",
        pair="float2",
        colour="float3",
    ),
    "obs": Language(
        """\
uniform float4x4 ViewProj;
uniform texture2d image;  // the source
uniform texture2d mask;  // what the light pass reads
sampler_state linear_clamp { Filter = Linear; AddressU = Clamp; AddressV = Clamp; };
struct VertData { float4 pos : POSITION; float2 uv : TEXCOORD0; };
VertData VSDefault(VertData v) {
  v.pos = mul(float4(v.pos.xyz, 1.0), ViewProj);
  return v;
}
float3 occlusion(float2 at) { return READ(mask.Sample(linear_clamp, at).rgb); }
float4 mainImage(VertData v) : TARGET {
  float2 uv = v.uv;
""",
        "float3 b = image.Sample(linear_clamp, uv).rgb;\nreturn float4(BLEND, 1.0);\n}\n"
        "technique Draw {\n"
        "  pass { vertex_shader = VSDefault(v); pixel_shader = mainImage(v); }\n}\n",
        pair="float2",
        colour="float3",
    ),
    "wgsl": Language(
        """\
@group(0) @binding(0) var linear_clamp: sampler;
@group(0) @binding(1) var mask: texture_2d<f32>;  // what the light pass reads
@group(0) @binding(2) var background: texture_2d<f32>;  // the ordinary pass
fn occlusion(at: vec2f) -> vec3f {
  return READ(textureSampleLevel(mask, linear_clamp, at, 0.0).rgb);
}
@fragment
fn main(@location(0) uv: vec2f) -> @location(0) vec4f {
""",
        "let b = textureSampleLevel(background, linear_clamp, uv, 0.0).rgb;\n"
        "return vec4f(BLEND, 1.0);\n}\n",
        real="f32",
        pair="vec2f",
        colour="vec3f",
        loop="for (var i: i32 = 0; i < COUNT; i++) {",
        step="f32(i)",
        declare="var NAME: TYPE = VALUE;",
    ),
}
"""Languages with operators. TSL, which has none, has a writer of its own."""


def port(model: Mitchell, language: str, v_down: bool) -> str:
    """The pass of ``model`` in a language. Raises InputError for a composition of several sums."""
    shader = model.convention
    if shader.composed:
        raise InputError(
            f"export: expected a shader of one sum for a port, got '{shader.name}', which composes "
            "several; export to its own engine, or fit another shader"
        )
    lights = [(float(u), 1 - float(v) if v_down else float(v)) for u, v in model.light]
    if language == "tsl":
        return _tsl(model, lights)
    how = LANGUAGES[language]
    body = [_declared(line, how) for line in _filled(BODY, model).splitlines()]
    if shader.own and shader.own_scaled:
        body.append(f"rays += {number(len(lights) * shader.own)} * S * occlusion(uv);")
    elif shader.own:
        body.append(f"rays += {number(len(lights) * shader.own)} * occlusion(uv);")
    for index, light in enumerate(lights, 1):
        text = _filled(PER_LIGHT, model).replace("NUMBER", str(index))
        text = text.replace("LIGHT", f"{number(light[0])}, {number(light[1])}")
        text = text.replace("LOOP", how.loop).replace("COUNT", str(_count(model)))
        body += [_declared(line.replace("STEP", how.step), how) for line in text.splitlines()]
    if shader.power != 1:
        raised = f"pow(max(rays / E, {how.colour}(0.0)), {how.colour}({number(shader.power)}))"
        body.append(f"rays = E * {raised};")
    tail = how.tail.replace("BLEND", _blend(shader))
    head, *rest = how.head.rpartition("\n")[0].splitlines()
    last, _, end = tail.partition("\n}")
    body += last.splitlines()
    lines = [head, *rest, *("  " + line for line in body), *("}" + end).splitlines()]
    return "\n".join(_read(line, shader, how) for line in lines) + "\n"


def _count(model: Mitchell) -> int:
    return int(model.convention.count(int(model.samples)))


def _filled(text: str, model: Mitchell) -> str:
    """``text`` with the model's numbers and its convention's formula."""
    shader, n = model.convention, int(model.samples)
    values = {name: float(value) for name, value in model.values().items()} | shader.absent
    scale = "E" if shader.gain == 1 else f"{number(shader.gain)} * E"
    if shader.averaged:
        scale += f" / {number(n)}"
    if shader.saturated:
        total = float(shader.weights(values["decay"], _count(model)))
        below = number(1 - shader.threshold)
        scale = f"{scale} / ({below} + {scale} * W * {number(total)})"
    first = "S * W" + {0: " * D", 1: ""}.get(shader.order, f" * pow(D, {1 - shader.order}.0)")
    filled = {
        "EXPOSURE": number(values["exposure"]),
        "DECAY": number(values["decay"]),
        "DENSITY": number(values["density"]),
        "WEIGHT": number(values["weight"]),
        "SCALE": scale,
        "FIRST": first,
        "LAG": number(shader.lag),
        "PARTS": number(n - shader.step_drop),
    }
    for key, value in filled.items():
        text = re.sub(rf"\b{key}\b", value, text)
    return text


def _declared(line: str, how: Language) -> str:
    """A line with the language's types, in its form of a declaration."""
    kinds = {"REAL": how.real, "PAIR": how.pair, "COLOUR": how.colour}
    declaration = re.match(r"(REAL|PAIR|COLOUR) (\w+) = (.*);(.*)$", line)
    if declaration:
        kind, name, value, comment = declaration.groups()
        line = how.declare.replace("TYPE", kind).replace("NAME", name) + comment
        line = line.replace("VALUE", value)
    for key, kind in kinds.items():
        line = re.sub(rf"\b{key}\b", kind, line)
    return line


def _read(line: str, shader: Convention, how: Language) -> str:
    """A line in which READ(x) is what the pass reads of x."""
    if "READ(" not in line:
        return line
    before, after = line.split("READ(", 1)
    inner, rest = after.rsplit(");", 1)
    if shader.threshold:
        inner = f"max({inner} - {how.colour}({number(shader.threshold)}), {how.colour}(0.0))"
    if shader.luma:
        weights = ", ".join(map(number, LUMA))
        inner = f"{how.colour}(dot({inner}, {how.colour}({weights})))"
    return f"{before}{inner};{rest}"


def _blend(shader: Convention) -> str:
    if shader.blend == "screen":
        return "b + rays - b * rays"
    if shader.blend == "modulate":
        return "b * (1.0 + rays)"
    gain = "" if shader.background_gain == 1 else f"{number(shader.background_gain)} * "
    return f"{gain}b + rays"


def _tsl(model: Mitchell, lights: list[Light]) -> str:
    """The pass as a function of three.js TSL, which writes operators as methods."""
    shader, n = model.convention, int(model.samples)
    (taps,) = model.taps
    own, first, ratio, step = (
        number(float(z)) for z in (taps.own, taps.first, taps.ratio, taps.step)
    )
    start = number(1 - shader.lag)
    read = "texture(mask, at).rgb"
    if shader.threshold:
        read += f".sub({number(shader.threshold)}).max(0.0)"
    if shader.luma:
        read = f"vec3({read}.dot(vec3({', '.join(map(number, LUMA))})))"
    values = {name: float(value) for name, value in model.values().items()}
    values = {name: values[name] for name in shader.parameters}
    lines = [
        "import { Fn, Loop, float, texture, vec2, vec3, vec4 } from 'three/tsl';",
        f"// {', '.join(f'{key} {number(value)}' for key, value in values.items())}, samples {n}",
        f"const occlusion = (mask, at) => {read};",
        "export const godRays = Fn(([mask, background, uv]) => {",
        f"  const rays = vec3(occlusion(mask, uv)).mul({number(len(lights))} * {own}).toVar();",
    ]
    for index, (u, v) in enumerate(lights, 1):
        lines += [
            f"  const to{index} = vec2({number(u)}, {number(v)}).sub(uv).mul({step});",
            f"  const c{index} = float({first}).toVar();",
            f"  Loop({_count(model)}, ({{ i }}) => {{",
            f"    const at = uv.add(to{index}.mul(float(i).add({start})));",
            f"    rays.addAssign(vec3(occlusion(mask, at)).mul(c{index}));",
            f"    c{index}.mulAssign({ratio});",
            "  });",
        ]
    if shader.power != 1:
        scale = number(float(model.exposure))
        raised = f"rays.div({scale}).max(0.0).pow({number(shader.power)}).mul({scale})"
        lines.append(f"  rays.assign({raised});")
    blend = {
        "screen": "b.add(rays).sub(b.mul(rays))",
        "modulate": "b.mul(rays.add(1.0))",
    }.get(shader.blend, f"b.mul({number(shader.background_gain)}).add(rays)")
    lines += [
        "  const b = texture(background, uv).rgb;",
        f"  return vec4({blend}, 1.0);",
        "});",
    ]
    return "\n".join(lines) + "\n"
