"""The problem that a request poses: its images, its model, and what is held."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from godfit.errors import Remark
from godfit.inference.allowances.prior import checked_prior
from godfit.inference.problem import Problem, checked_picture, given_and_held
from godfit.inference.strategy import left_open, refined_mask
from godfit.io.image import Image
from godfit.io.sources import FLIPS, read_source, turned, without_holes
from godfit.models.base import AbstractModel
from godfit.models.build import staged_template, template
from godfit.request import Request
from godfit.scenes.scene import Scene
from godfit.scenes.view import (
    as_sky_mask,
    drawn_mask,
    light_on_screen,
    scene_at_pass_size,
)
from godfit.search.registration.explanations import registered
from godfit.search.registration.maps import fitted_size, unregistered

NO_VALUES = np.zeros((0, 0), np.float32)
"""Stands for the values of an image of which only the file's name is still needed."""
UNKNOWN_SCALE = 1.0
"""Exposure that is held where no picture determines it and its shader publishes none."""


class Posed(NamedTuple):
    """A problem ready to be solved: parameters ``given`` by name, notes, the images by role without
    their values, and the scene that the mask was drawn from; ``opened`` and ``shifts`` as in
    ``Found``; the mask as it was given, ``unregistered``, where it is to be registered; why a fit
    under it cannot be relied on, ``objection``."""

    problem: Problem
    given: dict[str, float]
    notes: tuple[str, ...]
    images: dict[str, Image]
    scene: Scene | None
    opened: tuple[tuple[int, list[int]], ...] = ()
    unregistered: np.ndarray | None = None
    shifts: tuple[np.ndarray, ...] = ()
    objection: str = ""


def _as_given(request: Request) -> Posed:
    """The problem of a request, ready to be solved. Raises InputError for images that do not fit
    together."""
    settings, scene, notes = request.settings, request.scene, ()
    images = {"target": target_of(request)}
    pass_scale, start = settings.get("pass_scale", 1.0), dict(request.start or {})
    whole = None
    model: AbstractModel
    if request.canvas is not None:
        request.report("rays")
        from godfit.flatland.fit_setup import prepare_fit

        model, picture, images["canvas"] = prepare_fit(
            images["target"], request.canvas, request.rays, request.valid
        )
    else:
        assert scene is None or isinstance(scene, Scene)
        if scene is not None:
            scene = scene_at_pass_size(scene, images["target"], pass_scale)
            notes, pass_scale = (
                tuple(Remark(f"scene: {note}", "scene") for note in scene.notes),
                1.0,
            )
            start = light_on_screen(scene) | start
        geometry = scene, request.fov, request.distance
        model, assumed = template(request.kind, settings, request.lights, geometry)
        notes += assumed
        if scene is not None:
            images["mask"] = read_source(_mask_of(scene, model, bool(request.free)), "none")
        else:
            assert request.mask is not None
            images["mask"] = read_source(request.mask, "none", "mask")
        if request.free:
            assert scene is not None
            model = staged_template(model, scene, request.free)
            start = {name: value for name, value in start.items() if name in model.parameters}
        if request.background is not None:
            back = read_source(request.background, request.transfer, "background")
            images["background"] = turned(back, request.flip)
        valid = request.valid
        if valid is not None and request.flip is not None:
            valid = np.flip(valid, FLIPS[request.flip][1])
        if request.mask is not None:
            values, size = images["mask"].values, images["target"].values.shape[:2]
            whole = unregistered(values, size, request.register, pass_scale)
        if whole is not None:
            images["mask"] = dataclasses.replace(images["mask"], values=fitted_size(whole, size))
        picture = checked_picture(
            images["target"], images["mask"], images.get("background"), valid, pass_scale,
            request.channels or model.channels,
        )  # fmt: skip
        if request.arithmetic is not None:
            picture = dataclasses.replace(picture, arithmetic=request.arithmetic)
    given, held = given_and_held(model, request.held_at, start)
    free = np.isnan(held) & model.used
    prior = checked_prior(request.prior or {}, model, held)
    notes += tuple(
        Remark(f"prior: {name} = {mean:.6g} +- {sigma:.2g}", "prior")
        for name, (mean, sigma) in prior.items()
    )
    assert scene is None or isinstance(scene, Scene)
    problem = Problem(model, picture, free, held, request.seed, prior=prior)
    return Posed(problem, given, notes, without_values(images), scene, unregistered=whole)


def _mask_of(scene: Scene, model: AbstractModel, moves: bool) -> np.ndarray:
    """The mask that the model reads of a scene. It is anti-aliased where the scene has it so, where
    the scene ``moves``, and where the model averages the mask anyway."""
    if model.mask_is_sky:
        return drawn_mask(as_sky_mask(scene), scene.antialias is not False)
    return drawn_mask(scene, bool(scene.antialias) or moves)


def pose(request: Request) -> Posed:
    """The problem of a request with what no picture determines held, and with the mask of a scene
    refined by the target."""
    posed = _as_given(request)
    problem, notes, always_open = posed.problem, posed.notes, ()
    opened = left_open(problem.model, problem)
    if opened is not None:
        default = problem.model.defaults.get(opened.name, UNKNOWN_SCALE)
        value = posed.given.get(opened.name, default)
        problem = problem.holding(opened.name, value)
        if opened.note:
            notes += (opened.note.format(value),)
        else:
            partners = [problem.index(partner) for partner in opened.partners]
            always_open = ((problem.index(opened.name), partners),)
    if posed.scene is not None:
        picture = refined_mask(problem.model, problem, posed.scene, posed.given, request.report)
        problem = problem.replaced(picture=picture)
    shifts: tuple[np.ndarray, ...] = ()
    objection = ""
    if posed.unregistered is not None:
        moved = registered(problem, posed.unregistered, posed.given, request.report)
        problem, shifts = moved.problem, moved.shifts
        notes, objection = (*notes, moved.note), moved.objection
    return posed._replace(
        problem=problem, notes=notes, opened=always_open, shifts=shifts, objection=objection
    )


def target_of(request: Request) -> Image:
    """The target, zero where it is not finite and ignored."""
    target = read_source(request.target, request.transfer, "target", finite=False)
    return turned(without_holes(target, request.valid), request.flip)


def without_values(images: dict[str, Image]) -> dict[str, Image]:
    """The images by role, without their values: of most, only the file is still needed."""
    return {role: dataclasses.replace(im, values=NO_VALUES) for role, im in images.items()}
