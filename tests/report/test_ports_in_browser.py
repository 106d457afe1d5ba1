"""Ports of a fitted shader, run where a browser has their language: GLSL and Shadertoy's in WebGL2,
WGSL in WebGPU."""

import numpy as np
import pytest

from godfit.models.mitchell import Mitchell
from godfit.report.engines.ports import port
from tests.support.browser import launching

SHADERS = ("dawntime", "babylon", "pmndrs", "radial-blur", "reshade", "mean", "godot3")
LANGUAGES = ("glsl", "shadertoy", "wgsl")
SIZE = (24, 40)
LIGHTS = ((0.3, 0.8), (0.62, 0.41))
TOLERANCE = 0.1
"""Levels by which a port may differ from the program."""
WEBGPU = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--no-sandbox")
SHADERTOY = """#version 300 es
precision highp float;
uniform sampler2D iChannel0, iChannel1;
uniform vec3 iResolution;
out vec4 shown;
CODE
void main() { mainImage(shown, gl_FragCoord.xy); }
"""
WEBGL = """
async ({code, names, images, size}) => {
  const [w, h] = size, canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = size;
  const gl = canvas.getContext('webgl2');
  gl.getExtension('EXT_color_buffer_float');
  const vertex = `#version 300 es
    out vec2 uv;
    void main() {
      uv = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.;
      gl_Position = vec4(uv * 2. - 1., 0., 1.);
    }`;
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, code]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) return gl.getShaderInfoLog(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return gl.getProgramInfoLog(program);
  const texture = (format, kind, values) => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, w, h, 0, gl.RGBA, kind, values);
    const linear = values ? gl.LINEAR : gl.NEAREST;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, linear);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, linear);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return made;
  };
  const into = texture(gl.RGBA32F, gl.FLOAT, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, into, 0);
  gl.useProgram(program);
  images.forEach((image, unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    texture(gl.RGBA8, gl.UNSIGNED_BYTE, Uint8Array.from(image));
    gl.uniform1i(gl.getUniformLocation(program, names[unit]), unit);
  });
  gl.uniform3f(gl.getUniformLocation(program, 'iResolution'), w, h, 1);
  gl.viewport(0, 0, w, h);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  const out = new Float32Array(w * h * 4);
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.FLOAT, out);
  return Array.from(out);
}
"""
WEBGPU_DRAW = """
async ({code, images, size}) => {
  const adapter = await navigator.gpu?.requestAdapter();
  if (!adapter) return 'no adapter';
  const device = await adapter.requestDevice(), [w, h] = size;
  const vertex = `
    struct Corner { @builtin(position) at: vec4f, @location(0) uv: vec2f }
    @vertex fn corner(@builtin(vertex_index) i: u32) -> Corner {
      let uv = vec2f(f32(i & 1u), f32(i >> 1u)) * 2.0;
      return Corner(vec4f(uv.x * 2.0 - 1.0, 1.0 - uv.y * 2.0, 0.0, 1.0), uv);
    }`;
  const module = device.createShaderModule({code});
  const said = (await module.getCompilationInfo()).messages.map((m) => m.message);
  if (said.length) return said.join('; ');
  const texture = (format, usage) => device.createTexture({size, format, usage});
  const into = texture('rgba32float', GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC);
  const views = images.map((image) => {
    const made = texture('rgba8unorm', GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST);
    device.queue.writeTexture({texture: made}, Uint8Array.from(image), {bytesPerRow: w * 4}, size);
    return made.createView();
  });
  const pipeline = device.createRenderPipeline({
    layout: 'auto', vertex: {module: device.createShaderModule({code: vertex})},
    fragment: {module, targets: [{format: 'rgba32float'}]},
  });
  const sampler = device.createSampler({magFilter: 'linear', minFilter: 'linear'});
  const entries = [sampler, ...views].map((resource, binding) => ({binding, resource}));
  const group = device.createBindGroup({layout: pipeline.getBindGroupLayout(0), entries});
  const row = Math.ceil(w * 16 / 256) * 256;
  const usage = GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ;
  const read = device.createBuffer({size: row * h, usage});
  const encoder = device.createCommandEncoder();
  const pass = encoder.beginRenderPass({
    colorAttachments: [{view: into.createView(), loadOp: 'clear', storeOp: 'store'}],
  });
  pass.setPipeline(pipeline);
  pass.setBindGroup(0, group);
  pass.draw(3);
  pass.end();
  encoder.copyTextureToBuffer({texture: into}, {buffer: read, bytesPerRow: row}, size);
  device.queue.submit([encoder.finish()]);
  await read.mapAsync(GPUMapMode.READ);
  const all = new Float32Array(read.getMappedRange()), out = [];
  for (let y = 0; y < h; y++) out.push(...all.subarray(y * row / 4, y * row / 4 + w * 4));
  return out;
}
"""


def images():
    """A mask of edges and noise, and an ordinary pass: (h, w, 3) bytes. The mask is above ReShade's
    threshold, which a port applies to what is filtered, and the program to texels."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / max(SIZE)
    bars = ((8 * x).astype(int) % 2 == 0) & (np.hypot(x - 0.6, y - 0.3) > 0.12)
    mask = (180 + 50 * bars[..., None] + 25 * rng.random((*SIZE, 3))).astype(np.uint8)
    return mask, (80 * rng.random((*SIZE, 3))).astype(np.uint8)


def drawn(page, language, model):
    """(h, w, 3) what the browser computes of a port."""
    code, down = port(model, language, language == "wgsl"), language == "wgsl"
    rows = slice(None) if down else slice(None, None, -1)
    packed = [
        np.dstack([im, np.full(SIZE, 255, np.uint8)])[rows].ravel().tolist() for im in images()
    ]
    given = {"code": code, "images": packed, "size": [SIZE[1], SIZE[0]]}
    if language == "shadertoy":
        given |= {"code": SHADERTOY.replace("CODE", code), "names": ["iChannel0", "iChannel1"]}
    elif language == "glsl":
        given["names"] = ["mask", "background"]
    found = page.evaluate(WEBGPU_DRAW if down else WEBGL, given)
    if found == "no adapter":
        pytest.skip("this browser has no WebGPU here")
    assert not isinstance(found, str), (language, model.shader, found)
    return np.array(found).reshape(*SIZE, 4)[rows, :, :3]


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    # WebGPU is only there on a page of its own, and not on about:blank.
    blank = tmp_path_factory.mktemp("page") / "blank.html"
    blank.write_text("<html></html>")
    with launching() as launch:
        found = {}
        for languages, options in ((("glsl", "shadertoy"), ()), (("wgsl",), WEBGPU)):
            page = launch(*options).new_page()
            page.goto(blank.as_uri())
            found |= dict.fromkeys(languages, page)
        yield found


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_port_draws_the_programs_picture(language, pages):
    mask, background = (image / np.float32(255) for image in images())
    for shader in SHADERS:
        absent = Mitchell(0.13, 0.93, 0.77, 0.6, LIGHTS[0], shader, 20).absent
        numbers = {"exposure": 0.13, "decay": 0.93, "density": 0.77, "weight": 0.6} | absent
        model = Mitchell(*numbers.values(), LIGHTS, shader, 20)
        expected = np.asarray(model(mask, background))
        # Rays must be there to be wrong, by a level or more.
        assert 255 * np.std(expected - background) > 1, shader
        off = 255 * np.abs(drawn(pages[language], language, model) - expected).max()
        assert off < TOLERANCE, (shader, off)
