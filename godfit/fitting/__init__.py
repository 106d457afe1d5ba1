"""The entry of a fit: its arguments, and the verdict on what the search leads to."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from godfit.errors import InputError, Remark
from godfit.fitting.found import found_for
from godfit.flatland.canvas import Canvas
from godfit.inference.fitted import Found
from godfit.inference.problem import MAX_VALUES, Problem
from godfit.io.image import Image
from godfit.io.sources import Source
from godfit.report.result import FitResult
from godfit.report.verdict import verdict
from godfit.request import Request
from godfit.runtime.compile_time import compile_seconds
from godfit.runtime.guest import as_guest
from godfit.scenes.scene import Scene


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


def _concluded(
    found: Found, notes: tuple[str, ...], images: dict[str, Image], began: float
) -> FitResult:
    """The result, with the notes of the images' files."""
    notes += tuple(
        Remark(f"{role}: {note}", "file") for role, im in images.items() for note in im.notes
    )
    files = {role: {"path": im.path, "sha256": im.sha256} for role, im in images.items()}
    return verdict(found, notes, files, _seconds_since(began))
