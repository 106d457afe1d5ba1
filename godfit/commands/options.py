"""Options that several commands share, and how their texts are parsed."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click

from godfit.errors import InputError
from godfit.io.ignored import is_whole

MAX_SEED = 2**31 - 1
"""Largest seed: JAX takes seeds of 32 bits with a sign."""


def combined(*options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Several decorators as one, in the order of the help."""

    def decorate(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


class Command(click.Command):
    """A command none of whose arguments and options may be an empty text."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        rest = super().parse_args(ctx, args)
        for parameter in self.get_params(ctx):
            value = ctx.params.get(parameter.name or "")
            if "" in (value if isinstance(value, tuple) else (value,)):
                name = parameter.opts[-1] if parameter.opts[-1].startswith("-") else "argument"
                raise click.UsageError(f"{name}: expected a value, got an empty text")
        return rest


def _checked_curve(
    context: click.Context, option: click.Parameter, transfer: str | None
) -> str | None:
    """The name of a transfer, checked before the work begins."""
    from godfit.io.transfer import checked_transfer

    if transfer is not None and transfer not in ("none", "srgb"):
        try:
            checked_transfer(transfer)
        except InputError as error:
            raise click.BadParameter(str(error)) from None
    return transfer


def _limit_pixels(context: click.Context, option: click.Parameter, count: int | None) -> None:
    from godfit.io.image import MAX_PIXELS, limit_pixels

    limit_pixels(count or MAX_PIXELS)


LIMIT = click.option(
    "--max-pixels",
    type=click.IntRange(1, 2**40),
    callback=_limit_pixels,
    expose_value=False,
    help="Refuse larger images. [default: 134217728]",
)
SHADER = combined(
    click.option(
        "--shader",
        help="Convention, see `godfit shaders`, a FILE.toml of your own, or auto, the one that "
        "explains the picture best. [default: auto with a mask or scene, else mitchell]",
    ),
    click.option("--samples", type=int, help="Samples a ray. [default: the shader's own]"),
)
BRIGHT_PASS = click.option(
    "--bright-pass",
    is_flag=True,
    default=None,
    help="Without a mask: the light is all that is bright in the picture, as in a photograph.",
)
PICTURE_OPTIONS = combined(
    click.option("--mask", help="Occlusion mask that the scattering pass reads."),
    click.option("--scene", help="Scene file: mask, camera, distances and light."),
    click.option("--canvas", help="Flatland: the canvas, an RGBA image or a .toml of shapes."),
    click.option("--background", help="Ordinary pass that the light pass was blended with."),
    SHADER,
    click.option("--rays", type=int, help="Flatland: rays a pixel. [default: 64]"),
    click.option(
        "--pass-scale",
        type=float,
        help="Size of the light pass relative to the mask, at most 1. [default: 1; dawntime, "
        "vesper: 1 or .5]",
    ),
    click.option(
        "--transfer",
        metavar="NAME|FILE",
        callback=_checked_curve,
        help="Encoding of the target: none, srgb, reinhard, aces, aces-hill, filmic, a .cube or "
        "sampled curve, or several with + between them. [default: none]",
    ),
    click.option(
        "--arithmetic",
        type=click.Choice(["gpu", "exact"]),
        help="How the target was computed. [default: gpu for bytes that godfit has not rendered]",
    ),
    click.option("--fov", type=float, help="Vertical field of view in degrees, without a scene."),
    click.option(
        "--distance", type=float, help="Distance of visible surfaces; with a scene, of the sky."
    ),
    click.option(
        "--ignore",
        multiple=True,
        metavar="X,Y,W,H|IMAGE",
        help="Pixels to leave out: a rectangle, or wherever an image is not black.",
    ),
)
PICTURE = combined(LIMIT, PICTURE_OPTIONS)


class Run(NamedTuple):
    """How a command runs and where its result goes: the folder (None for the default one), whether
    stdout gets JSON, the seed of the choice of pixels, what is printed on stderr, and whether the
    folder gets a page."""

    output: str | None = None
    as_json: bool = False
    seed: int = 0
    quiet: bool = False
    verbose: bool = False
    html: bool = True


def with_run(*options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Options whose values reach the command together, as its argument ``run``."""

    def decorate(command: Any) -> Any:
        @functools.wraps(command)
        def collected(**values: Any) -> Any:
            given = {name: values.pop(name) for name in Run._fields if name in values}
            return command(run=Run(**given), **values)

        return combined(*options)(collected)

    return decorate


JSON = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON to stdout, and nothing else."
)
QUIET = click.option("-q", "--quiet", is_flag=True, help="Print no progress and no warnings.")
VERBOSE = click.option("-v", "--verbose", is_flag=True, help="Print a line for every stage.")
RESULT = with_run(
    click.option("-o", "--output", metavar="DIR", help="Result folder. [default: TARGET.godfit]"),
    JSON,
    click.option(
        "--seed",
        type=click.IntRange(0, MAX_SEED),
        default=0,
        help="Seed of the random choice of pixels.",
    ),
    QUIET,
    VERBOSE,
    click.option(
        "--html/--no-html", default=True, help="Write report.html into the folder. [default: yes]"
    ),
)


