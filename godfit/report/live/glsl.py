"""Fragment shaders in GLSL ES 3.00, generated from the fields of a convention.

One template serves all conventions: the coefficients of its taps are constants in the text, and
the parameters and the number of samples are uniforms. A ``box`` or ``blurs`` convention
runs one program for each of its passes.
"""

from __future__ import annotations

from godfit.scattering.conventions import Convention
from godfit.scattering.conventions.convention import LUMA

MOST_SAMPLES = 100_000
"""Samples of a slider, at most, where the shader's loop has no end of its own."""

HEAD = """#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D mask;    // what this pass reads
uniform highp sampler2D before;  // the light passes of the lights before this one
uniform vec2 light;              // texture coordinates, v up
uniform vec2 whole;              // width and height of the picture in pixels
uniform float stride, rows;      // every stride-th pixel is drawn, in so many rows
uniform float exposure, decay, density, weight, span;
uniform int samples;
uniform bool filtered, adding, first, last;
out vec4 colour;

// Pixel centres are counted from the top left, as the program counts them.
vec2 place() {
  vec2 cell = floor(gl_FragCoord.xy);
  vec2 down = vec2(cell.x, rows - 1. - cell.y) * stride + .5;
  return vec2(down.x / whole.x, 1. - down.y / whole.y);
}

// What the first pass takes from a texel of the mask.
vec3 texel(ivec2 at) {
  vec3 value = texelFetch(mask, at, 0).rgb;
  return first ? FIRST : value;
}

// The mask, bilinear and clamped to its edge, where the texture unit filters no floats, or where
// what is taken of a texel is not linear.
vec3 bilinear(vec2 uv) {
  ivec2 size = textureSize(mask, 0);
  vec2 at = uv * vec2(size) - .5, low = floor(at), part = at - low;
  ivec2 none = ivec2(0), end = size - 1;
  ivec2 a = clamp(ivec2(low), none, end), b = clamp(ivec2(low) + 1, none, end);
  vec3 bottom = mix(texel(a), texel(ivec2(b.x, a.y)), part.x);
  vec3 top = mix(texel(ivec2(a.x, b.y)), texel(b), part.x);
  return mix(bottom, top, part.y);
}

vec3 tap(vec2 uv) {
  if (!filtered || (first && CURVED)) return bilinear(uv);
  vec3 value = texture(mask, uv).rgb;
  return first ? FIRST : value;
}
"""
"""What all programs share; FIRST is what the first pass takes from a mask's ``value``, CURVED
whether that is not linear."""
RAY = """
void main() {
  float ratio = DECAY, heavy = WEIGHT;
  int count = min(samples - DROP, MOST);
  vec2 uv = place(), delta = (light - uv) * (DENSITY / float(samples - STEP_DROP));
  float scale = GAIN * exposure AVERAGED, c = AHEAD, total = 0.;
  vec3 sum = vec3(0.);
  for (int i = 1; i <= count; i++) {
    sum += c * tap(uv + (float(i) - LAG) * delta);
    total += c;
    c *= ratio;
  }
  if (SATURATED) scale /= 1. - THRESHOLD + scale * heavy * total;
  sum = OWN * tap(uv) + scale * heavy * sum;
  CURVE
  if (adding) sum += texelFetch(before, ivec2(gl_FragCoord.xy), 0).rgb;
  colour = vec4(sum, 1.);
}
"""
"""A sum along the ray, with a weight that decays."""
MEAN = """
void main() {
  vec2 uv = place(), delta = (light - uv) * (span * DENSITY);
  vec3 sum = vec3(0.);
  for (int k = 0; k < TAPS; k++) sum += tap(uv + float(k) * delta);
  sum /= float(TAPS);
  if (last) sum *= exposure;
  if (last && adding) sum += texelFetch(before, ivec2(gl_FragCoord.xy), 0).rgb;
  colour = vec4(sum, 1.);
}
"""
"""A mean of equal taps along the ray, ``span`` times the density apart."""
BOX = """
void main() {
  vec2 uv = place(), ray = light - uv;
  float far = length(ray);
  vec3 sum = tap(uv);
  for (int k = 1; k <= 5; k++)
    if (far > 0. && float(k) * span <= far) sum += tap(uv + (float(k) * span / far) * ray);
  sum /= 6.;
  if (last) sum = exposure * (1. - sum);
  if (last && adding) sum += texelFetch(before, ivec2(gl_FragCoord.xy), 0).rgb;
  colour = vec4(sum, 1.);
}
"""
"""A mean of six taps, ``span`` apart in texture coordinates. Taps beyond the light have no
weight."""


def is_drawn(shader: Convention) -> bool:
    """Whether a page draws a convention's pass: a sum over taps, or a chain of such sums."""
    return not shader.passes


def fragment_shader(shader: Convention) -> str:
    """The program of each pass of a convention, in GLSL ES 3.00."""
    taken = "1. - value" if shader.box else "value"
    if shader.threshold:
        taken = f"max({taken} - {shader.threshold!r}, 0.)"
    if shader.luma:
        taken = f"vec3(dot({taken}, vec3{LUMA}))"
    body = BOX if shader.box else MEAN if shader.blurs else RAY
    own = f"{float(shader.own)!r}"
    curve = f"sum = {shader.gain!r} * exposure * pow(max(sum / ({shader.gain!r} * exposure), 0.), "
    fields = {
        "FIRST": taken,
        "CURVED": _truth(bool(shader.threshold)),
        "SATURATED": _truth(shader.saturated),
        "AVERAGED": "/ float(samples)" if shader.averaged else "",
        "GAIN": f"{shader.gain!r}",
        "OWN": f"{own} * scale" if shader.own_scaled else own,
        "STEP_DROP": f"{shader.step_drop}",
        "DROP": f"{shader.drop}",
        "MOST": f"{MOST_SAMPLES if shader.most_taps is None else shader.most_taps}",
        "LAG": f"{float(shader.lag)!r}",
        "THRESHOLD": f"{float(shader.threshold)!r}",
        # Where decay is applied before a tap, the first one has it already.
        "AHEAD": "ratio" if shader.order == 0 else "1.",
        "CURVE": "" if shader.power == 1 else f"{curve}vec3({float(shader.power)!r}));",
        "TAPS": f"{shader.blur_taps}",
        **{name.upper(): _number(shader, name) for name in ("decay", "density", "weight")},
    }
    text = HEAD + body
    for field in sorted(fields, key=len, reverse=True):
        text = text.replace(field, fields[field])
    return text


def _truth(value: bool) -> str:
    return "true" if value else "false"


def _number(shader: Convention, name: str) -> str:
    """A parameter's uniform, or what stands for it where the formula lacks it."""
    return f"{float(shader.absent[name])!r}" if name in shader.absent else name


def _spans(shader: Convention) -> list[float]:
    """The ``span`` of each pass."""
    if shader.blurs:
        whole = (shader.blur_taps - 1) * sum(shader.blurs)
        return [part / whole for part in shader.blurs]
    return list(shader.box) or [0.0]


def described(shader: Convention) -> dict[str, object]:
    """What the page has to know of a convention: its program, the steps of its passes, how it is
    composited, and its formula."""
    return {
        "glsl": fragment_shader(shader),
        "spans": _spans(shader),
        "screen": shader.blend == "screen",
        "background_gain": shader.background_gain,
        "formula": shader.formula,
        "parameters": list(shader.parameters),
        "samples": not (shader.box or shader.blurs),
    }
