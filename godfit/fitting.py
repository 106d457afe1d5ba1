"""The fit: screen, climb, settle on every pixel, and say what the answer is worth."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from godfit import request
from godfit.blind import photograph, unaided
from godfit.errors import InputError
from godfit.flatland import fit_setup as plane
from godfit.flatland.model import Flatland
from godfit.flatland.starts import sky_starts
from godfit.inference import indirect_inference
from godfit.inference.fitted import Found
from godfit.inference.information import evidence, undetermined
from godfit.inference.observation import Picture
from godfit.inference.problem import MAX_VALUES, checked_picture, given_and_held, pixels_used
from godfit.inference.settle import settle
from godfit.io.image import Image
from godfit.io.sources import Source, occluder_mask, read_source
from godfit.models.base import AbstractModel
from godfit.models.build import daylight_template, mitchell_template, staged_template
from godfit.models.hoffman_preetham import HoffmanPreetham
from godfit.models.mitchell import Mitchell
from godfit.models.staged import Staged
from godfit.report.result import FitResult
from godfit.report.verdict import verdict
from godfit.runtime.compile_time import compile_seconds
from godfit.scenes.scene import Scene, read_scene
from godfit.scenes.view import (
    as_sky_mask,
    drawn_mask,
    in_single_precision,
    light_on_screen,
    resized,
    scene_at_pass_size,
)
from godfit.search import density_minima, multigrid, multistart, screening, screening_daylight
from godfit.search.density_minima import likeliest
from godfit.search.edge_pixels import agreed
from godfit.search.placement import place

STARTS = 6
# Of them, those that a doubtful fit is tried from once more, each on its own.
AGAIN = 3
Say = Callable[[str], None]
NOTHING = np.zeros((0, 0), np.float32)


def fit(
    target: Source,
    *,
    mask: Source | None = None,
    scene: Scene | str | os.PathLike[str] | None = None,
    canvas: plane.CanvasSource | None = None,
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
    fix: Mapping[str, float | None] | None = None,
    start: Mapping[str, float] | None = None,
    valid: np.ndarray | None = None,
    transfer: str = "none",
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
      a light pass at lower resolution. With neither mask nor scene nor canvas, the light is a disc
      on a veil behind what is read off the target, see `godfit.blind.screenshot`.
    - `scene`: in place of a mask, the scene (or its file) that the mask is drawn from. Its light is
      where the search starts; shader, samples and the like may stand in it.
    - `canvas`: in place of a mask, what is drawn in the plane: a `godfit.flatland.Canvas`, an image
      with alpha, or a scene of shapes.
    - `model`: `"mitchell"`, the screen-space sum; `"hoffman-preetham"`, daylight behind occluders:
      the mask is then 1 where the sky is seen and 0 where something hides it; `"flatland"`, light
      in the plane of a canvas. By default the last where there is a canvas, and else the first.
    - `free`: what of the scene is fitted beside the scattering, as in `"light.position"`,
      `"object[0].rotation"`; the light on the screen is then the scene's. Without, the mask is
      drawn once, with or without anti-aliasing, whichever the picture agrees with.
    - `background`: the ordinary pass that the light is laid on, as large as the target.
    - `occluder`: without a mask, (h, w), what stands in the way beside what is read off the target:
      wherever it is not black.
    - `bright_pass`: without a mask, whether the light is all that is bright in the picture, as in a
      photograph, see `godfit.blind.photograph`.
    - `shader`, `samples`: a name in `godfit.scattering.taps.CONVENTIONS`, by default the scene's or
      `"mitchell"`; its own default number of samples.
    - `rays`: of the light in the plane, for each pixel, by default 64.
    - `lights`: how many lights are summed; they start in order from left to right.
    - `pass_scale`: the size of the light pass against the mask's, at most 1.
    - `fov`, `distance`: of Hoffman-Preetham without a scene: the vertical field of view in degrees
      and how far what is seen lies, a number or (h, w), in metres or in units that `scale` makes
      metres of. With a scene, `distance` is that of the sky.
    - `fix`: parameters held, at a value or (None) at the start or the shader's default.
    - `start`: parameters to start from. None is needed.
    - `valid`: (h, w), False where the target is to be ignored.
    - `transfer`: `"none"` or `"srgb"`, how the target (and the background) were encoded.
    - `channels`: 3 counts every channel of a grey picture, which costs time and adds no knowledge,
      but makes likelihoods comparable with those of models that are never grey.
    - `inquire`: where more than noise is left, whether to try other starts, to undo what the target
      went through (a JPEG's compression, a light pass stored smaller) and to ask what may be
      wrong. Fits that are only compared with each other can do without.
    - `max_values`: the most pixels, times channels, that decide; of larger pictures, rows drawn at
      random.
    - `seed`: of the choice of pixels.
    - `progress`: is called with a line of text as the fit goes on.

    **Returns:** a `FitResult`. Raises `InputError`, a ValueError of one line, for input that cannot
    be fitted.
    """
    model = model or (Mitchell.name if canvas is None else Flatland.name)
    request.check_model(model, free, shader, lights, fov, distance)
    if model == Flatland.name:
        plane.check_fit_arguments(canvas, mask, scene, background, samples, pass_scale)
    elif mask is not None and scene is not None:
        raise InputError("fit: expected a mask or a scene, got both")
    elif mask is None and scene is None:
        request.check_unaided(model, lights, background, occluder, bright_pass)
    elif canvas is not None or rays is not None:
        raise InputError(f"canvas, rays: expected --model {Flatland.name} with them, got {model}")
    if bright_pass and any(x is not None for x in (mask, scene, canvas)):
        raise InputError("bright pass: expected no mask, scene or canvas with it, got one")
    given = {"shader": shader, "samples": samples, "pass_scale": pass_scale}
    given |= {"bright_pass": bright_pass or None}
    with jax.enable_x64(False):
        # The program is one of float32, whatever the caller has set.
        if scene is not None:
            scene = in_single_precision(scene if isinstance(scene, Scene) else read_scene(scene))
        settings = {} if scene is None else scene.settings
        settings |= {k: v for k, v in given.items() if v is not None}
        try:
            return _fit(
                target, mask, background, occluder, scene, (canvas, rays), model, tuple(free),
                settings, lights, (fov, distance), fix or {}, start or {}, valid, transfer,
                channels, inquire, max_values, seed, progress or (lambda text: None),
            )  # fmt: skip
        except jax.errors.JaxRuntimeError as error:
            raise InputError.within(error) or error from error


