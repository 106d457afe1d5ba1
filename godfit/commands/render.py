"""``godfit render``: a picture from parameters."""

from __future__ import annotations

import itertools
from typing import Any

import click

from godfit.commands.lights import with_light
from godfit.commands.options import (
    LIMIT,
    MAX_SEED,
    SHADER,
    Command,
    check_image_name,
    colour,
    image_size,
)
from godfit.commands.screen_rendering import check_page, given_options, on_screen
from godfit.commands.study import start_jax

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
