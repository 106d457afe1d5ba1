"""A fit's numbers for another engine: by algebra where its sum has the same taps, else refitted.

What algebra cannot give (the pixel's own value, another blend) is rendered both ways and said in
levels. A refit moves what the engine has, with the light where the fit has it: its picture is
affine in the exposure, which is solved, and the rest is searched by the simplex of Nelder and Mead
(The Computer Journal 7 (1965), 308).
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from typing import Any

import numpy as np
from scipy import optimize

from godfit.errors import InputError
from godfit.io.filters import shrink
from godfit.io.image import LEVELS, encode
from godfit.models.build import mitchell_at
from godfit.models.mitchell import Mitchell
from godfit.report.engines.engine_code import TEMPLATES
from godfit.report.engines.export import Difference, Export
from godfit.report.engines.ports import port
from godfit.report.record import Recorded, read_params, recorded
from godfit.runtime.device import on_device
from godfit.runtime.program_cache import cached_jit
from godfit.scattering.conventions import CONVENTIONS, Convention, convention
from godfit.scattering.conventions.convention import SCATTERING_NAMES
from godfit.scattering.engines import ENGINES, ROUNDING, Engine, TapNumbers, translated

WORST_MATCH = 10.0
"""Levels rms from which a refit is not offered as a match."""
REFIT_SIDE = 160
"""Longest side, in pixels, of the copy that is refitted."""
REFIT_STEPS = 120
"""Evaluations of a refit, at most: two or three numbers settle in half of them."""
REFIT_STARTS = (0.25, 0.5, 0.75, 0.95)
"""Densities that a refit starts from, as shares of the largest useful one: its valley bends."""
NATRON_SAMPLES = 32
"""Taps of Natron's GodRays at its default of 5 steps."""
REFIT_ROUNDS = 3
"""Solutions for the exposure, each with what the one before it clips left out."""
START_WEIGHT = 0.5
"""Weight that a refit starts from."""


@dataclasses.dataclass(frozen=True)
class Files:
    """Files in place of those that a fit.json names."""

    mask: str | None = None
    scene: str | None = None
    background: str | None = None


def engine_named(name: str) -> Engine:
    """The engine of this name, or of the convention or effect of this name. Raises InputError for
    an unknown one, naming the closest."""
    if name in ENGINES:
        return ENGINES[name]
    folded = name.lower().replace(" ", "-").replace("_", "-")
    for engine in ENGINES.values():
        if folded in (engine.name, engine.convention):
            return engine
    try:
        meant = convention(name).name
    except InputError:
        meant = ""
    for engine in ENGINES.values():
        if meant and engine.convention == meant:
            return engine
    closest = difflib.get_close_matches(folded, ENGINES, n=1, cutoff=0.0)[0]
    raise InputError(
        f"to: expected list or one of {', '.join(ENGINES)}, got '{name}'; did you mean '{closest}'?"
    )


def export(path: str, to: str, files: Files | None = None) -> Export:
    """The fit in the file ``path`` for the engine ``to``, see ``ENGINES``.

    ``files`` stand in place of those that the fit names. Raises InputError for an unknown engine,
    for a fit that no engine has, for a mask that is not found where a refit needs it, and for a
    refit that is WORST_MATCH levels rms off or more, with the reason.
    """
    engine, files = engine_named(to), files or Files()
    settings = read_params(path)
    if settings.get("model", Mitchell.name) != Mitchell.name:
        raise InputError(f"'{path}': expected a fit of mitchell, got {settings['model']}")
    model = mitchell_at(settings, {}, [])
    if engine.kind == "port":
        code = port(model, engine.template, engine.v_down)
        notes = _threshold_note(model.convention) + _pass_note(settings)
        return Export(engine, code, _values(model), True, None, notes)
    images = _images(path, files, engine)
    return for_engine(model, engine, images, _pass_note(settings))


