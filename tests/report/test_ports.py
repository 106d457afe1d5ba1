"""Ports of a fitted shader: what their loops compute, and whether compilers take them."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from godfit.errors import InputError
from godfit.models.mitchell import Mitchell
from godfit.report.engines.ports import LANGUAGES, port
from godfit.scattering.engines import ENGINES
from tests.support import scattering_oracle as oracle

MASK = np.random.default_rng(0).random((7, 9, 3))
BACKGROUND = np.random.default_rng(1).random((7, 9, 3))
POINT = (0.13, 0.93, 0.77, 0.6)
LIGHTS = [(0.3, 0.8), (0.6, 0.4)]
SHADERS = ("dawntime", "babylon", "pmndrs", "radial-blur", "reshade", "mean", "godot3")
ENTRY = r"(main\(\)|mainImage\(.*|fragment\(\)|Frag\(.*|Rays\(.*|main\(@.*) \{\n"
VERSION = "#version 300 es\nprecision highp float;\n"


def model(shader, lights=LIGHTS):
    absent = Mitchell(*POINT, LIGHTS[0], shader, 6).absent
    numbers = dict(zip(("exposure", "decay", "density", "weight"), POINT, strict=True)) | absent
    return Mitchell(*numbers.values(), lights, shader, 6)


def as_python(code):
    """The body of a port in a language with operators as Python: (lines, the result's value)."""
    body = code[re.search(ENTRY, code).end() :]
    lines, inside = [], ""
    for line in body.splitlines():
        text = re.sub(r"//.*", "", line).strip().rstrip(";")
        loop = re.search(r"i < (\d+)", text)
        if loop:
            lines.append(f"for i in range({loop[1]}):")
            inside = "    "
        elif text.startswith("}"):
            if not inside:
                return lines
            inside = ""
        elif text:
            text = re.sub(r"^(let|var) ", "", text)
            text = re.sub(r"^(float|vec\d|float\d) (\w+) =", r"\2 =", text)
            text = re.sub(r"^(\w+): \w+ =", r"\1 =", text)
            text = re.sub(r"^return ", "COLOR = ", text)
            lines.append(inside + text)
    raise AssertionError("no end of the body")


def evaluated(code, lights_down):
    """(h, w, 3) what a port computes, by numpy in float64."""
    u, v = oracle.pixel_centres(*MASK.shape[:2])
    uv = np.stack([u, 1 - v if lights_down else v], -1)

    def read(image, at):
        v = 1 - at[..., 1] if lights_down else at[..., 1]
        return np.stack([oracle.texture(image[..., c], at[..., 0], v) for c in range(3)], -1)

    def vector(*parts):
        if len(parts) == 2 and np.ndim(parts[0]) == 3:
            return parts[0]
        return np.array(parts) if len(parts) > 1 else np.broadcast_to(parts[0], (7, 9, 3)) + 0.0

    inner = re.search(r"return (.*?(?:rgb|\)\)\)|\)\))(?:.*?));", code.replace("\n", " "))[1]
    threshold = re.search(r"- \w+\((0?\.\d+)\)", inner)

    def occlusion(at):
        mask = np.maximum(MASK - float(threshold[1]), 0) if threshold else MASK
        if "dot(" in inner:
            mask = np.repeat((mask @ [0.2126, 0.7152, 0.0722])[..., None], 3, -1)
        return read(mask, at)

    names = {"occlusion": occlusion, "uv": uv, "b": read(BACKGROUND, uv), "pow": np.power}
    names |= dict.fromkeys(("vec2", "vec3", "vec4", "float2", "float3", "float4"), vector)
    names |= dict.fromkeys(("vec2f", "vec3f", "vec4f"), vector)
    names |= {"float": float, "f32": float, "max": np.maximum}
    lines = [
        line for line in as_python(code) if not re.match(r"(b|uv) = ", line.strip())
    ]  # the background and the place are given
    exec("\n".join(lines), names)
    return names["result"] if "result" in names else names["COLOR"]


@pytest.mark.parametrize("shader", SHADERS)
@pytest.mark.parametrize("language", LANGUAGES)
def test_a_port_computes_the_picture(language, shader):
    fitted = model(shader)
    down = ENGINES[language].v_down
    expected = np.asarray(fitted(MASK, BACKGROUND))
    actual = evaluated(port(fitted, language, down), down)
    np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=1e-7)


