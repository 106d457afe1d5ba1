"""What the live page shows, as JSON: images packed without loss of bits, parameters, programs.

Images travel as base64 of zlib's stream of raw numbers, so that no colour management touches them.
Integers are steps along a row, which are small where a picture is smooth. Of a large picture the
page draws every n-th pixel, at its exact place and from the whole mask: its levels stay those of
the fit.
"""

from __future__ import annotations

import base64
import dataclasses
import functools
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from godfit.inference.estimates import Estimate
from godfit.inference.evaluate import occlusion_of
from godfit.inference.observation import Picture
from godfit.io.filters import shrink
from godfit.io.image import LEVELS
from godfit.models.background import terms
from godfit.models.bare_picture import AbstractBarePicture
from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell
from godfit.models.staged import Staged
from godfit.models.tinted import Tinted
from godfit.report.engines.engine_code import COMMENTS, TEMPLATES, Slot
from godfit.report.live.glsl import described, is_drawn
from godfit.report.text import half_sentence
from godfit.runtime.guest import as_guest
from godfit.scattering.conventions import CONVENTIONS, Convention
from godfit.scattering.engines import ENGINES
from godfit.scattering.parameters import is_light, light_parameters

PAGE_SIDE = 1024
"""Pixels of the longer side of what a page draws, at most: what a screen has room for."""
NOTEBOOK_SIDE = 512
"""The same in a notebook, which keeps the page in its own file."""
IMAGE_BYTES = 280_000
"""Packed bytes of one image, at most. Three of them and the program stay below a megabyte, which
base64 makes a third larger."""
BYTE_ERROR = 1e-3
"""Distance of a value from a level, in levels, up to which it is that level."""
WORD = 65535
"""Largest 16-bit number, which stands for 1."""
PACKING_EFFORT = 6
"""Effort of zlib, of 9: more takes several times as long for a few per cent."""
RANGE_SHARE = 0.2
"""Half the range of a slider, at least, as a share of the value."""
RANGE_ERRORS = 10.0
"""Half the range of a slider, at least, in standard errors."""
LIGHT_RANGE = 0.25
"""Half the range of a light's slider, at least, as a share of the picture."""
ZERO_RANGE = 0.1
"""Half the range of the slider of a parameter that is 0."""
LIMIT_QUANTILE = 0.998
"""Quantile of the residual at which the colours of the difference end."""
LEAST_LIMIT = 0.5
"""Levels at which they end, at least: less is rounding."""
COARSER = "this page holds the mask at {}x{} pixels of {}x{}: levels differ a little"
"""Note with the sizes of a mask that was too large for a page."""
MOVED = ("exposure", "decay", "density", "weight", "red", "blue")
"""Parameters that a slider moves, beside the lights."""
UNBOUNDED_LEVELS = 1e30
"""Stands for a level without bound: JSON has no infinity."""
CLIP_SIDE = 320
"""Pixels of the longer side of a clip's frames, at most: a page holds many of them."""
CLIP_FRAMES = 24
"""Frames of a clip on its page, at most: a second of film, and a few megabytes."""
CLIP_LIMIT = 4.0
"""Levels at which the colours of a clip's differences end, the same for all frames."""
COVERAGE = 1.96
"""Standard errors of a 95% interval."""


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """What a page is made of: a model with its ``params``, on a ``picture``; ``levels`` (h, w, c)
    is the fitted picture, and ``where`` (rows, columns) the share of the information on each
    parameter. ``fixed`` is what is said beside a parameter that was not fitted."""

    model: AbstractModel
    picture: Picture
    params: Mapping[str, Estimate]
    levels: np.ndarray
    where: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    command: str = ""
    fixed: str = "held"

    @property
    def shading(self) -> Mitchell | None:
        """The sum that the page's shader computes, None where the model is none."""
        if isinstance(self.model, Mitchell):
            return self.model
        if isinstance(self.model, Tinted | Staged | AbstractBarePicture):
            return self.model.shading
        return None

    @functools.cached_property
    def mask(self) -> np.ndarray:
        """(h, w) or (h, w, 3): the occlusion mask that the light pass reads."""
        with as_guest():
            return np.asarray(occlusion_of(self.model, np.asarray(self.picture.mask)))


class Packed(NamedTuple):
    """An array packed for the page: ``kind`` of its numbers, (rows, columns, channels) ``shape``,
    the number ``top`` that stands for 1, and the bytes."""

    kind: str
    shape: tuple[int, ...]
    top: int
    data: bytes

    def as_json(self) -> dict[str, Any]:
        """The entry of the page's data."""
        text = base64.b64encode(self.data).decode()
        return {"kind": self.kind, "shape": list(self.shape), "top": self.top, "data": text}


def packed(image: np.ndarray) -> Packed:
    """(h, w) or (h, w, c), 1 the brightest level. Values that are levels take a byte, others of
    [0, 1] 16 bits; the rest stay float32."""
    values = np.nan_to_num(image.reshape(*image.shape[:2], -1).astype(np.float32))
    levels = values * LEVELS
    rounded = np.rint(levels)
    inside = values.size and values.min() >= 0 and values.max() <= 1
    if inside and np.abs(levels - rounded).max() < BYTE_ERROR:
        return _packed(rounded.astype(np.uint8), 255)
    if inside:
        return _packed(np.rint(values * WORD).astype(np.uint16), WORD)
    return _packed(values, 1)