def for_engine(
    model: Mitchell, engine: Engine, images: Recorded | None, notes: tuple[str, ...] = ()
) -> Export:
    """``model`` for an engine; without ``images`` by algebra alone. Raises InputError as ``export``
    does."""
    own = _own_sum(model.convention, engine)
    reason, found, difference = "", None, None
    try:
        if model.convention.key != own.name and not model.convention.plain:
            raise InputError(
                f"{engine.name}: expected a sum of taps that algebra translates, got "
                f"'{model.convention.name}'"
            )
        found = _by_algebra(model, own)
        difference = None if images is None else _difference(model, found, images)
    except InputError as error:
        reason = str(error)
    by_algebra = found is not None
    # Algebra keeps every tap but the pixel's own: it goes before a refit that moves all of them.
    if images is not None and (difference is None or difference.rms >= WORST_MATCH):
        refitted = _refitted(model, own, images, found)
        off = _difference(model, refitted, images)
        if difference is None or off.rms < difference.rms:
            found, difference, by_algebra = refitted, off, False
    if found is None:
        raise InputError(f"{reason}; a refit needs the fit's mask: give --mask or --scene")
    if difference is not None and difference.rms >= WORST_MATCH:
        why = f": {reason}" if reason else ""
        raise InputError(
            f"{engine.name}: expected a picture within {WORST_MATCH:g} levels rms, got "
            f"{difference.rms:.3g} rms and {difference.worst:.3g} at worst, which is no match"
            f"{why}; export to a port of the fit's own shader, see --to list"
        )
    told = [f"exact with: {option}" for option in engine.options]
    if reason:
        told.append(f"no algebra: {reason}")
    if by_algebra and not (model.convention.composed or own.composed):
        told += _own_pixel_note(model, found)
    if len(found.light) > 1:
        told.append("one effect for each light, each with its own center")
    lines = []
    for u, v in np.asarray(found.light, float):
        light = float(u), float(1 - v if engine.v_down else v)
        shown = own.blend if engine.template == "pmndrs" else engine.convention
        lines += TEMPLATES[engine.template](_values(found), light, shown)
    code = "\n".join(lines) + "\n"
    return Export(engine, code, _values(found), by_algebra, difference, (*told, *notes))


def _own_pixel_note(model: Mitchell, other: Mitchell) -> list[str]:
    """Where the pixel's own value has another factor, both of them."""
    here, there = (float(one.taps[0].own) for one in (model, other))
    if abs(here - there) <= ROUNDING * max(here, there):
        return []
    return [
        f"all other taps are the same; the pixel's own value has a factor of {there:.4g}, in the "
        f"fit {here:.4g}"
    ]


def _threshold_note(shader: Convention) -> tuple[str, ...]:
    if not shader.threshold:
        return ()
    note = f"the threshold of {shader.threshold:g} acts on what is filtered, in the fit on texels"
    return (f"{note}: edges of the mask differ",)


def _pass_note(settings: dict[str, Any]) -> tuple[str, ...]:
    scale = settings.get("pass_scale", 1.0)
    if scale == 1:
        return ()
    return (f"light pass at {scale:g} of the picture's size, as in the fit",)


def _images(path: str, files: Files, engine: Engine) -> Recorded | None:
    """The images of the fit; None where they are not here and no option gives them."""
    given = files.mask or files.scene or files.background
    try:
        return recorded(path, mask=files.mask, scene=files.scene, background=files.background)
    except InputError:
        if given or engine.kind == "near":
            raise
        return None


def _own_sum(shader: Convention, engine: Engine) -> Convention:
    """The engine's convention as it is set for a match: without a threshold, and blended as the
    fit's shader is where it can be."""
    own = CONVENTIONS[engine.convention]
    changes: dict[str, Any] = {}
    if own.threshold:
        changes["threshold"] = 0.0
    if own.blend != shader.blend and shader.blend in engine.blends:
        changes["blend"] = shader.blend
    return convention(dataclasses.replace(own, **changes)) if changes else own


def _by_algebra(model: Mitchell, own: Convention) -> Mitchell:
    """The model of the engine's sum with the same taps. Raises InputError where there is none."""
    if own.key == model.convention.key:
        return model
    exposure = None if model.convention.own_pixel else float(model.exposure)
    values = translated(TapNumbers.of(model.taps[0]), own, exposure).values
    return _model(own, values, np.asarray(model.light))


def _model(own: Convention, values: dict[str, float], light: np.ndarray) -> Mitchell:
    known = {"exposure": 1.0, "decay": 1.0, "density": 1.0, "weight": 1.0} | own.absent | values
    exposure, decay, density, weight = (known[name] for name in SCATTERING_NAMES)
    return Mitchell(exposure, decay, density, weight, light, own.key, int(values["samples"]))


def _values(model: Mitchell) -> dict[str, float]:
    """The parameters that the model's formula has, and its samples."""
    values = {name: float(value) for name, value in model.values().items()}
    used = {name: values[name] for name in model.convention.parameters}
    return used | {"samples": float(model.samples)}


def _levels(model: Mitchell, images: Recorded) -> np.ndarray:
    picture = np.clip(_unclipped(model, images), 0, 1)
    return LEVELS * np.asarray(encode(picture, images.transfer), np.float64)


def _difference(model: Mitchell, other: Mitchell, images: Recorded) -> Difference:
    one, two = _levels(model, images), _levels(other, images)
    if one.ndim != two.ndim:
        one, two = np.atleast_3d(one), np.atleast_3d(two)
    off = np.abs(one - two)
    apart = np.abs(np.round(one) - np.round(two))
    return Difference(float(np.sqrt(np.square(off).mean())), float(off.max()), int(apart.max()))


