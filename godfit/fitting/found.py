"""What the search of a request leads to: with a mask, without one, or of two screenshots."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

# Importing this registers the searches of the models with a mask.
import godfit.search  # noqa: F401
from godfit.errors import InputError, Remark
from godfit.fitting.posing import Posed, pose, target_of, without_values
from godfit.inference.fitted import Found
from godfit.inference.problem import (
    Problem,
    check_size,
    checked_picture,
)
from godfit.inference.strategy import Effort, search
from godfit.io.image import Image, decode
from godfit.io.sources import Source, occluder_mask, read_source, turned
from godfit.models.build import mitchell_template
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import Tinted
from godfit.request import Request
from godfit.search import conventions

if TYPE_CHECKING:
    from godfit.blind import light_pass, two_screenshots


def found_for(request: Request) -> tuple[Found, tuple[str, ...], dict[str, Image]]:
    """What the search of a checked request leads to, notes, and the images by role: a fit before
    its verdict."""
    if request.pair:
        return _fit_pair(request)
    if request.bare:
        return _fit_bare(request)
    request, found_out = _with_shader(request)
    posed = pose(request)
    effort = Effort(request.inquire, request.max_values, request.report, _rival(request, posed))
    found = search(posed.problem.model, posed.problem, posed.given, effort)
    found = found.replaced(
        opened=posed.opened + found.opened,
        shifts=found.shifts + posed.shifts,
        pass_scale=_scale_of(found, request, posed),
        objection=found.objection or posed.objection,
    )
    return found, found_out + posed.notes + found.notes, posed.images


def _with_shader(request: Request) -> tuple[Request, tuple[str, ...]]:
    """The request with the convention and the number of samples that explain the picture best where
    the shader is to be found, and notes on that; as it is where the shader is named."""
    if not request.automatic:
        return request, ()
    general = dataclasses.replace(request, shader=conventions.GENERAL_SUM, tint=False)
    if request.free:
        words = f"shader: {conventions.GENERAL_SUM} assumed; with --free give --shader"
        return general, (Remark(words, "shader"),)
    posed = pose(general)
    picture = posed.problem.picture

    def rival() -> Problem:
        small = dataclasses.replace(general, pass_scale=conventions.SMALLER_PASS, register=False)
        return pose(small).problem

    whole = picture.mask.shape[:2] == picture.size and posed.unregistered is None
    either = whole and "pass_scale" not in request.settings
    effort = Effort(request.inquire, request.max_values, request.report, rival if either else None)
    samples = request.settings.get("samples")
    ranked = conventions.identified(posed.problem, posed.given, effort, samples)
    best = ranked[0]
    name, start = best.names[0], dict(request.start or {})
    given = start | {n: v for n, v in request.held_at.items() if v is not None}
    start = {n: v for n, v in conventions.start_of(best, name).items() if n not in given} | start
    scale = request.pass_scale
    if best.problem.picture.mask.shape[:2] != picture.mask.shape[:2]:
        scale = conventions.SMALLER_PASS
    request = dataclasses.replace(
        request, shader=name.shader, samples=name.samples, start=start, pass_scale=scale
    )
    return request, (conventions.ranking(ranked),)


def _fit_bare(request: Request) -> tuple[Found, tuple[str, ...], dict[str, Image]]:
    """The fit of a bare picture, notes, and the images by role."""
    settings = request.settings
    images = {"target": target_of(request)}
    shading = mitchell_template(settings.get("shader", "mitchell"), settings.get("samples"), 1)
    blocked = None
    if request.occluder is not None:
        images["occluder"] = read_source(request.occluder, "none", "occluder")
        blocked = occluder_mask(images["occluder"], images["target"])
    from godfit.blind import bare_fit

    asked = bare_fit.Settings(
        valid=request.valid, occluder=blocked, bright_pass=request.bright_pass,
        lights=request.lights, pass_scale=settings.get("pass_scale"), fix=request.held_at,
        start=request.start or {}, near=request.light_near, seed=request.seed,
    )  # fmt: skip
    found, notes = bare_fit.found_in(images["target"], shading, asked, request.report)
    return found, notes, images


def _fit_pair(request: Request) -> tuple[Found, tuple[str, ...], dict[str, Image]]:
    """The fit of two screenshots, the effect on and off: the mask from the light pass between
    them, then the fit with that mask, in turn."""
    settings = request.settings
    shading = mitchell_template(settings.get("shader", "mitchell"), settings.get("samples"), 1)
    if len(shading.taps) > 1:
        return _fit_scene(request)
    _check_pair(request)
    target = target_of(request)
    scene = read_source(request.background, request.transfer, "background")
    check_size(scene, target)
    from godfit.blind import light_pass, pair_fit, pair_scene, two_screenshots

    encodings = light_pass.encodings_of(request.transfer, shading.convention)
    light = light_pass.light_pass(target, scene, shading.convention, encodings, request.valid)
    request.report("light pass of the two screenshots")
    seen = pair_scene.Scene(target, scene, request.valid)
    pair = two_screenshots.found_in(light, seen, shading, request.light_near)
    images = {
        "target": _reread(target, request.target, light.blend.transfer),
        "background": _reread(scene, request.background, light.blend.scene),
    }
    size = target.values.shape[:2]
    shown = np.ones(size, bool) if request.valid is None else request.valid

    def posed(pair: two_screenshots.Pair, mask: np.ndarray, usable: np.ndarray) -> Problem:
        factor, model = pair.texels.factor, pair.model
        values = mask if mask.shape[-1] == 3 else mask[..., 0]
        image = Image(values.astype(np.float32), None, "none", "", "")
        pixels = np.kron(usable, np.ones((factor, factor), bool)) & shown
        picture = checked_picture(
            images["target"], image, images["background"], pixels, 1.0, request.channels or 1
        )
        held = np.full(len(model.parameters), np.nan, np.float32)
        if not model.convention.own_pixel:
            held[list(model.parameters).index("exposure")] = float(model.exposure)
        return Problem(model, picture, np.isnan(held), held, request.seed)

    settled = pair_fit.alternate(pair, posed, request.report)
    notes = _pair_notes(request, light.blend)
    return settled, notes, without_values(images)


def _check_pair(request: Request) -> None:
    """Raise InputError for options that have no use before the mask is known."""
    given = {
        "fix": request.fix, "start": request.start, "pass scale": request.pass_scale,
        "flip": request.flip, "arithmetic": request.arithmetic,
        "lights": request.lights if request.lights > 1 else None,
    }  # fmt: skip
    for name, value in given.items():
        if value is not None and value != {}:
            raise InputError(
                f"{name}: expected none with two screenshots without a mask, got {value!r}; fit "
                "without it, then give the mask.png of that fit as --mask with it"
            )


def _fit_scene(request: Request) -> tuple[Found, tuple[str, ...], dict[str, Image]]:
    """The light of two screenshots whose sum is of several passes, for which no mask is solved: by
    a mask of what is not dark in the ordinary pass."""
    target = target_of(request)
    scene = turned(read_source(request.background, request.transfer, "background"), request.flip)
    check_size(scene, target)
    start = dict(request.start or {})
    if request.light_near is not None:
        start = {"light_x": request.light_near[0], "light_y": request.light_near[1]} | start
    from godfit.blind import pair_fit, pair_scene

    mask = pair_scene.not_dark(scene)
    masked = dataclasses.replace(request, mask=mask, start=start, light_near=None, inquire=False)
    found, notes, images = found_for(masked)
    images.pop("mask")
    objection = pair_fit.SCENE_MASK
    opened = pair_fit.all_open(found.problem)
    found = found.replaced(
        opened=opened, objection=objection, mask_estimated=True, remarks=(), inquire=False
    )
    return found, (*notes, pair_fit.SCENE_NOTE), images


def _reread(image: Image, source: Source, transfer: str) -> Image:
    """The image in linear light by another ``transfer`` than it was read with."""
    if image.transfer == transfer:
        return image
    values = decode(image.encoded.astype(np.float64), transfer).astype(np.float32)
    return dataclasses.replace(image, values=values, transfer=transfer)


def _pair_notes(request: Request, blend: light_pass.Blend) -> tuple[str, ...]:
    """Notes on what was assumed of two screenshots."""
    notes = (
        Remark(
            "mask: estimated from the two screenshots, its brightest value taken as 1; exposure is "
            "that of such a mask; correct mask.png and give it as --mask for an exact fit",
            "mask",
        ),
    )
    if blend.transfer != request.transfer:
        words = f"transfer: the target is taken as {blend.transfer}, the background as "
        words += f"{blend.scene}: the light is then alike in all channels"
        notes += (Remark(words, "transfer"),)
    return notes


def _rival(request: Request, posed: Posed) -> Callable[[], Problem] | None:
    """The same problem with a light pass of another size, where nothing says which the target has.
    With a mask of the target's size it is the shader's own; with a smaller mask, the target's."""
    model, picture = posed.problem.model, posed.problem.picture
    if not isinstance(model, (Mitchell, Tinted)) or "pass_scale" in request.settings:
        return None
    if posed.unregistered is not None:
        return None
    if picture.pass_size(model) != picture.size:
        return lambda: posed.problem.replaced(model=model.with_pass(full_size=True))
    scale = model.convention.pass_scale
    if scale == 1 or picture.mask.shape[:2] != picture.size:
        return None
    return lambda: pose(dataclasses.replace(request, pass_scale=scale)).problem


def _scale_of(found: Found, request: Request, posed: Posed) -> float | None:
    """The size of the fitted light pass relative to the mask or the scene; None in the plane."""
    if request.canvas is not None:
        return None
    model, own = found.problem.model, posed.problem.picture.mask.shape[:2]
    if isinstance(model, (Mitchell, Tinted)) and found.problem.picture.mask.shape[:2] != own:
        return model.convention.pass_scale
    return request.settings.get("pass_scale", 1.0)
