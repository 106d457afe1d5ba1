"""Pictures of the models that light a mask or a scene, for ``godfit render``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from godfit.commands.lights import Lights
from godfit.commands.progress import warn
from godfit.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from godfit.report.record import Recorded
    from godfit.scattering.conventions import Convention
    from godfit.scenes.scene import Scene

HALF_LEVEL = 0.5 / 255
"""A picture that is nowhere brighter is black in eight bits."""
BLACK_VOLUME = {
    True: "the picture is black: the sun is at the horizon or below, or --e-sun is too small; move "
    "the scene's light up, or give a larger --e-sun",
    False: "the picture is black: the lamp's light does not reach it; give a larger --e-sun, or a "
    "smaller --scale",
}
"""Warnings of a volume without light, by whether its source is the sun."""
PARAMETER_OPTIONS = ("exposure", "decay", "density", "weight", "e_sun", "scale", "turbidity", "g")
"""Options that are parameters of a model."""
RENDER_BYTES = 16
"""Memory that a rendering takes a value, in bytes: the picture, the pass, and what is written."""


def on_screen(
    mask: str, recorded: dict[str, Any], transfer: str, options: dict[str, Any]
) -> tuple[np.ndarray, str]:
    """The picture of a model that reads a mask or a scene, and the transfer of its file."""
    from godfit.io.image import read_image
    from godfit.request import check_model
    from godfit.scenes.mesh import MESH_SUFFIXES

    scene, settings = None, {}
    if mask.lower().endswith((".toml", *MESH_SUFFIXES)):
        from godfit.scenes.scene import read_scene
        from godfit.scenes.view import light_on_screen, resized

        scene = read_scene(mask)
        if scene.any_size and options["size"]:
            scene = resized(scene, options["size"])
        settings = {**scene.settings, **light_on_screen(scene)}
        transfer = settings.pop("transfer", "none") if transfer == "none" else transfer
    settings |= recorded
    light, kind = options["light"], options["model"] or settings.get("model", "mitchell")
    if kind != "volume":
        count = 1 if kind == "mitchell" else max(len(light.places), 1)
        check_model(kind, (), options["shader"], count, options["fov"], options["distance"])
    settings |= given_options(options, ("shader", "samples", "pass_scale"))
    background = None
    if options["background"] is not None:
        background = read_image(options["background"], transfer=transfer).values
    if options["composite"]:
        check_composite(scene, kind, background)
    check_page(options, kind)
    draw = mitchell if kind == "mitchell" else daylight
    picture = Picture(mask, scene, background, settings, light, transfer)
    return draw(picture, options), transfer


class Picture(NamedTuple):
    """The inputs of a rendering: the file of the mask or the scene, the ``scene`` if it is one, the
    ordinary pass, settings, positions of lights, and the encoding of what is written."""

    mask: str
    scene: Scene | None
    background: np.ndarray | None
    settings: dict[str, Any]
    light: Lights
    transfer: str

    def check_background(self, size: tuple[int, ...]) -> None:
        """Raise InputError where the ordinary pass is not as large as the picture."""
        back = self.background
        if back is not None and back.shape[:2] != tuple(size):
            raise InputError(
                f"background: expected {size[1]}x{size[0]} pixels, got "
                f"{back.shape[1]}x{back.shape[0]}"
            )


def check_page(options: dict[str, Any], kind: str) -> None:
    """Raise UsageError for a page of a model that no page can run."""
    if options["html"] and kind != "mitchell":
        raise click.UsageError(f"--html: expected --model mitchell with it, got {kind}")


def write_page(path: str, images: Recorded) -> None:
    """Write a page that runs the shader on its mask."""
    from godfit.report.files import page_writer
    from godfit.report.pages import render_page

    page_writer(lambda: render_page(images).html())(Path(path))


def check_composite(scene: Scene | None, kind: str, background: np.ndarray | None) -> None:
    """Raise UsageError for what cannot be blended with a scene's ordinary pass."""
    if scene is None:
        raise click.UsageError("--composite: expected a SCENE.toml with it, got a mask")
    if kind != "mitchell":
        raise click.UsageError(f"--composite: expected --model mitchell with it, got {kind}")
    if background is not None:
        raise click.UsageError("--composite: expected no --background with it, got one")