def _fit(
    target: Source,
    mask: Source | None,
    background: Source | None,
    occluder: Source | None,
    scene: Scene | None,
    drawn: tuple[plane.CanvasSource | None, int | None],
    kind: str,
    staged: tuple[str, ...],
    settings: Mapping[str, Any],
    lights: int,
    geometry: tuple[float | None, float | np.ndarray | None],
    fix: Mapping[str, float | None],
    start: Mapping[str, float],
    valid: np.ndarray | None,
    transfer: str,
    channels: int | None,
    inquire: bool,
    most: int,
    seed: int,
    say: Say,
) -> FitResult:
    began, compiled = time.perf_counter(), compile_seconds()
    images = {"target": read_source(target, transfer)}
    pass_scale, notes = settings.get("pass_scale", 1.0), ()
    daylight = kind == HoffmanPreetham.name
    if mask is None and scene is None and drawn[0] is None:
        shading = mitchell_template(settings.get("shader", "mitchell"), settings.get("samples"), 1)
        blocked = None
        if occluder is not None:
            images["occluder"] = read_source(occluder, "none")
            blocked = occluder_mask(images["occluder"], images["target"])
        given = (settings.get("pass_scale"), fix, start, seed, say)
        if settings.get("bright_pass"):
            found = photograph.found_in(images["target"], shading, valid, *given)
        else:
            found, notes = unaided.found_in(images["target"], shading, valid, blocked, *given)
        return _concluded(found, notes, images, (began, compiled), seed)
    if scene is not None:
        scene = scene_at_pass_size(scene, images["target"], pass_scale)
        notes, pass_scale = tuple(f"scene: {note}" for note in scene.notes), 1.0
        start = light_on_screen(scene) | dict(start)
    model: AbstractModel
    picture = None
    if kind == Flatland.name:
        canvas, rays = drawn
        assert canvas is not None
        say("rays")
        model, picture, images["canvas"] = plane.prepare_fit(images["target"], canvas, rays, valid)
    elif daylight:
        model, assumed = daylight_template(scene, *geometry, settings.get("samples"))
        notes += assumed
    else:
        model = mitchell_template(
            settings.get("shader", "mitchell"), settings.get("samples"), lights
        )
    if scene is not None:
        smooth = scene.antialias is not False if daylight else scene.antialias or bool(staged)
        shown = as_sky_mask(scene) if daylight else scene
        images["mask"] = read_source(drawn_mask(shown, bool(smooth)), "none")
        if staged:
            assert isinstance(model, Mitchell)
            model = staged_template(model, scene, staged)
            start = {name: value for name, value in start.items() if name in model.parameters}
    elif picture is None:
        assert mask is not None
        images["mask"] = read_source(mask, "none")
    if background is not None:
        images["background"] = read_source(background, transfer)
    if picture is None:
        picture = checked_picture(
            images["target"], images["mask"], images.get("background"), valid, pass_scale,
            channels or model.channels,
        )  # fmt: skip
    roles = {r: dataclasses.replace(im, values=NOTHING) for r, im in images.items()}
    # What the picture does not need of them would stay in memory to the end.
    del images, target, mask, background
    given, held = given_and_held(model, fix, start)
    used = model.used
    free = np.isnan(held) & used
    opened: list[tuple[int, list[int]]] = []
    shows_itself = not isinstance(model, Mitchell | Staged) or model.convention.own_pixel
    if not shows_itself and free[0] and free[3]:
        # No pixel shows its own value: exposure and weight act only through their product.
        held[0] = given.get("exposure", model.defaults["exposure"])
        free[0] = False
        opened.append((0, [3]))
    if kind == Flatland.name and free[0] and not plane.emits_light(picture):
        held[0], free[0] = given.get("exposure", model.defaults["exposure"]), False
        notes += (f"the canvas sends out no light: exposure held at {held[0]:g}",)
    if scene is not None and isinstance(model, Mitchell) and not scene.antialias:
        say("edge pixels")
        begun = _starts(picture, model, given, seed)
        picture = agreed(picture, scene, model, begun, free, held, seed)
    found = _look(picture, model, given, free, held, opened, inquire, most, seed, say)
    return _concluded(found, notes, roles, (began, compiled), seed)