def _packed(values: np.ndarray, top: int) -> Packed:
    stored = values
    if values.dtype != np.float32:
        # The difference of unsigned numbers wraps, and the page's sum wraps back.
        stored = values.copy()
        stored[:, 1:] -= values[:, :-1]
    raw = stored.astype(stored.dtype.newbyteorder("<")).tobytes()
    return Packed(values.dtype.name, values.shape, top, zlib.compress(raw, PACKING_EFFORT))


def packed_mask(mask: np.ndarray) -> Packed:
    """The mask, averaged down until it takes IMAGE_BYTES at most."""
    found, factor = packed(mask), 1
    while len(found.data) > IMAGE_BYTES and min(mask.shape[:2]) > 2 * factor:
        factor *= 2
        found = packed(shrink(mask, (mask.shape[0] // factor, mask.shape[1] // factor)))
    return found


class View(NamedTuple):
    """Every ``stride``-th pixel of a picture, from its top left corner."""

    stride: int

    @property
    def cut(self) -> tuple[slice, slice]:
        every = slice(None, None, self.stride)
        return every, every

    @staticmethod
    def of(picture: Picture, side: int) -> View:
        """Of at most ``side`` pixels, and of so few that the target takes IMAGE_BYTES at most."""
        view = View(-(-max(picture.size) // side))
        while len(packed(picture.levels[view.cut] / np.float32(LEVELS)).data) > IMAGE_BYTES:
            view = View(view.stride + 1)
        return view


def frame(shown: Shown, view: View) -> dict[str, Any]:
    """The images of one picture: target, residual, and what the pass reads where there is one."""
    picture, cut = shown.picture, view.cut
    target = picture.levels[cut]
    left = np.nan_to_num(shown.levels[cut] - target)
    # The page adds the residual to the target where it has no WebGL.
    steps = np.clip(np.rint(left), -WORD // 2, WORD // 2).astype(np.int16)
    images = {
        "target": packed(target / np.float32(LEVELS)),
        "residual": _packed(steps, 1),
    }
    if not picture.valid.all():
        images["valid"] = packed(picture.valid[cut].astype(np.float32))
    if shown.shading is not None:
        images["mask"] = packed_mask(shown.mask)
        back = _background(shown, view)
        if back is not None:
            images["background"] = packed(back)
    return {name: image.as_json() for name, image in images.items()}


def _background(shown: Shown, view: View) -> np.ndarray | None:
    """(h, w, c) linear ordinary pass at the pixels of the view; None where there is none."""
    model, picture = shown.model, shown.picture
    if not isinstance(model, AbstractBarePicture):
        return None if picture.background is None else picture.background[view.cut]
    height, width = picture.size
    pixels = np.arange(height * width).reshape(height, width)[view.cut]
    coefficients = np.asarray(model.background)
    with as_guest():
        basis = np.asarray(terms(pixels.reshape(-1), picture.size, len(coefficients)))
    return (basis @ coefficients).astype(np.float32).reshape(*pixels.shape, -1)


def page_data(shown: Shown, side: int = PAGE_SIDE, eager: bool = True) -> dict[str, Any]:
    """The data of a viewer: a dictionary that JSON holds. With ``eager`` the shader runs at once,
    else at the first touch."""
    view = View.of(shown.picture, side)
    residual = np.abs(shown.levels[view.cut] - shown.picture.levels[view.cut])
    placed = placed_frame(shown, view)
    low, whole = placed.get("mask", {}).get("shape", ())[1::-1], placed["pass"]
    if low and [*low] != whole:
        placed["note"] = COARSER.format(*low, *whole)
    return {
        **placed,
        **controls(shown),
        "limit": max(LEAST_LIMIT, float(np.nanquantile(residual, LIMIT_QUANTILE))),
        "eager": eager,
        "where": {name: _map(name, share) for name, share in shown.where.items()},
    }


def placed_frame(shown: Shown, view: View) -> dict[str, Any]:
    """The images of one picture, and what their numbers mean."""
    picture = shown.picture
    floor, ceiling = np.clip(picture.ends, -UNBOUNDED_LEVELS, UNBOUNDED_LEVELS)
    return {
        "size": list(picture.size[::-1]),
        "stride": view.stride,
        "transfer": picture.transfer,
        "ends": [float(floor), float(ceiling)],
        "pass": list(picture.mask.shape[1::-1]),
        **frame(shown, view),
    }


def controls(shown: Shown) -> dict[str, Any]:
    """Sliders, lights, conventions and the text to copy, or the reason why there are none."""
    shading = shown.shading
    if shading is None:
        reason = f"{shown.model.name} is no sum over a mask, which is all that a page runs"
        return {"live": False, "reason": reason, "params": [], "lights": []}
    if not is_drawn(shading.convention):
        reason = f"{shading.shader} is a composition of sums, which no page runs"
        return {"live": False, "reason": reason, "params": [], "lights": []}
    # A user's own shader is none of those that are shipped.
    shaders = {name: shader for name, shader in CONVENTIONS.items() if is_drawn(shader)}
    shaders[shading.shader] = shading.convention
    params = dict(shown.params)
    lights = [row.name for row in light_parameters(len(shown.model.light))]
    placed = zip(lights, np.asarray(shown.model.light).reshape(-1), strict=True)
    # The light of a scene is where its camera has it.
    params |= {name: Estimate(float(v), None, True) for name, v in placed if name not in params}
    moved = {name: e for name, e in params.items() if name in MOVED or is_light(name)}
    rows = [slider(name, e, shown) for name, e in moved.items()]
    pairs = [lights[i : i + 2] for i in range(0, len(lights), 2)]
    return {
        "live": True,
        "params": rows,
        "lights": pairs,
        "shader": shading.shader,
        "samples": int(shading.samples),
        "conventions": {
            name: described(shader) | {"copy": copied_text(shown, shader, pairs)}
            for name, shader in shaders.items()
        },
    }


def clip_frame(name: str, shown: Shown) -> dict[str, Any]:
    """One frame of a clip, as a viewer's ``frames`` hold it, with its own light."""
    u, v = np.asarray(shown.model.light)[0]
    light = {"light_x": float(u), "light_y": float(v)}
    return {"name": name, "light": light, **placed_frame(shown, View.of(shown.picture, CLIP_SIDE))}


def clip_data(
    frames: Sequence[Mapping[str, Any]], model: AbstractModel, params: Mapping[str, Estimate]
) -> dict[str, Any]:
    """The data of a clip's viewer: the shader that its ``frames`` share, and a slider of frames."""
    first = frames[0]
    light = {name: Estimate(value, None, True) for name, value in first["light"].items()}
    nothing = np.zeros((1, 1, 1), np.float32)
    picture = Picture(nothing, 0.5, np.ones((1, 1), bool), nothing[..., 0], None, "none")
    shared = controls(Shown(model, picture, {**params, **light}, nothing, fixed="of the frame"))
    return {**first, **shared, "frames": list(frames), "limit": CLIP_LIMIT, "eager": True}


def slider(name: str, e: Estimate, shown: Shown) -> dict[str, Any]:
    """The slider of a parameter: its range, its 95% band, and what is said beside it."""
    model = shown.model
    table = model.parameters | {row.name: row for row in light_parameters(len(model.light))}
    row, error = table[name], e.stderr or 0.0
    reach = max(RANGE_SHARE * abs(e.value), RANGE_ERRORS * error)
    reach = max(reach, LIGHT_RANGE) if is_light(name) else reach or ZERO_RANGE
    band = e.interval or (e.value - COVERAGE * error, e.value + COVERAGE * error)
    remark = f"± {e.stderr:.2g}" if e.stderr is not None else "not determined"
    if e.fixed:
        remark = shown.fixed
    elif e.at_bound:
        remark = "at its bound"
    return {
        "name": name,
        "value": e.value,
        "low": max(e.value - reach, row.lower),
        "high": min(e.value + reach, row.upper),
        "band": [*band] if e.stderr is not None or e.interval else None,
        "remark": remark,
        "meaning": row.meaning,
    }


def copied_text(shown: Shown, shader: Convention, lights: list[list[str]]) -> str:
    """What the copy button copies, with {{NAME}} for each number: what ``godfit export`` prints for
    the engine of a ``shader``, or the settings of a fit where there is none. ``lights`` are the
    names of the parameters of each."""
    height, width = shown.picture.mask.shape[:2]
    told = [*shown.command.splitlines(), f"light pass of {width}x{height} pixels"]
    engine = next((e for e in ENGINES.values() if e.convention == shader.key), None)
    # What is exported reads the whole mask.
    if engine is None or shader.threshold:
        names = [*shader.parameters, *(name for pair in lights for name in pair)]
        lines = ['shader = "{{shader}}"', f"samples = {Slot('samples')}"]
        lines += [f"{name} = {Slot(name)}" for name in names]
        return "\n".join([*(f"# {line}" for line in told), *lines]) + "\n"
    told = [engine.title, *(f"exact with: {option}" for option in engine.options), *told]
    mark = COMMENTS.get(engine.template, "//")
    values = {name: Slot(name) for name in (*shader.parameters, "samples")}
    shown_name = shader.blend if engine.template == "pmndrs" else engine.convention
    lines = [f"{mark} {line}" for line in told]
    for u, v in lights:
        light = Slot(u), 1 - Slot(v) if engine.v_down else Slot(v)
        lines += TEMPLATES[engine.template](values, light, shown_name)
    return "\n".join(lines) + "\n"


def _map(name: str, share: np.ndarray) -> dict[str, Any]:
    """The map of a parameter's information, and a sentence on it."""
    most = max(float(share.max()), 1e-30)
    # The square root makes the faint parts visible.
    return {"map": packed(np.sqrt(share / most)).as_json(), "text": half_sentence(name, share)}