def assignments(
    context: click.Context, option: click.Parameter, values: tuple[str, ...]
) -> dict[str, float | None]:
    """``NAME=VALUE`` texts as a dictionary; for ``--fix`` a ``NAME`` alone is held at its start."""
    found: dict[str, float | None] = {}
    for text in values:
        name, sign, value = text.partition("=")
        if not sign and option.name == "fix":
            found[name] = None
            continue
        try:
            found[name] = float(value)
        except ValueError:
            raise click.BadParameter(f"expected NAME=VALUE with a number, got '{text}'") from None
    return found


def measurements(
    context: click.Context, option: click.Parameter, values: tuple[str, ...]
) -> dict[str, tuple[float, float]]:
    """``NAME=VALUE+-SIGMA`` texts as a dictionary of pairs."""
    found: dict[str, tuple[float, float]] = {}
    for text in values:
        name, _, numbers = text.partition("=")
        value, _, sigma = numbers.partition("+-")
        try:
            found[name] = float(value), float(sigma)
        except ValueError:
            raise click.BadParameter(
                f"expected NAME=VALUE+-SIGMA with two numbers, got '{text}'"
            ) from None
    return found


def colour(text: str | None, option: str) -> tuple[float, ...] | None:
    """``R,G,B`` as three numbers; None stays None."""
    return None if text is None else numbers(text, "R,G,B", option)


def numbers(text: str, form: str, option: str) -> tuple[float, ...]:
    """Numbers with commas between them, as many as ``form`` has names."""
    try:
        found = tuple(float(number) for number in text.split(","))
    except ValueError:
        found = ()
    if len(found) != len(form.split(",")):
        raise click.BadParameter(f"expected {form}, got '{text}'", param_hint=option)
    return found


def image_size(text: str) -> tuple[int, int]:
    """``WxH`` as (h, w) in pixels."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(is_whole(p) and int(p) > 0 for p in parts):
        raise click.BadParameter(f"expected WxH in pixels, got '{text}'", param_hint="--size")
    return int(parts[1]), int(parts[0])


def check_image_name(name: str) -> None:
    """Raise InputError, before the work, for a name under which no image can be written."""
    path = Path(name)
    if path.suffix.lower() not in (".png", ".npy"):
        raise InputError(
            f"{name!r}: expected a name in .png or .npy, got {path.suffix!r}; rename it"
        )
    if path.is_dir() or not path.parent.is_dir():
        got = "a folder" if path.is_dir() else f"no folder '{path.parent}'"
        raise InputError(f"output: expected a file in a folder that exists, got {got}: '{name}'")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"output: '{path.parent}' cannot be written; choose another with -o")