def _concluded(
    found: Found,
    notes: tuple[str, ...],
    images: dict[str, Image],
    since: tuple[float, float],
    seed: int,
) -> FitResult:
    """The result, with what the images' files say of themselves; ``since`` is when, and with how
    many seconds of compiling behind, the fit began."""
    notes += tuple(f"{role}: {note}" for role, im in images.items() for note in im.notes)
    files = {role: {"path": im.path, "sha256": im.sha256} for role, im in images.items()}
    timing = {"compile": compile_seconds() - since[1], "solve": time.perf_counter() - since[0]}
    return verdict(found, found.model.used, notes, files, timing, seed)


def _look(
    picture: Picture,
    model: AbstractModel,
    given: dict[str, float],
    free: np.ndarray,
    held: np.ndarray,
    opened: list[tuple[int, list[int]]],
    inquire: bool,
    most: int,
    seed: int,
    say: Say,
) -> Found:
    """Screen, climb, settle."""
    if isinstance(model, Staged):
        return _look_on_stage(picture, model, given, free, held, opened, inquire, most, seed, say)
    say("screening")
    begun = _starts(picture, model, given, seed)
    candidates = [begun[0]]
    if free.any():
        ladder = multigrid.SHARP if isinstance(model, Flatland) else multigrid.LADDER
        climbed = multigrid.climb(picture.small, model, begun, free, held, seed, say, ladder)
        candidates = [climbed.coordinates]
    if free.any() and model.banded:
        candidates = density_minima.on_subset(picture, model, candidates[0], free, held, seed, say)
    seen = picture.observe(pixels_used(picture, seed, most))
    say(f"all {len(seen.pixels):,} pixels")
    settled, at, counted = likeliest(picture, model, candidates, seen, free, held, seed)
    at = at.thinned(picture.repeats)
    found = Found(model, picture, counted, settled, at, free, held, opened, inquire)
    if inquire and free.any() and model.banded and multistart.doubtful(found):
        found = multistart.again(found, begun[:AGAIN], seed, say)
        say("mask or transfer read otherwise")
        remedy = multistart.remedy(found, lambda read: _starts(read, model, given, seed), seed)
        found = dataclasses.replace(found, remedy=remedy)
    return (
        indirect_inference.corrected(_hold_open(found, given))
        if inquire
        else _hold_open(found, given)
    )


