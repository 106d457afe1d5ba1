"""``godfit render``: a picture from parameters."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from godfit.commands.lights import Lights, with_light
from godfit.commands.options import (
    LIMIT,
    MAX_SEED,
    SHADER,
    Command,
    check_image_name,
    colour,
    image_size,
)
from godfit.commands.progress import warn
from godfit.commands.study import start_jax
from godfit.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from godfit.report.record import Recorded
    from godfit.scattering.conventions import Convention
    from godfit.scenes.scene import Scene

FLATLAND_OPTIONS = (
    "rays", "method", "jitter", "film_grain", "seed", "published", "sun", "sky", "sun_angle",
    "sun_width", "noise", "grain", "enable_sun", "accumulate_radiance", "time", "passes", "frames",
    "accumulate",
)  # fmt: skip
"""Options of the light in the plane alone."""
SWITCHES = {
    "noise": "--no-noise",
    "enable_sun": "--no-sun",
    "accumulate_radiance": "--no-accumulate",
}
"""Options that are spelled otherwise than their name."""
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


class RenderCommand(Command):
    """``render``, with one line for what its options were until they got their present meaning."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        for option, value in itertools.pairwise([*args, ""]):
            glued = option.removeprefix("--grain=") if option.startswith("--grain=") else ""
            number = glued or (value if option == "--grain" and is_number(value) else "")
            if number:
                raise click.UsageError(
                    f"--grain: expected no value, got {number}; noise laid on the picture is "
                    f"--film-grain {number}, and --grain is the angular noise of --published gi"
                )
        return super().parse_args(ctx, args)


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def published_name(context: click.Context, option: click.Parameter, name: str | None) -> str | None:
    """The name of a published shader; None stays None."""
    if name is not None:
        from godfit.flatland.published import PUBLISHED

        if name not in PUBLISHED:
            names = " or ".join(f"--published {known}" for known in PUBLISHED)
            raise click.UsageError(f"--published: expected {names}, got {name or 'no name'}")
    return name


