// The live page of a result: the shader in WebGL2 on the mask, with the fitted numbers as sliders.
// render({model, el}) is the contract of anywidget. model.get("data") is what data.py packs, and
// model.get("values") holds the parameters by name; both hosts change them by set and save_changes.

const PROGRAM_HEAD = '#version 300 es\nprecision highp float;\nprecision highp int;\n';
const VERTEX = '#version 300 es\nvoid main() {' +
  ' gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4. - 1., 0., 1.); }';
// The light pass at the pixels, on the background, encoded and clipped: levels.
const COMPOSITE = PROGRAM_HEAD + `
uniform highp sampler2D pass, back;
uniform vec2 whole; uniform float stride, rows, gain; uniform vec2 ends; uniform vec3 tint;
uniform bool smaller, screen, backed, srgb;
out vec4 colour;
vec3 texel(ivec2 at) { return clamp(texelFetch(pass, clamp(at, ivec2(0), textureSize(pass, 0) - 1), 0).rgb, 0., 1.); }
vec3 upsampled(vec2 uv) {
  vec2 at = uv * vec2(textureSize(pass, 0)) - .5, low = floor(at), part = at - low;
  ivec2 a = ivec2(low);
  return mix(mix(texel(a), texel(a + ivec2(1, 0)), part.x),
             mix(texel(a + ivec2(0, 1)), texel(a + 1), part.x), part.y);
}
void main() {
  vec2 cell = floor(gl_FragCoord.xy);
  vec2 uv = vec2((cell.x * stride + .5) / whole.x, 1. - ((rows - 1. - cell.y) * stride + .5) / whole.y);
  vec3 L = (smaller ? upsampled(uv) : texelFetch(pass, ivec2(cell), 0).rgb) * tint;
  vec3 B = backed ? texelFetch(back, ivec2(cell), 0).rgb : vec3(0.);
  vec3 image = max(screen ? B + L - B * L : (backed ? gain * B : vec3(0.)) + L, 0.);
  if (srgb) image = mix(12.92 * image, 1.055 * pow(max(image, .0031308), vec3(1. / 2.4)) - .055,
                        vec3(greaterThan(image, vec3(.0031308))));
  colour = vec4(clamp(255. * image, ends.x, ends.y), 1.);
}`;
// What is on the screen: target, fitted, difference, both behind a wipe, both side by side.
const DISPLAY = PROGRAM_HEAD + `
uniform highp sampler2D levels, wanted;
uniform int mode; uniform float wipe, limit; uniform vec2 size;
out vec4 colour;
vec3 hot(float x) {
  vec3 end = x > 0. ? vec3(.70, .09, .17) : vec3(.13, .40, .67);
  return mix(vec3(.97), end, min(abs(x), 1.));
}
void main() {
  vec2 at = floor(gl_FragCoord.xy);
  bool left = at.x < wipe * size.x;
  if (mode == 4) {
    left = at.x < .5 * size.x;
    at = vec2(mod(at.x * 2., size.x), at.y * 2. - .5 * size.y);
    if (at.y < 0. || at.y >= size.y) { colour = vec4(.1, .1, .1, 1.); return; }
  }
  vec3 f = texelFetch(levels, ivec2(at), 0).rgb, t = texelFetch(wanted, ivec2(at), 0).rgb, d = f - t;
  float worst = d.r;
  if (abs(d.g) > abs(worst)) worst = d.g;
  if (abs(d.b) > abs(worst)) worst = d.b;
  colour = vec4(mode == 2 ? hot(worst / limit) : (mode == 0 || (mode > 2 && left) ? t : f) / 255., 1.);
}`;
const MODES = ['target', 'fitted', 'difference', 'wipe', 'side by side'];

