"""Fragment shaders in GLSL ES 3.00, generated from the fields of a convention.

One template serves all conventions: the coefficients of its taps are constants in the text, and
the parameters and the number of samples are uniforms. A ``box`` convention runs one program for
each of its steps.
"""

from __future__ import annotations

from godfit.scattering.conventions import Convention

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

// The mask, bilinear and clamped to its edge, where the texture unit filters no floats.
vec3 bilinear(vec2 uv) {
  ivec2 size = textureSize(mask, 0);
  vec2 at = uv * vec2(size) - .5, low = floor(at), part = at - low;
  ivec2 none = ivec2(0), end = size - 1;
  ivec2 a = clamp(ivec2(low), none, end), b = clamp(ivec2(low) + 1, none, end);
  vec3 bottom = mix(texelFetch(mask, a, 0).rgb, texelFetch(mask, ivec2(b.x, a.y), 0).rgb, part.x);
  vec3 top = mix(texelFetch(mask, ivec2(a.x, b.y), 0).rgb, texelFetch(mask, b, 0).rgb, part.x);
  return mix(bottom, top, part.y);
}

vec3 tap(vec2 uv) {
  vec3 value = filtered ? texture(mask, uv).rgb : bilinear(uv);
  return first ? FIRST : value;
}
"""
"""What all programs share; FIRST is what the first pass takes from a mask's ``value``."""
RAY = """
void main() {
  vec2 uv = place(), delta = (light - uv) * (density / float(samples));
  float scale = GAIN * exposure, c = scale * weight * AHEAD;
  vec3 sum = OWN * scale * tap(uv);
  for (int i = 1; i <= samples - DROP; i++) {
    sum += c * tap(uv + float(i) * delta);
    c *= decay;
  }
  if (adding) sum += texelFetch(before, ivec2(gl_FragCoord.xy), 0).rgb;
  colour = vec4(sum, 1.);
}
"""
"""A sum along the ray, with a weight that decays."""
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


def fragment_shader(shader: Convention) -> str:
    """The program of each pass of a convention, in GLSL ES 3.00."""
    if shader.box:
        return HEAD.replace("FIRST", "1. - value") + BOX
    fields = {
        "GAIN": f"{shader.gain!r}",
        "OWN": f"{float(shader.own)!r}",
        "DROP": f"{shader.drop}",
        # Where decay is applied before a tap, the first one has it already.
        "AHEAD": "decay" if shader.order == 0 else "1.",
    }
    body = RAY
    for field, value in fields.items():
        body = body.replace(field, value)
    return HEAD.replace("FIRST", "value") + body


def described(shader: Convention) -> dict[str, object]:
    """What the page has to know of a convention: its program, the steps of its passes, how it is
    composited, and its formula."""
    return {
        "glsl": fragment_shader(shader),
        "spans": list(shader.box) or [0.0],
        "screen": shader.blend == "screen",
        "background_gain": shader.background_gain,
        "formula": shader.formula,
        "parameters": list(shader.parameters),
        "samples": not shader.box,
    }
