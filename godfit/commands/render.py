"""``godfit render``: a picture from parameters."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from godfit.commands.options import SHADER, colour, image_size, light_position
from godfit.errors import InputError

if TYPE_CHECKING:
    import numpy as np

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
PARAMETER_OPTIONS = ("exposure", "decay", "density", "weight", "e_sun", "scale", "turbidity", "g")
"""Options that are parameters of a model."""


class RenderCommand(click.Command):
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
@click.option("-o", "--output", required=True, help="Image to write: .png or .npy (linear floats).")
@click.option("--model", help="mitchell, hoffman-preetham, volume or flatland. [default: mitchell]")
@click.option("--params", metavar="FIT.JSON", help="Take shader and parameters from a fit.")
@SHADER
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
@click.option("--seed", type=int, help="Flatland: seed of jitter and film grain. [default: 0]")
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
@click.option(
    "--light", multiple=True, metavar="U,V", help="Position of a light; repeat for several."
)
@click.option("--background", help="Ordinary pass to blend the light pass with.")
@click.option("--size", metavar="WxH", help="Size of the image. [default: the mask's]")
@click.option(
    "--pass-scale",
    type=float,
    default=1.0,
    help="Size of the light pass relative to the mask, at most 1.",
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
def render(mask: str, output: str, transfer: str, bits: str, **options: Any) -> int:
    """Render a mask or a scene with given parameters.

    Parameters that are not given are the shader's defaults. --model hoffman-preetham takes a mask
    that is 1 where the sky is visible; --model volume marches through the air of a SCENE.toml. Both
    need --e-sun and --scale. --model flatland takes a canvas, an RGBA image or a .toml of shapes.
    Its colour is emitted light and its alpha is opacity, so that black and opaque throws shadows.
    """
    from godfit.io.image import write_image
    from godfit.report.record import read_params

    tolerance = options["tolerance"]
    if tolerance is not None and not 0 <= tolerance < float("inf"):
        raise click.BadParameter(
            f"expected a number of levels, 0 or more, got {tolerance:g}", param_hint="--tolerance"
        )
    options["light"] = [light_position(text) for text in options["light"]]
    for name in ("sun", "sky"):
        options[name] = colour(options[name], f"--{name}")
    # A flag that is not set was not given.
    options["jitter"] = options["jitter"] or None
    recorded = read_params(options["params"]) if options["params"] else {}
    if (options["model"] or recorded.get("model")) == "flatland":
        from godfit.flatland.file_rendering import render_file

        given = given_options(options, (*FLATLAND_OPTIONS, "steps", "exposure"))
        check_plane_options(given)
        image = render_file(mask, recorded | given)
    else:
        for name in given_options(options, FLATLAND_OPTIONS):
            raise click.UsageError(f"{spelled(name)}: expected --model flatland with it")
        image, transfer = on_screen(mask, recorded, transfer, options)
    write_image(output, image, transfer=transfer, bits=int(bits))
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
    pass_scale = options["pass_scale"]
    if mask.lower().endswith((".toml", *MESH_SUFFIXES)):
        from godfit.scenes.scene import read_scene
        from godfit.scenes.view import light_on_screen, resized

        scene = read_scene(mask)
        if scene.any_size and options["size"]:
            scene = resized(scene, image_size(options["size"]))
        settings = {**scene.settings, **light_on_screen(scene)}
        pass_scale = settings.pop("pass_scale", 1.0) if pass_scale == 1 else pass_scale
        transfer = settings.pop("transfer", "none") if transfer == "none" else transfer
    settings |= recorded
    lights, kind = options["light"], options["model"] or settings.get("model", "mitchell")
    if kind != "volume":
        count = 1 if kind == "mitchell" else max(len(lights), 1)
        check_model(kind, (), options["shader"], count, options["fov"], options["distance"])
    settings |= given_options(options, ("shader", "samples"))
    background = None
    if options["background"] is not None:
        background = read_image(options["background"], transfer=transfer).values
    draw = mitchell if kind == "mitchell" else daylight
    picture = Picture(mask, scene, background, settings, lights, pass_scale)
    return draw(picture, options), transfer


class Picture(NamedTuple):
    """The inputs of a rendering: the file of the mask or the scene, the ``scene`` if it is one, the
    ordinary pass, settings, and lights (u, v)."""

    mask: str
    scene: Scene | None
    background: np.ndarray | None
    settings: dict[str, Any]
    lights: list[tuple[float, float]]
    pass_scale: float

    def check_background(self, size: tuple[int, ...]) -> None:
        """Raise InputError where the ordinary pass is not as large as the picture."""
        back = self.background
        if back is not None and back.shape[:2] != tuple(size):
            raise InputError(
                f"background: expected {size[1]}x{size[0]} pixels, got "
                f"{back.shape[1]}x{back.shape[0]}"
            )


def mitchell(picture: Picture, options: dict[str, Any]) -> np.ndarray:
    """(h, w) or (h, w, 3) Mitchell's sum, whose light pass has an error of at most ``tolerance``
    levels. All lights are summed by one method, and their errors add up."""
    import equinox as eqx
    import numpy as np

    from godfit.inference.observation import render
    from godfit.io.image import read_image
    from godfit.io.sources import shrink_mask
    from godfit.models.build import mitchell_at
    from godfit.runtime.device import on_device
    from godfit.scattering.radial import cheapest
    from godfit.scenes.view import drawn_mask

    scene, background = picture.scene, picture.background
    model = mitchell_at(picture.settings, given_options(options, PARAMETER_OPTIONS), picture.lights)
    if scene is None:
        occlusion = read_image(picture.mask).values
    else:
        occlusion = drawn_mask(scene, scene.antialias is not False)
    size = (occlusion if background is None else background).shape[:2]
    if options["size"]:
        size = image_size(options["size"])
    picture.check_background(size)
    occlusion = shrink_mask(occlusion, picture.pass_scale)
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
    if scene is not None:
        # A fit records one typical distance; the scene has them all.
        settings.pop("distance", None)
    settings |= given_options(options, ("fov", "distance", "phase"))
    model = daylight_at(settings, given_options(options, PARAMETER_OPTIONS), picture.lights, scene)
    if (options["model"] or settings.get("model")) == "volume":
        if scene is None:
            raise InputError("volume: expected a SCENE.toml, got an image; it has no depth")
        picture.check_background(scene.size)
        image = volume.render(
            scene, model.air, np.asarray(model.view.distance), source=options["source"],
            steps=options["steps"] or 128, background=picture.background,
        )  # fmt: skip
        return np.clip(image, 0, 1)
    sky = read_image(picture.mask).values if scene is None else drawn_mask(as_sky_mask(scene), True)
    picture.check_background(sky.shape[:2])
    return render(model, sky, picture.background, (sky.shape[0], sky.shape[1]))


def given_options(options: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """The options among ``names`` that were given, by name."""
    return {name: options[name] for name in names if options[name] is not None}