def pass_scale(
    settings: Mapping[str, Any], shader: Convention, whole: tuple[int, ...], size: tuple[int, ...]
) -> float:
    """The size of the light pass relative to a mask of ``whole`` (rows, columns) in a picture of
    ``size``: that of the settings, else the shader's own. A mask smaller than the picture is a
    light pass already."""
    if "pass_scale" in settings:
        return settings["pass_scale"]
    if "pass_size" in settings:
        # An older fit.json has the pass's own size alone.
        return min(1.0, settings["pass_size"][0] / whole[0])
    return 1.0 if whole[0] < size[0] else shader.pass_scale


def mitchell(picture: Picture, options: dict[str, Any]) -> np.ndarray:
    """(h, w) or (h, w, 3) Mitchell's sum, whose light pass has an error of at most ``tolerance``
    levels. All lights are summed by one method, and their errors add up."""
    import equinox as eqx
    import numpy as np

    from godfit.inference.observation import render
    from godfit.io.image import read_image
    from godfit.io.sources import pass_size, shrink_mask
    from godfit.models.build import mitchell_at
    from godfit.report.record import Recorded
    from godfit.runtime.device import on_device
    from godfit.runtime.memory import check_memory
    from godfit.scattering.radial import cheapest
    from godfit.scenes.ordinary import ordinary_pass
    from godfit.scenes.scene import Scene
    from godfit.scenes.view import drawn_mask, resized

    scene, background = picture.scene, picture.background
    drawn = read_image(picture.mask).values if scene is None else scene
    whole = drawn.size if isinstance(drawn, Scene) else drawn.shape[:2]
    size = whole if background is None else background.shape[:2]
    if options["size"]:
        size = options["size"]
    lights = picture.light.uv(size)
    model = mitchell_at(picture.settings, given_options(options, PARAMETER_OPTIONS), lights)
    masks = [] if isinstance(drawn, Scene) else [drawn]
    backs = [] if background is None else [background]
    channels = max([np.atleast_3d(x).shape[2] for x in masks + backs], default=1)
    check_memory(RENDER_BYTES * size[0] * size[1] * channels, "render")
    picture.check_background(size)
    scale = pass_scale(picture.settings, model.convention, whole, size)
    if isinstance(drawn, Scene):
        low = resized(drawn, pass_size(whole, scale))
        occlusion = drawn_mask(low, drawn.antialias is not False)
        if options["composite"]:
            background = ordinary_pass(resized(drawn, size))
    else:
        occlusion = shrink_mask(drawn, scale)
    if options["html"]:
        write_page(
            options["html"], Recorded(model, occlusion, background, size, picture.transfer, ())
        )
    if not options["tolerance"]:
        return render(model, occlusion, background, size)
    low, back = on_device(occlusion), None if background is None else on_device(background)
    method = cheapest(low, model.light, model.taps[-1], options["tolerance"])
    return np.clip(np.asarray(eqx.filter_jit(model)(low, back, size=size, method=method)), 0, 1)


def daylight(picture: Picture, options: dict[str, Any]) -> np.ndarray:
    """(h, w, 3) Hoffman and Preetham's daylight, with a mask that is 1 where the sky is visible;
    or, for the model ``volume``, the same air, marched through a scene."""
    import numpy as np

    from godfit.inference.observation import render
    from godfit.io.image import read_image
    from godfit.models import volume
    from godfit.models.build import daylight_at
    from godfit.scenes.view import as_sky_mask, drawn_mask

    scene, settings = picture.scene, dict(picture.settings)
    if scene is None:
        sky = read_image(picture.mask).values
        size = sky.shape[:2]
    else:
        # A volume needs no mask: it is drawn below. A fit records one typical distance; the scene
        # has them all.
        sky, size = None, scene.size
        settings.pop("distance", None)
    settings |= given_options(options, ("fov", "distance", "phase"))
    lights = picture.light.uv(size)
    model = daylight_at(settings, given_options(options, PARAMETER_OPTIONS), lights, scene)
    if (options["model"] or settings.get("model")) == "volume":
        if scene is None:
            raise InputError("volume: expected a SCENE.toml, got an image; it has no depth")
        picture.check_background(scene.size)
        image = volume.render(
            scene, model.air, np.asarray(model.view.distance), source=options["source"],
            steps=options["steps"] or 128, background=picture.background,
        )  # fmt: skip
        if image.max() < HALF_LEVEL:
            warn(BLACK_VOLUME[options["source"] == "sun"])
        return np.clip(image, 0, 1)
    if sky is None:
        assert scene is not None
        sky = drawn_mask(as_sky_mask(scene), True)
    picture.check_background(sky.shape[:2])
    return render(model, sky, picture.background, (sky.shape[0], sky.shape[1]))


def given_options(options: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """The options among ``names`` that were given, by name."""
    return {name: options[name] for name in names if options[name] is not None}