def test_a_composition_has_no_port():
    with pytest.raises(InputError, match="sun-shafts") as caught:
        port(model("sun-shafts"), "glsl", False)
    assert "\n" not in str(caught.value)


def glsl(code, language):
    if language == "glsl":
        return code
    if language == "shadertoy":
        uniforms = "uniform sampler2D iChannel0, iChannel1;\nuniform vec3 iResolution;\n"
        end = "out vec4 shown;\nvoid main() { mainImage(shown, gl_FragCoord.xy); }\n"
        return VERSION + uniforms + code + end
    code = code.replace(
        "shader_type canvas_item;\n", VERSION + "in vec2 SCREEN_UV;\nout vec4 COLOR;\n"
    )
    return re.sub(r" : [\w, ]+;", ";", code).replace("fragment()", "main()")


def hlsl(code, language):
    if language == "unity-hlsl":
        stubs = (
            "#define TEXTURE2D(name) Texture2D name\n"
            "#define SAMPLE_TEXTURE2D_LOD(t, s, at, lod) t.SampleLevel(s, at, lod)\n"
            "SamplerState sampler_LinearClamp;\nTexture2D _BlitTexture;\n"
            "struct Varyings { float4 position : SV_POSITION; float2 texcoord : TEXCOORD0; };\n"
        )
        return stubs + re.sub(r"#include.*\n", "", code)
    if language == "reshade-fx":
        # Its textures and samplers are one; its include holds what is drawn on.
        code = re.sub(r"#include.*\n|(texture2D|sampler2D) \w+.*\n", "", code)
        code = code.replace("tex2Dlod(Mask, float4(at, 0.0, 0.0))", "mask.Sample(clamped, at)")
        code = code.replace("tex2D(ReShade::BackBuffer, uv)", "back.Sample(clamped, uv)")
        stubs = "SamplerState clamped;\nTexture2D mask;\nTexture2D back;\n"
        return stubs + code[: code.index("technique")]
    code = code[: code.index("technique")].replace("texture2d", "Texture2D")
    code = re.sub(r"sampler_state (\w+) \{.*?\};", r"SamplerState \1;", code)
    return code.replace("POSITION", "SV_POSITION").replace("TARGET", "SV_Target")


@pytest.mark.skipif(shutil.which("glslangValidator") is None, reason="no glslang here")
@pytest.mark.parametrize(
    "language", ["glsl", "shadertoy", "godot", "unity-hlsl", "reshade-fx", "obs"]
)
def test_a_compiler_takes_it(language, tmp_path):
    """Godot's, Unity's, ReShade's and OBS's own words are replaced by GLSL's and HLSL's first."""
    for shader in SHADERS:
        code = port(model(shader), language, ENGINES[language].v_down)
        file = tmp_path / f"{shader}.frag"
        entries = {"unity-hlsl": "Frag", "reshade-fx": "Rays", "obs": "mainImage"}
        entry = entries.get(language)
        file.write_text(hlsl(code, language) if entry else glsl(code, language))
        options = ["-D", "-S", "frag", "-e", entry, "-V"] if entry else ["-S", "frag"]
        out = ["-o", str(tmp_path / "out.spv")] if entry else []
        done = subprocess.run(
            ["glslangValidator", *options, *out, str(file)], capture_output=True, text=True
        )
        assert done.returncode == 0, (shader, done.stdout, file.read_text())


@pytest.mark.skipif(shutil.which("node") is None, reason="no node here")
def test_node_parses_tsl(tmp_path):
    for shader in SHADERS:
        file = tmp_path / f"{shader}.mjs"
        file.write_text(port(model(shader), "tsl", False))
        done = subprocess.run(["node", "--check", str(file)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
