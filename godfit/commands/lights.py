"""The options of a light's position: ``--light``, ``--light-px`` and ``--light-origin``."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import click

from godfit.commands.options import combined, numbers

LIGHT_ORIGINS = ("bottom", "top")
"""Edges of the picture that v is counted from: that of GLSL and that of HLSL."""


class Lights(NamedTuple):
    """Positions of lights as they were given: ``places`` (x, y), in pixels where ``option`` is
    "light_px", else in texture coordinates whose v is counted from the edge ``origin``."""

    option: str = "light"
    places: tuple[tuple[float, float], ...] = ()
    origin: str = "bottom"

    def uv(self, size: tuple[int, ...]) -> list[tuple[float, float]]:
        """The positions (u, v), v up, in a picture of ``size`` (h, w)."""
        if self.option == "light_px":
            # Pixel i covers i to i + 1. So does the result of Irrlicht's
            # getScreenCoordinatesFrom3DPosition, which rounds u times the width.
            return [(x / size[1], 1 - y / size[0]) for x, y in self.places]
        return [(u, 1 - v if self.origin == "top" else v) for u, v in self.places]

    def one(self, size: tuple[int, ...]) -> tuple[float, float] | None:
        """The position (u, v) of the only light; None where none was given."""
        if len(self.places) > 1:
            raise click.UsageError(f"{self.flag}: expected one light, got {len(self.places)}")
        return self.uv(size)[0] if self.places else None

    def starts(self, size: tuple[int, ...]) -> dict[str, float]:
        """The parameters of the lights, by name, at their positions."""
        found = {}
        for i, (u, v) in enumerate(self.uv(size)):
            stem = "light" if i == 0 else f"light{i + 1}"
            found |= {f"{stem}_x": u, f"{stem}_y": v}
        return found

    @property
    def flag(self) -> str:
        """The option as the user types it."""
        return "--" + self.option.replace("_", "-")


def with_light(meaning: str) -> Callable[[Any], Any]:
    """The three options, which reach the command as its argument ``light``, a ``Lights``.
    ``meaning`` is the help of ``--light``."""

    def decorate(command: Any) -> Any:
        @functools.wraps(command)
        def collected(
            light: tuple[str, ...], light_px: tuple[str, ...], light_origin: str | None, **rest: Any
        ) -> Any:
            return command(light=lights_given(light, light_px, light_origin), **rest)

        return combined(
            click.option("--light", multiple=True, metavar="U,V", help=meaning),
            click.option(
                "--light-px",
                multiple=True,
                metavar="X,Y",
                help="The same in pixels, from the left and the top; a pixel has its centre at .5.",
            ),
            click.option(
                "--light-origin",
                type=click.Choice(LIGHT_ORIGINS),
                help="Edge that V of --light is counted from; HLSL has top. [default: bottom]",
            ),
        )(collected)

    return decorate


def lights_given(uv: tuple[str, ...], px: tuple[str, ...], origin: str | None) -> Lights:
    """The lights of the three options' texts. Raises UsageError for options that exclude each
    other and for texts that are not two finite numbers."""
    if uv and px:
        raise click.UsageError("expected --light or --light-px, got both; give one")
    if origin is not None and not uv:
        raise click.UsageError("--light-origin: expected --light U,V with it, got none")
    option, texts, form = ("light_px", px, "X,Y") if px else ("light", uv, "U,V")
    lights = Lights(option, (), origin or "bottom")
    return lights._replace(places=tuple(_place(text, form, lights.flag) for text in texts))


def _place(text: str, form: str, flag: str) -> tuple[float, float]:
    """The two numbers of a text of the ``form`` X,Y. Raises BadParameter where they are not finite,
    in the name of the option ``flag``."""
    x, y = numbers(text, form, flag)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise click.BadParameter(
            f"expected two finite numbers {form}, got '{text}'", param_hint=flag
        )
    return x, y


def near(
    context: click.Context, option: click.Parameter, text: str | None
) -> tuple[float, float] | None:
    """The text of ``--light-near`` as (u, v); None stays None."""
    return None if text is None else _place(text, "U,V", "--light-near")