// A packed array: zlib's stream of little-endian numbers, integers as steps along a row.
export async function unpack(packed) {
  const bytes = Uint8Array.from(atob(packed.data), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  const buffer = await new Response(stream).arrayBuffer();
  const kind = {uint8: Uint8Array, uint16: Uint16Array, int16: Int16Array, float32: Float32Array};
  const values = new kind[packed.kind](buffer), [h, w, c] = packed.shape;
  if (packed.kind !== 'float32')
    for (let y = 0; y < h; y++)
      for (let i = y * w * c + c; i < (y + 1) * w * c; i++) values[i] += values[i - c];
  return {values, h, w, c, top: packed.top};
}

// (h, w, 4) floats, the bottom row first as textures have it; ``scale`` is what 1 becomes.
function upright(image, scale) {
  const {values, h, w, c, top} = image, out = new Float32Array(h * w * 4);
  for (let y = 0; y < h; y++)
    for (let x = 0; x < w; x++)
      for (let k = 0; k < 4; k++)
        out[((h - 1 - y) * w + x) * 4 + k] =
          k === 3 ? 1 : values[(y * w + x) * c + Math.min(k, c - 1)] * scale / top;
  return out;
}

// The shader of a page, on one canvas. Throws where the browser has no WebGL2 or no float textures.
class Engine {
  constructor(canvas, data, images) {
    const gl = canvas.getContext('webgl2', {preserveDrawingBuffer: true, antialias: false});
    if (!gl) throw new Error('this browser has no WebGL2 here (no GPU, or too many pages)');
    if (!gl.getExtension('EXT_color_buffer_float')) throw new Error('WebGL2 renders no floats here');
    this.floats = gl.getExtension('OES_texture_float_linear') !== null;
    Object.assign(this, {gl, all: data, programs: {}, images, canvas});
    this.composite = this.program('composite', COMPOSITE);
    this.display = this.program('display', DISPLAY);
    gl.bindVertexArray(gl.createVertexArray());
    this.frame(0);
  }
  program(name, fragment) {
    if (this.programs[name]) return this.programs[name];
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS))
      throw new Error(`${name}: ` + gl.getAttachedShaders(program).map((s) => gl.getShaderInfoLog(s)).join(' '));
    return (this.programs[name] = program);
  }
  texture(w, h, format, kind, values, filter) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, format, w, h, 0, gl.RGBA, kind, values);
    for (const end of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, end, filter);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    return texture;
  }
  floatTexture(w, h, values = null, filter = null) {
    const gl = this.gl, own = this.floats ? gl.LINEAR : gl.NEAREST;
    return this.texture(w, h, gl.RGBA32F, gl.FLOAT, values, filter ?? own);
  }
  // The images of a frame as textures, and what the passes render into.
  frame(index) {
    // The sizes are each frame's own.
    this.data = {...this.all, ...this.all.frames?.[index]};
    const gl = this.gl, {mask, target, background} = this.images[index];
    for (const old of this.textures ?? []) gl.deleteTexture(old);
    this.mask = mask;
    this.size = [target.w, target.h];
    [this.canvas.width, this.canvas.height] = this.size;
    this.bytes = mask.values instanceof Uint8Array && mask.top === 255;
    const values = upright(mask, this.bytes ? 255 : 1);
    this.maskTexture = this.bytes
      ? this.texture(mask.w, mask.h, gl.RGBA8, gl.UNSIGNED_BYTE, Uint8Array.from(values, Math.round), gl.LINEAR)
      : this.floatTexture(mask.w, mask.h, values);
    this.wanted = upright(target, 255);
    this.targetTexture = this.floatTexture(...this.size, this.wanted, gl.NEAREST);
    this.backTexture = background ? this.floatTexture(...this.size, upright(background, 1), gl.NEAREST) : null;
    this.levelsTexture = this.floatTexture(...this.size, null, gl.NEAREST);
    const [W, H] = this.data.size, [w, h] = this.data.pass;
    this.smaller = w !== W || h !== H;
    this.passSize = this.smaller ? [w, h] : this.size;
    this.chain = [0, 1].map(() => this.floatTexture(mask.w, mask.h));
    this.sums = [0, 1].map(() => this.floatTexture(...this.passSize));
    this.textures = [this.maskTexture, this.targetTexture, this.backTexture, this.levelsTexture, ...this.chain, ...this.sums]
      .filter((t) => t);
    this.buffer ??= gl.createFramebuffer();
  }
  draw(program, into, size, textures, uniforms) {
    const gl = this.gl;
    gl.useProgram(program);
    gl.bindFramebuffer(gl.FRAMEBUFFER, into ? this.buffer : null);
    if (into) gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, into, 0);
    gl.viewport(0, 0, ...size);
    Object.entries(textures).forEach(([name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(gl.getUniformLocation(program, name), unit);
    });
    for (const [name, value] of Object.entries(uniforms)) {
      const at = gl.getUniformLocation(program, name);
      if (Array.isArray(value)) gl[`uniform${value.length}fv`](at, value);
      else if (typeof value === 'boolean' || name === 'samples' || name === 'mode') gl.uniform1i(at, value);
      else gl.uniform1f(at, value);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  // Levels (h, w, 4), the bottom row first, of the picture with these values and this convention.
  levels(values, name, samples) {
    const {gl, data, mask} = this, shader = data.conventions[name];
    const program = this.program(name, shader.glsl);
    const {exposure = 1, decay = 1, density = 1, weight = 1} = values;
    const common = {exposure, decay, density, weight, samples};
    let sum = 0;
    lightsOf(data, values).forEach((light, number) => {
      let source = this.maskTexture, filtered = this.bytes || this.floats;
      shader.spans.forEach((span, step) => {
        const last = step === shader.spans.length - 1, whole = last ? (this.smaller ? data.pass : data.size) : [mask.w, mask.h];
        const stride = last && !this.smaller ? data.stride : 1, size = last ? this.passSize : [mask.w, mask.h];
        const into = last ? this.sums[1 - sum] : this.chain[step % 2];
        this.draw(program, into, size, {mask: source, before: number ? this.sums[sum] : this.targetTexture}, {
          ...common, light, whole, stride, rows: size[1], span, filtered, adding: number > 0, first: step === 0, last,
        });
        [source, filtered] = [into, this.floats];
      });
      sum = 1 - sum;
    });
    this.draw(this.composite, this.levelsTexture, this.size,
      {pass: this.sums[sum], back: this.backTexture ?? this.targetTexture}, {
        whole: data.size, stride: data.stride, rows: this.size[1], smaller: this.smaller, screen: shader.screen,
        backed: this.backTexture !== null, gain: shader.background_gain, srgb: data.transfer === 'srgb', ends: data.ends,
        tint: [values.red ?? 1, 1, values.blue ?? 1],
      });
    const out = new Float32Array(this.size[0] * this.size[1] * 4);
    gl.readPixels(0, 0, ...this.size, gl.RGBA, gl.FLOAT, out);
    return out;
  }
  show(mode, wipe, limit) {
    this.draw(this.display, null, this.size, {levels: this.levelsTexture, wanted: this.targetTexture},
      {mode, wipe, limit, size: this.size});
  }
}

function lightsOf(data, values) {
  return data.lights.map(([x, y]) => [values[x], values[y]]);
}

// Worst and root mean square of a - b over the pixels that count, in levels.
function difference(a, b, valid) {
  let worst = 0, sum = 0, count = 0;
  for (let i = 0; i < a.length; i++) {
    if (i % 4 === 3 || (valid && !valid[i & ~3])) continue;
    const d = Math.abs(a[i] - b[i]);
    if (d > worst) worst = d;
    sum += d * d;
    count++;
  }
  return {worst, rms: Math.sqrt(sum / Math.max(count, 1))};
}

const part = (tag, props = {}, ...children) => {
  const node = Object.assign(document.createElement(tag), props);
  node.append(...children);
  return node;
};
const short = (x, digits = 6) => String(Number(Number(x).toPrecision(digits)));

// The pictures of a canvas without WebGL, from the target and what the fit leaves of it.
function still(canvas, target, residual, mode, limit) {
  [canvas.width, canvas.height] = [target.w, target.h];
  const context = canvas.getContext('2d'), picture = context.createImageData(target.w, target.h);
  for (let i = 0; i < target.w * target.h; i++)
    for (let k = 0; k < 4; k++) {
      const at = (image) => image.values[i * image.c + Math.min(k, image.c - 1)];
      const t = (at(target) * 255) / target.top, d = at(residual);
      const hot = d > 0 ? [179, 23, 43] : [33, 102, 171], share = Math.min(Math.abs(d) / limit, 1);
      picture.data[i * 4 + k] = k === 3 ? 255
        : mode === 2 ? 247 + (hot[k] - 247) * share
        : mode === 0 || (mode > 2 && i % target.w < target.w / 2) ? t : t + d;
    }
  context.putImageData(picture, 0, 0);
}

// Text with the numbers in its slots: {{name}}, {{1-name}}, {{1/name}} and {{name/number}}. All but
// the number of samples have a point.
function filled(text, values) {
  return text.replace(/\{\{(1[-/])?(\w+)(?:\/([-+.\de]+))?\}\}/g, (_, before, name, by) => {
    const x = values[name], y = before === '1-' ? 1 - x : before === '1/' ? 1 / x : by ? x / by : x;
    const number = short(y, 9);
    return name === 'samples' || /[.e]/.test(number) ? number : `${number}.0`;
  });
}

// Text to the clipboard. Frames and file:// have no Clipboard API: a selected text area serves.
async function copy(text, area) {
  area.value = text;
  area.hidden = false;
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    area.select();
    document.execCommand('copy');
  }
}