def _refitted(
    model: Mitchell, own: Convention, images: Recorded, start: Mitchell | None
) -> Mitchell:
    """The numbers of the engine's sum whose picture is nearest to that of ``model``, on a small
    copy, with its light."""
    small = _small(images)
    goal = _levels(model, small) / LEVELS
    samples = NATRON_SAMPLES if own.name == "mean" and start is None else own.samples
    if own.passes == "sun-beams":
        # Its samples are the steps of a pixel to the farthest light.
        samples = math.ceil(math.hypot(*small.mask.shape[:2]))
    samples = int(start.samples) if start is not None else samples
    names = [name for name in own.parameters if name != "exposure"]
    if own.product_open:
        # Only the product with the exposure is determined.
        names = [name for name in names if name != "weight"]
    ends = {"decay": (0.5, 1.0), "density": (1e-2, own.most_density), "weight": (0.0, 100.0)}
    light = np.asarray(model.light)
    base = {} if start is None else _values(start)

    def solved(point: np.ndarray) -> tuple[float, Mitchell]:
        values = {"weight": base.get("weight", START_WEIGHT)} if own.product_open else {}
        for name, value in zip(names, point, strict=True):
            values[name] = float(np.clip(value, *ends[name]))
        return _exposed(own, values | {"samples": float(samples)}, light, (small, goal))

    def whole(found: Mitchell) -> Mitchell:
        steps = own.samples if own.passes == "sun-beams" else int(found.samples)
        return dataclasses.replace(found, samples=steps)

    if not names:
        return solved(np.zeros(0))[1]
    starts = [np.array([base[name] for name in names])] if base else []
    for share in REFIT_STARTS:
        rest = {"decay": 0.97, "density": share * min(own.most_density, 1.0), "weight": 0.5}
        starts.append(np.array([rest[name] for name in names]))
    starts.sort(key=lambda point: solved(point)[0])
    best = optimize.minimize(
        lambda point: solved(point)[0], starts[0], method="Nelder-Mead",
        options={"maxfev": REFIT_STEPS, "xatol": 1e-4, "fatol": 1e-4},
    )  # fmt: skip
    return whole(solved(best.x)[1])


def _exposed(
    own: Convention, values: dict[str, float], light: np.ndarray, to: tuple[Recorded, np.ndarray]
) -> tuple[float, Mitchell]:
    """The error in levels rms, and the model with ``values`` and the exposure of the least one. A
    picture is affine in the exposure but where it is clipped or saturated: two rounds suffice."""
    images, goal = to
    exposure = own.defaults.get("exposure", 1.0)
    model, error = _model(own, values | {"exposure": exposure}, light), np.inf
    for _ in range(REFIT_ROUNDS):
        shown = _unclipped(model, images)
        dark = _unclipped(_model(own, values | {"exposure": 0.0}, light), images)
        rays = (shown - dark).ravel()
        wanted = np.broadcast_to(_like(goal, shown), shown.shape)
        # What is clipped in both says nothing about the exposure.
        counts = ~((wanted >= 1) & (shown >= 1)).ravel()
        power = float(rays[counts] @ rays[counts])
        if power <= 0:
            break
        share = float(rays[counts] @ (wanted - dark).ravel()[counts]) / power
        exposure = max(exposure * share, 0.0)
        model = _model(own, values | {"exposure": exposure}, light)
    shown = np.clip(_unclipped(model, images), 0, 1)
    error = LEVELS * float(np.sqrt(np.square(shown - _like(goal, shown)).mean()))
    return error, model


def _like(image: np.ndarray, other: np.ndarray) -> np.ndarray:
    return image[..., None] if image.ndim < other.ndim else image


def _unclipped(model: Mitchell, images: Recorded) -> np.ndarray:
    """The picture, linear, not clipped: in single precision, as it is fitted."""
    back = None if images.background is None else on_device(images.background)
    return np.asarray(_picture(model, on_device(images.mask), back, images.size), np.float64)


@cached_jit
def _picture(model, mask, background, size):
    return model(mask, background, size=size)


def _small(images: Recorded) -> Recorded:
    """The images at REFIT_SIDE pixels, at most."""
    h, w = images.size
    if max(h, w) <= REFIT_SIDE:
        return images
    factor = REFIT_SIDE / max(h, w)

    def smaller(image: np.ndarray) -> np.ndarray:
        rows, columns = (max(2, round(n * factor)) for n in image.shape[:2])
        return shrink(image, (rows, columns))

    back = None if images.background is None else smaller(images.background)
    size = max(2, round(h * factor)), max(2, round(w * factor))
    return dataclasses.replace(images, mask=smaller(images.mask), background=back, size=size)