@click.command(cls=RenderCommand)
@click.argument("mask", metavar="MASK|SCENE.toml")
@click.option("-o", "--output", help="Image to write: .png or .npy (linear floats).")
@click.option("--html", metavar="FILE", help="Page to write: the shader live, with sliders.")
@click.option("--model", help="mitchell, hoffman-preetham, volume or flatland. [default: mitchell]")
@click.option("--params", metavar="FIT.JSON", help="Take shader and parameters from a fit.")
@SHADER
@LIMIT
@click.option("--exposure", type=float, help="Scale of the whole light pass.")
@click.option("--decay", type=float, help="Weight of each tap relative to the one before it.")
@click.option("--density", type=float, help="Share of the way to the light that taps reach.")
@click.option("--weight", type=float, help="Weight of the taps against the pixel's own value.")
@click.option("--e-sun", type=float, help="The sun's irradiance, or a lamp's intensity.")
@click.option("--scale", type=float, help="Metres of air that a unit of distance stands for.")
@click.option("--turbidity", type=float, help="Haze: 2 clear, 6 hazy. [default: 2]")
@click.option("--g", type=float, help="Mean cosine of the haze's scattering. [default: .76]")
@click.option("--phase", help="Phase function: normalised or published. [default: normalised]")
@click.option("--fov", type=float, help="Vertical field of view in degrees, without a scene.")
@click.option(
    "--distance", type=float, help="Distance of visible surfaces; with a scene, of the sky."
)
@click.option("--source", default="sun", help="Volume: sun or lamp. [default: sun]")
@click.option(
    "--steps",
    type=int,
    help="Volume, flatland: steps of a ray. [default: 128 for a volume; published: 128, 32]",
)
@click.option("--rays", type=int, help="Flatland: rays a pixel. [default: 64; published: 8, 32]")
@click.option("--method", help="Flatland: distance, march or cascades. [default: distance]")
@click.option(
    "--sun-angle",
    type=float,
    help="Flatland: degrees, counterclockwise from the right. [default: 120; published: 119.36]",
)
@click.option(
    "--sun-width",
    type=float,
    help="Flatland: degrees to either side. [default: 60; published: 57.3, to one side]",
)
@click.option("--sun", metavar="R,G,B", help="Flatland: the sun's radiance. [default: .95,.95,.9]")
@click.option("--sky", metavar="R,G,B", help="Flatland: the sky's radiance. [default: .02,.08,.2]")
@click.option("--jitter", is_flag=True, help="Flatland: every pixel turns its rays; see --seed.")
@click.option(
    "--seed",
    type=click.IntRange(0, MAX_SEED),
    help="Flatland: seed of jitter and film grain. [default: 0]",
)
@click.option("--film-grain", type=float, metavar="SIGMA", help="Flatland: noise laid on.")
@click.option(
    "--published",
    metavar="naive|gi",
    is_flag=False,
    flag_value="",
    callback=published_name,
    help="Flatland: one of the two shaders of jason.today/gi, with its own defaults.",
)
@click.option("--no-noise", "noise", flag_value=False, default=None, help="Published: no noise.")
@click.option("--grain/--no-grain", default=None, help="Published gi: angular noise. [default: on]")
@click.option(
    "--no-sun", "enable_sun", flag_value=False, default=None, help="Published gi: a dark sky."
)
@click.option(
    "--no-accumulate",
    "accumulate_radiance",
    flag_value=False,
    default=None,
    help="Published naive: only the last step is tested.",
)
@click.option("--time", type=float, help="Published gi: another noise. [default: 0]")
@click.option("--passes", type=int, help="Published gi: passes of the flood. [default: all]")
@click.option("--frames", type=int, help="Flatland: accumulate frames, each with its own noise.")
@click.option(
    "--accumulate",
    metavar="mix|mean",
    help="Flatland: how. [default: mix with --published gi, else mean]",
)
@with_light("Position of a light; repeat for several.")
@click.option("--background", help="Ordinary pass to blend the light pass with.")
@click.option(
    "--composite", is_flag=True, help="Draw the ordinary pass of SCENE.toml, and blend it."
)
@click.option("--size", metavar="WxH", help="Size of the image. [default: the mask's]")
@click.option(
    "--pass-scale",
    type=float,
    help="Size of the light pass relative to the mask, at most 1. [default: as in the fit or the "
    "scene; else dawntime, vesper: .5]",
)
@click.option(
    "--transfer", type=click.Choice(["none", "srgb"]), default="none", help="Encoding of the image."
)
@click.option(
    "--bits", type=click.Choice(["8", "16"]), default="8", help="Bits of each channel of a PNG."
)
@click.option(
    "--tolerance",
    type=float,
    metavar="LEVELS",
    help="Largest error, in 8-bit levels, that a faster method may make. [default: exact]",
)
def render(mask: str, output: str | None, transfer: str, bits: str, **options: Any) -> int:
    """Render a mask or a scene with given parameters.

    Parameters that are not given are the shader's defaults. --model hoffman-preetham takes a mask
    that is 1 where the sky is visible; --model volume marches through the air of a SCENE.toml. Both
    need --e-sun and --scale. --model flatland takes a canvas, an RGBA image or a .toml of shapes.
    Its colour is emitted light and its alpha is opacity, so that black and opaque throws shadows.

    --composite blends the light pass with the scene's objects in their own colours; with --exposure
    0 as well, the ordinary pass comes out alone.
    """
    from godfit.io.image import write_image
    from godfit.report.record import read_params

    if output is None and options["html"] is None:
        raise click.UsageError("expected -o IMAGE or --html FILE, got neither")
    if output is not None:
        check_image_name(output)
    start_jax()
    tolerance = options["tolerance"]
    if tolerance is not None and not 0 <= tolerance < float("inf"):
        raise click.BadParameter(
            f"expected a number of levels, 0 or more, got {tolerance:g}", param_hint="--tolerance"
        )
    options["size"] = image_size(options["size"]) if options["size"] else None
    for name in ("sun", "sky"):
        options[name] = colour(options[name], f"--{name}")
    # A flag that is not set was not given.
    options["jitter"] = options["jitter"] or None
    recorded = read_params(options["params"]) if options["params"] else {}
    if (options["model"] or recorded.get("model")) == "flatland":
        from godfit.flatland.file_rendering import render_file

        given = given_options(options, (*FLATLAND_OPTIONS, "steps", "exposure"))
        check_plane_options(given)
        check_page(options, "flatland")
        image = render_file(mask, recorded | given)
    else:
        for name in given_options(options, FLATLAND_OPTIONS):
            raise click.UsageError(f"{spelled(name)}: expected --model flatland with it")
        image, transfer = on_screen(mask, recorded, transfer, options)
    if output is not None:
        write_image(output, image, transfer=transfer, bits=int(bits), exact=True)
    return 0


def check_plane_options(given: dict[str, Any]) -> None:
    """Raise click.UsageError for an option that means nothing beside the others."""
    from godfit.flatland.file_rendering import option_names
    from godfit.flatland.published import PUBLISHED

    shader = given.get("published")
    for name in given:
        if name in ("published", *option_names(shader)):
            continue
        holders = [f"--published {other}" for other in PUBLISHED if name in option_names(other)]
        holders += ["no --published"] if name in option_names(None) else []
        got = f"--published {shader}" if shader else "none"
        raise click.UsageError(
            f"{spelled(name)}: expected {' or '.join(holders)} with it, got {got}"
        )
    if "accumulate" in given and "frames" not in given:
        raise click.UsageError("--accumulate: expected --frames with it, got none")


def spelled(name: str) -> str:
    """The option of a name, as it is typed."""
    return SWITCHES.get(name, f"--{name.replace('_', '-')}")


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
