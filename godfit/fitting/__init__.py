"""The entry of a fit: it chooses the search and returns the verdict."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

# Importing this registers the searches of the models with a mask.
import godfit.search  # noqa: F401
from godfit.errors import InputError, Remark
from godfit.fitting.posing import Posed, pose, target_of, without_values
from godfit.flatland.canvas import Canvas
from godfit.inference.fitted import Found
from godfit.inference.problem import (
    MAX_VALUES,
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
from godfit.report.result import FitResult
from godfit.report.verdict import verdict
from godfit.request import Request
from godfit.runtime.compile_time import compile_seconds
from godfit.runtime.guest import as_guest
from godfit.scenes.scene import Scene
from godfit.search import conventions

if TYPE_CHECKING:
    from godfit.blind import light_pass, two_screenshots


def fit(
    target: Source,
    *,
    mask: Source | None = None,
    scene: Scene | str | os.PathLike[str] | None = None,
    canvas: str | os.PathLike[str] | Canvas | None = None,
    model: str | None = None,
    free: Sequence[str] = (),
    background: Source | None = None,
    occluder: Source | None = None,
    bright_pass: bool = False,
    shader: str | None = None,
    samples: int | None = None,
    rays: int | None = None,
    lights: int = 1,
    pass_scale: float | None = None,
    fov: float | None = None,
    distance: float | np.ndarray | None = None,
    fix: Mapping[str, float | None] | Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
    prior: Any = None,
    light_near: tuple[float, float] | None = None,
    valid: np.ndarray | None = None,
    transfer: str = "none",
    arithmetic: str | None = None,
    flip: str | None = None,
    border: str | None = None,
    tint: bool = False,
    register: bool = False,
    channels: int | None = None,
    inquire: bool = True,
    max_values: int = MAX_VALUES,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> FitResult:
    """Fit a shader's parameters and the light's position to an image.

    **Arguments:**

    - `target`: a file, an `Image`, or an array (h, w) or (h, w, 3), row 0 at the top; arrays of
      integers are bytes (or 16-bit words), of floats linear values without rounding.
    - `mask`: the occlusion mask the scattering pass reads; linear, same aspect. A smaller one means
      a light pass at lower resolution. With neither mask nor scene nor canvas, the mask is
      estimated from the target, see `godfit.blind`.
    - `scene`: in place of a mask, the scene (or its file) that the mask is drawn from. Its light is
      where the search starts. It may also have shader, samples and other settings.
    - `canvas`: in place of a mask, what is drawn in the plane: a `godfit.flatland.Canvas`, an image
      with alpha, or a scene of shapes.
    - `model`: `"mitchell"`, the screen-space sum; `"hoffman-preetham"`, daylight behind occluders:
      the mask is then 1 where the sky is visible and 0 elsewhere; `"flatland"`, light in the plane
      of a canvas. By default the last where there is a canvas, and else the first.
    - `free`: quantities of the scene that are fitted beside the scattering, as in
      `"light.position"`, `"object[0].rotation"`; the light on the screen is then the scene's.
      Without, the mask is drawn once, with or without anti-aliasing, whichever the target supports.
    - `background`: the ordinary pass that the light is laid on, as large as the target.
    - `occluder`: without a mask, (h, w), further objects in front of the light, beside those that
      are estimated from the target: wherever it is not black.
    - `bright_pass`: without a mask, whether the light is all that is bright in the picture, as in a
      photograph, see `godfit.blind.hypotheses`.
    - `shader`, `samples`: a name in `godfit.scattering.conventions.CONVENTIONS`, by default the
      scene's or `"mitchell"`; its own default number of samples. `"auto"` is the convention
      that explains the picture best, with its number of samples where none is given.
    - `rays`: of the light in the plane, for each pixel, by default 64.
    - `lights`: how many lights are summed; they start in order from left to right.
    - `pass_scale`: the size of the light pass against the mask's, at most 1. Where nothing gives it
      and the shader has half-size passes by default, both sizes are tried on a target that 1 leaves
      unexplained, and the better is kept.
    - `fov`, `distance`: of Hoffman-Preetham without a scene: the vertical field of view in degrees
      and the distance of visible surfaces, a number or (h, w), in metres or in units that `scale`
      converts to metres. With a scene, `distance` is that of the sky.
    - `fix`: parameters held, at a value or (None) at the start or the shader's default; names alone
      are held there too.
    - `start`: parameters to start from. None is needed.
    - `prior`: (mean, standard deviation) of parameters that are known beforehand, by name: each is
      one more Gaussian row of the likelihood.
    - `light_near`: without a mask, (u, v) about where the light is, as by a click: it is searched
      for within a few hundredths of the picture from there.
    - `valid`: (h, w), False where the target is to be ignored.
    - `arithmetic`: `"gpu"`, in which a shader walks to the light in float32, or `"exact"`; errors
      allow for it, see `godfit.inference.allowances.arithmetic`. By default `"gpu"` for a target of
      bytes that this program has not rendered, else `"exact"`.
    - `transfer`: how the target (and the background) were encoded, see `godfit.io.transfer`:
      `"none"`, `"srgb"`, a tone curve, a file with a curve, or several with + between them.
    - `flip`: `"vertical"`, `"horizontal"` or `"both"` turns target, background and `valid` over.
    - `border`: what the taps read beyond the mask's edge, `"edge"` (the nearest pixel) or
      `"black"`.
    - `tint`: whether the light has a colour: red and blue against green are fitted.
    - `register`: whether shift and scale of the mask are fitted first, see
      `godfit.search.registration`.
    - `channels`: 3 counts every channel of a grey picture. That costs time and adds no information,
      but makes likelihoods comparable with those of models that are never grey.
    - `inquire`: where the residual is not noise, whether to try other starts, to correct the bias
      of the target's processing (a JPEG's compression, a light pass stored smaller) and to
      diagnose the model. Fits that are only compared with each other do not need it.
    - `max_values`: the most values, pixels times channels, that are fitted; of larger pictures,
      rows drawn at random are used.
    - `seed`: of the choice of pixels.
    - `progress`: is called with a line of text as the fit goes on.

    **Returns:** a `FitResult`. Raises `InputError`, a ValueError of one line, for input that cannot
    be fitted.

    >>> import godfit
    >>> result = godfit.fit("frame.png", mask="mask.png", shader="dawntime", samples=30)
    >>> result.converged, round(result.params["density"].value, 2)
    (True, 0.8)
    """
    with as_guest():
        request = Request(
            target=target, mask=mask, scene=scene, canvas=canvas, model=model, free=tuple(free),
            background=background, occluder=occluder, bright_pass=bright_pass, shader=shader,
            samples=samples, rays=rays, lights=lights, pass_scale=pass_scale, fov=fov,
            distance=distance, fix=fix, start=start, prior=prior, light_near=light_near,
            valid=valid, transfer=transfer, arithmetic=arithmetic, flip=flip, border=border,
            tint=tint, register=register, channels=channels, inquire=inquire,
            max_values=max_values, seed=seed, progress=progress,
        ).checked()  # fmt: skip
        try:
            return _fit(request)
        except jax.errors.JaxRuntimeError as error:
            raise InputError.within(error) or error from error


START_VALUES = 1 << 14
"""Values that the search of ``problem`` uses: its start is within a few errors of the answer."""


def problem(target: Source, **options: Any) -> Problem:
    """The problem that ``fit`` would solve, for a solver, a sampler or a prior of one's own.

    Its ``log_likelihood(params)`` and ``residuals(params)`` are functions that JAX differentiates,
    and ``start`` are the parameters to begin with, which the search has found on a part of the
    pixels. ``options`` are those of ``fit``. Raises InputError as it does.

    >>> import jax, godfit
    >>> problem = godfit.problem("frame.png", mask="mask.png", shader="dawntime", samples=30)
    >>> sorted(jax.grad(problem.log_likelihood)(problem.start))
    ['decay', 'density', 'exposure', 'light_x', 'light_y', 'weight']
    """
    with as_guest():
        given = {"inquire": False, "max_values": START_VALUES} | options
        request = Request(target=target, **given).checked()
        try:
            found, *_ = found_for(request)
        except jax.errors.JaxRuntimeError as error:
            raise InputError.within(error) or error from error
    settled = found.settled
    return found.problem.replaced(point=settled.coordinates, noise_levels=settled.sigma)


def _seconds_since(began: float) -> dict[str, float]:
    """Seconds since ``began`` (``time.perf_counter``): those in which something was compiled, and
    the others."""
    compiling = compile_seconds(began)
    return {"compile": compiling, "solve": time.perf_counter() - began - compiling}


def _fit(request: Request) -> FitResult:
    began = time.perf_counter()
    return _concluded(*found_for(request), began)


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


def _concluded(
    found: Found, notes: tuple[str, ...], images: dict[str, Image], began: float
) -> FitResult:
    """The result, with the notes of the images' files."""
    notes += tuple(
        Remark(f"{role}: {note}", "file") for role, im in images.items() for note in im.notes
    )
    files = {role: {"path": im.path, "sha256": im.sha256} for role, im in images.items()}
    return verdict(found, notes, files, _seconds_since(began))