def _starts(
    picture: Picture, model: AbstractModel, given: dict[str, float], seed: int
) -> list[np.ndarray]:
    """Where the search begins, best first."""
    if isinstance(model, HoffmanPreetham):
        return screening_daylight.starts(picture.small, model, given, keep=STARTS, seed=seed)
    if isinstance(model, Flatland):
        return sky_starts(picture.small, model, given, count=STARTS, seed=seed)
    assert isinstance(model, Mitchell)
    return screening.starts(picture.small, model, given, keep=STARTS, seed=seed)


def _look_on_stage(
    picture: Picture,
    model: Staged,
    given: dict[str, float],
    free: np.ndarray,
    held: np.ndarray,
    opened: list[tuple[int, list[int]]],
    inquire: bool,
    most: int,
    seed: int,
    say: Say,
) -> Found:
    """The fit of a picture whose mask follows a scene: geometry on small copies, the scattering
    through the mask that it draws, and then both together."""
    z = place(picture, model, given, free, held, seed, say)
    stage = model.moved(jnp.asarray(z), jnp.asarray(held))
    drawn = np.asarray(drawn_mask(resized(stage.staged(), picture.mask.shape[:2]), True))
    light = np.asarray(stage.light[0], np.float32)
    flat = _look(
        dataclasses.replace(picture, mask=drawn),
        model.shading,
        given | {"light_x": float(light[0]), "light_y": float(light[1])},
        np.append(free[:4], [False, False]),
        np.append(held[:4], light),
        [],
        inquire,
        most,
        seed,
        say,
    )
    z = np.append(flat.settled.coordinates[:4], z[4:]).astype(np.float32)
    say("scene and scattering")
    settled, tangent = settle(z, model, flat.seen, free, held)
    at = evidence(settled, tangent, flat.seen)
    found = Found(model, picture, flat.seen, settled, at, free, held, opened, inquire)
    return _hold_open(found, given)


def _hold_open(found: Found, given: dict[str, float]) -> Found:
    """Settle again with what the picture leaves open held, if there is such."""
    model, free, coordinates = found.model, found.free.copy(), found.settled.coordinates.copy()
    more = undetermined(
        found.at.blunt,
        model.ranges(coordinates),
        free,
        list(model.parameters).index(model.held_last),
    )
    if not more:
        return found
    free[[index for index, _ in more]] = False
    if not free[0] and free[3] and "exposure" in model.parameters:
        # Exposure has wandered on noise, and weight with it: back to what a user would expect.
        default = model.defaults.get("exposure", coordinates[0])
        coordinates[0] = given.get("exposure", default)
    settled, tangent = settle(coordinates, model, found.seen, free, found.held)
    return dataclasses.replace(
        found,
        settled=settled,
        at=evidence(settled, tangent, found.seen).thinned(found.picture.repeats),
        free=free,
        opened=found.opened + more,
    )