export async function render({model, el}) {
  const data = model.get('data');
  const fitted = Object.fromEntries(data.params.map((p) => [p.name, p.value]));
  const state = {shader: data.shader, samples: data.samples, mode: 1, wipe: 0.5, frame: 0, values: {...fitted, ...model.get('values')}};
  let canvas = part('canvas', {className: 'picture'});
  const heat = part('canvas', {className: 'heat', hidden: true});
  const stage = part('div', {className: 'stage'}, canvas, heat);
  const said = part('output', {className: 'said'}), against = part('output', {className: 'said'});
  const why = part('p', {className: 'why', hidden: true}), controls = part('div', {className: 'controls'});
  el.replaceChildren(part('div', {className: 'live'}, part('div', {}, stage, said, why), controls));
  const frames = data.frames ?? [data];
  const images = await Promise.all(frames.map(async (frame) => {
    const names = ['mask', 'target', 'background', 'valid', 'residual'];
    const found = await Promise.all(names.map((name) => (frame[name] ? unpack(frame[name]) : null)));
    return Object.fromEntries(names.map((name, i) => [name, found[i]]));
  }));
  stage.style.setProperty('--aspect', images[0].target.w / images[0].target.h);
  // The address is that of a page's first viewer; a notebook's is left alone.
  const owner = el.dataset.viewer === '0' && location.href !== 'about:srcdoc';
  let engine = null, base = null, queued = false, blink = null;
  const show = (fresh) => {
    canvas.replaceWith(fresh);
    canvas = fresh;
  };
  const paint = () => still(canvas, images[state.frame].target, images[state.frame].residual, state.mode, data.limit);
  // The context is made on the first touch: a browser keeps 16 of them.
  const start = () => {
    if (engine || !data.live || !why.hidden) return;
    const fresh = part('canvas', {className: 'picture'});
    try {
      engine = new Engine(fresh, data, images);
    } catch (error) {
      return stop(error.message);
    }
    show(fresh);
    fresh.addEventListener('webglcontextlost', (event) => {
      event.preventDefault();
      stop('the context was lost; reload the page');
    });
  };
  const stop = (reason) => {
    engine = null;
    why.textContent = `No live shader: ${reason}. The pictures are those of the fit.`;
    why.hidden = false;
    show(part('canvas', {className: 'picture'}));
    paint();
  };
  // Sliders that the chosen convention has no parameter for.
  const enable = () => {
    const shader = data.conventions[state.shader];
    for (const name of ['exposure', 'decay', 'density', 'weight', 'samples']) {
      const input = controls.querySelector(`input[name="${name}"]`);
      if (input) input.disabled = name === 'samples' ? !shader.samples : !shader.parameters.includes(name);
    }
  };
  const update = () => {
    queued = false;
    if (!engine) return paint();
    enable();
    const {valid} = images[state.frame], whole = valid && upright(valid, 1);
    base ??= engine.levels(atFrame(fitted), data.shader, data.samples);
    const levels = engine.levels(state.values, state.shader, state.samples);
    engine.show(state.mode, state.wipe, data.limit);
    const d = difference(levels, engine.wanted, whole), changed = difference(levels, base, whole);
    said.textContent = `against the target: ${short(d.rms, 3)} levels rms, ${short(d.worst, 3)} at worst`;
    against.textContent = changed.worst === 0 ? 'these are the numbers of the result'
      : `against the picture of the result: ${short(changed.rms, 3)} levels rms, ${short(changed.worst, 3)} at worst`;
    Object.assign(el.viewer, {levels, stats: d, changed});
    place();
    const hash = new URLSearchParams();
    for (const [name, value] of Object.entries(state.values)) if (value !== fitted[name]) hash.set(name, short(value, 9));
    for (const name of ['shader', 'samples']) if (state[name] !== data[name]) hash.set(name, state[name]);
    if (state.mode !== 1) hash.set('mode', state.mode);
    if (owner && location.hash.slice(1) !== String(hash))
      history.replaceState(null, '', '#' + hash);
  };
  const redraw = () => {
    start();
    if (!queued) requestAnimationFrame(update);
    queued = true;
  };
  const atFrame = (values) => ({...values, ...(frames[state.frame].light ?? {})});
  const set = (name, value, quiet = false) => {
    state.values[name] = value;
    const slider = controls.querySelector(`input[name="${name}"]`);
    if (slider) {
      if (+slider.value !== value) slider.value = value;
      slider.nextElementSibling.textContent = short(value);
    }
    if (!quiet) {
      model.set('values', {...state.values});
      model.save_changes();
    }
    redraw();
  };

  // The lights, as handles: one outside the picture is kept at its edge.
  const handles = data.lights.map(([x, y], i) => {
    const handle = part('button', {className: 'light', title: data.lights.length > 1 ? `light ${i + 1}` : 'the light'});
    handle.addEventListener('pointerdown', (event) => {
      handle.setPointerCapture(event.pointerId);
      handle.onpointermove = (move) => {
        const box = stage.getBoundingClientRect();
        set(x, (move.clientX - box.left) / box.width);
        set(y, 1 - (move.clientY - box.top) / box.height);
      };
      handle.onpointerup = () => (handle.onpointermove = null);
      event.preventDefault();
    });
    return handle;
  });
  const place = () => handles.forEach((handle, i) => {
    // Side by side, the picture is drawn twice at half its size.
    handle.hidden = state.mode === 4;
    const [x, y] = data.lights[i].map((name) => state.values[name]), inside = (z) => Math.min(Math.max(z, 0), 1);
    handle.style.left = `${100 * inside(x)}%`;
    handle.style.bottom = `${100 * inside(y)}%`;
    handle.classList.toggle('outside', inside(x) !== x || inside(y) !== y);
  });
  if (data.live) stage.append(...handles);
  if (data.note) said.after(part('p', {className: 'said', textContent: data.note}));

  const choice = (label, options, value, act) => {
    const select = part('select', {}, ...options.map(([key, text]) => part('option', {value: key, textContent: text})));
    select.name = label;
    select.value = value;
    select.addEventListener('change', () => act(select.value));
    controls.append(part('label', {}, part('span', {textContent: label}), select));
    return select;
  };
  const slider = (p) => {
    const input = part('input', {type: 'range', name: p.name, min: p.low, max: p.high, step: p.step ?? 'any', value: p.value});
    // The 95% interval, drawn to the scale of the track, never thinner than two pixels.
    const band = part('i', {className: 'band'});
    if (p.band && p.high > p.low) {
      const [a, b] = p.band.map((z) => (100 * Math.min(Math.max((z - p.low) / (p.high - p.low), 0), 1)).toFixed(3));
      band.style.background = `linear-gradient(90deg, transparent calc(${a}% - 1px), var(--accent) calc(${a}% - 1px) calc(${b}% + 1px), transparent calc(${b}% + 1px))`;
    }
    input.addEventListener('input', () => (p.name === 'samples' ? (state.samples = +input.value, input.nextElementSibling.textContent = input.value, redraw()) : set(p.name, +input.value)));
    const label = part('label', {title: p.meaning ?? ''}, part('span', {textContent: p.name}), input, part('output', {textContent: short(p.value)}), band, part('small', {textContent: p.remark}));
    controls.append(label);
  };
  const names = data.live ? MODES : MODES.slice(0, 3);
  const view = choice('view', [...names.entries()], 1, (value) => { state.mode = +value; redraw(); });
  if (data.live) {
    controls.append(part('label', {}, part('span', {textContent: 'wipe'}), part('input', {type: 'range', min: 0, max: 1, step: 'any', value: 0.5, oninput: (e) => { state.wipe = +e.target.value; state.mode = 3; view.value = 3; redraw(); }}), part('output')));
    controls.append(part('button', {textContent: 'blink', onclick: () => {
      clearInterval(blink);
      blink = blink ? null : setInterval(() => { state.mode = state.mode === 0 ? 1 : 0; view.value = state.mode; redraw(); }, 600);
    }}));
  }
  const maps = Object.entries(data.where ?? {});
  if (maps.length) {
    const note = part('small');
    choice('where it comes from', [['', 'off'], ...maps.map(([name]) => [name, name])], '', async (name) => {
      heat.hidden = !name;
      note.textContent = name ? data.where[name].text : '';
      if (!name) return;
      const map = await unpack(data.where[name].map);
      [heat.width, heat.height] = [map.w, map.h];
      const context = heat.getContext('2d'), image = context.createImageData(map.w, map.h);
      for (let i = 0; i < map.w * map.h; i++) image.data.set([255, 120, 0, (map.values[i] * 230) / map.top], i * 4);
      context.putImageData(image, 0, 0);
    });
    controls.append(note);
  }
  if (frames.length > 1) {
    const input = part('input', {type: 'range', name: 'frame', min: 0, max: frames.length - 1, step: 1, value: 0});
    const name = part('output', {textContent: frames[0].name});
    input.addEventListener('input', () => {
      state.frame = +input.value;
      name.textContent = frames[state.frame].name;
      base = null;
      engine?.frame(state.frame);
      for (const [key, value] of Object.entries(frames[state.frame].light ?? {})) set(key, value, true);
      redraw();
    });
    controls.append(part('label', {}, part('span', {textContent: 'frame'}), input, name));
  }
  if (data.live) {
    const formula = part('small', {textContent: data.conventions[state.shader].formula});
    const shader = choice('convention', Object.keys(data.conventions).map((n) => [n, n]), state.shader, (name) => {
      state.shader = name;
      formula.textContent = data.conventions[name].formula;
      redraw();
    });
    controls.append(formula, against);
    data.params.forEach(slider);
    slider({name: 'samples', value: state.samples, low: 2, high: Math.max(2 * data.samples, 100), step: 1, remark: 'given'});
    const area = part('textarea', {readOnly: true, hidden: true, rows: 8});
    controls.append(part('button', {textContent: 'reset', onclick: () => {
      [state.shader, state.samples] = [data.shader, data.samples];
      shader.value = state.shader;
      const input = controls.querySelector('input[name=samples]');
      input.nextElementSibling.textContent = input.value = state.samples;
      for (const [name, value] of Object.entries(atFrame(fitted))) set(name, value);
    }}), part('button', {textContent: 'copy', onclick: () => copy(copied(), area)}), area);
    el.addEventListener('pointerenter', redraw, {once: true});
  }
  const copied = () => filled(data.conventions[state.shader].copy.replaceAll('{{shader}}', state.shader),
    {...state.values, samples: state.samples});
  el.viewer = {state, set, copied, redraw, engine: () => engine};
  model.on('change:values', () => {
    for (const [name, value] of Object.entries(model.get('values')))
      if (state.values[name] !== value) set(name, value, true);
  });
  paint();
  const hash = new URLSearchParams(owner ? location.hash.slice(1) : '');
  if (data.conventions?.[hash.get('shader')]) controls.querySelector('select[name=convention]').value = state.shader = hash.get('shader');
  if (hash.get('samples') > 1) state.samples = +hash.get('samples');
  if (hash.get('mode') in names) view.value = state.mode = +hash.get('mode');
  for (const p of data.params) if (isFinite(parseFloat(hash.get(p.name)))) set(p.name, +hash.get(p.name));
  if (frames[0].light) for (const [key, value] of Object.entries(frames[0].light)) set(key, value, true);
  place();
  if (!data.live) stop(data.reason);
  else if (data.eager) redraw();
  return () => clearInterval(blink);
}

export default {render};
