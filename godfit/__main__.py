"""The command line: ``python -m godfit`` or ``godfit``.

Nothing here imports JAX before a command runs, so that help and usage errors come at once.
"""

from __future__ import annotations

import threading
import time

STARTED = time.perf_counter()

import difflib  # noqa: E402
import json  # noqa: E402
import os  # noqa: E402
import shlex  # noqa: E402
import signal  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import TYPE_CHECKING, Any  # noqa: E402

import click  # noqa: E402

from godfit.errors import InputError  # noqa: E402

if TYPE_CHECKING:
    import numpy as np

    from godfit.models import Mitchell

NOT_CONVERGED = 3
INTERRUPTED = 130


class Progress:
    """Stages of the work on stderr: a spinner once a second has passed, on a terminal and unless
    asked to be quiet; with ``verbose`` a line for each, wherever stderr goes."""

    # Python drops an interrupt that comes while it runs a finaliser: the next stage asks once more.
    interrupted = False

    def __init__(self, quiet: bool, verbose: bool) -> None:
        from rich.console import Console

        self.console = Console(stderr=True)
        self.spins = not quiet and not verbose and self.console.is_terminal
        self.verbose = verbose and not quiet
        self.began = time.perf_counter()
        self.status: Any = None

    def __call__(self, stage: str) -> None:
        if Progress.interrupted:
            raise KeyboardInterrupt
        elapsed = time.perf_counter() - self.began
        if self.verbose:
            click.echo(f"godfit: {elapsed:6.2f} s  {stage}", err=True)
        elif self.spins and self.status is not None:
            self.status.update(stage)
        elif self.spins and elapsed > 1:
            self.status = self.console.status(stage)
            self.status.start()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self.status is not None:
            self.status.stop()


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="godfit")
def cli() -> None:
    """Read the parameters of god rays out of images."""


def assignments(values: tuple[str, ...], option: str, optional: bool) -> dict[str, Any]:
    """``NAME=VALUE`` (or, if ``optional``, ``NAME``) -> a dictionary."""
    found: dict[str, Any] = {}
    for text in values:
        name, sign, value = text.partition("=")
        if not sign and optional:
            found[name] = None
            continue
        try:
            found[name] = float(value)
        except ValueError:
            raise click.BadParameter(
                f"expected NAME=VALUE with a number, got '{text}'", param_hint=option
            ) from None
    return found


def look_away(ignore: tuple[str, ...], size: tuple[int, int]) -> np.ndarray | None:
    """(h, w), False inside the ``X,Y,W,H`` rectangles and where an image is not black."""
    if not ignore:
        return None
    import numpy as np

    from godfit.image import read_image

    valid = np.ones(size, bool)
    for text in ignore:
        numbers = text.split(",")
        if len(numbers) == 4 and all(n.strip().lstrip("-").isdigit() for n in numbers):
            x, y, w, h = (int(n) for n in numbers)
            if w <= 0 or h <= 0:
                raise InputError(f"--ignore: expected a width and height above 0, got '{text}'")
            valid[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)] = False
            continue
        if len(numbers) == 4 and not Path(text).exists():
            raise InputError(
                f"--ignore: expected X,Y,W,H in whole pixels or an image, got '{text}'"
            )
        image = np.atleast_3d(read_image(text).values)
        if image.shape[:2] != size:
            raise InputError(
                f"--ignore: expected the target's {size[1]}x{size[0]} pixels, got "
                f"{image.shape[1]}x{image.shape[0]} in '{text}'"
            )
        valid &= (image <= 0).all(-1)
    return valid


def folder_for(target: str, output: str | None) -> Path:
    """Where the result goes. Raises InputError now rather than after the work is done."""
    folder = Path(output) if output else Path(target).with_suffix(".godfit")
    near = folder
    while not near.exists() and near != near.parent:
        near = near.parent
    if not near.is_dir():
        raise InputError(
            f"output: expected a folder, got the file '{near}'; choose another with -o"
        )
    if not os.access(near, os.W_OK):
        raise InputError(f"output: '{near}' cannot be written; choose another folder with -o")
    return folder


SHADER_HELP = "Shader convention; see `godfit shaders`. [default: mitchell]"


def load_drawing() -> None:
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401


@cli.command()
@click.argument("target")
@click.option("--mask", help="Occlusion mask that the scattering pass reads.")
@click.option("--scene", help="Scene file to draw the mask from.")
@click.option("--free", multiple=True, metavar="NAME", help="Fit this of the scene as well.")
@click.option("--background", help="Ordinary pass that the light was laid on.")
@click.option("--shader", help=SHADER_HELP)
@click.option("--samples", type=int, help="Samples a ray. [default: the shader's own]")
@click.option("--lights", type=int, help="Number of lights. [default: 1]")
@click.option("--pass-scale", type=float, help="Size of the light pass against the mask's.")
@click.option("--transfer", type=click.Choice(["none", "srgb"]), help="How the target was encoded.")
@click.option("--fix", multiple=True, metavar="NAME[=VALUE]", help="Hold a parameter.")
@click.option("--start", multiple=True, metavar="NAME=VALUE", help="Start a parameter here.")
@click.option("--ignore", multiple=True, metavar="X,Y,W,H|IMAGE", help="Pixels to look away from.")
@click.option("-o", "--output", metavar="DIR", help="Result folder. [default: TARGET.godfit]")
@click.option(
    "--json", "as_json", is_flag=True, help="Print fit.json, and nothing else, to stdout."
)
@click.option("--seed", type=int, default=0, help="Seed of the choice of pixels.")
@click.option("-q", "--quiet", is_flag=True, help="No progress, no warnings.")
@click.option("-v", "--verbose", is_flag=True, help="A line for every stage.")
def fit(
    target: str,
    free: tuple[str, ...],
    fix: tuple[str, ...],
    start: tuple[str, ...],
    ignore: tuple[str, ...],
    output: str | None,
    as_json: bool,
    seed: int,
    quiet: bool,
    verbose: bool,
    **given: Any,
) -> int:
    """Fit exposure, decay, density, weight and the light's position to TARGET.

    A TARGET x.png with an x.toml beside it takes its mask or scene, shader and samples from there;
    options override it. The result goes to x.godfit/: fit.json, fit.png, render.png.

    With --scene the mask is drawn from meshes. --free light.position (or light.radius,
    camera.position, object[0].position, object[0].rotation, ...) fits that as well.
    """
    from godfit.cache import keep_compiled
    from godfit.image import read_image
    from godfit.sidecar import read_sidecar

    fixed = assignments(fix, "--fix", optional=True)
    started = assignments(start, "--start", optional=False)
    options = read_sidecar(target) | {k: v for k, v in given.items() if v is not None}
    folder = folder_for(target, output)
    # The target first: a missing one should not be reported as a missing mask.
    image = read_image(target, transfer=options.get("transfer", "none"))
    for one, other in (("mask", "scene"), ("scene", "mask")):
        if given[one] is not None and given[other] is None:
            # What is said here replaces what stands beside the target.
            options.pop(other, None)
    if "mask" in options and "scene" in options:
        raise click.UsageError("expected --mask or --scene, got both; a scene draws its own mask")
    if "mask" not in options and "scene" not in options:
        raise click.UsageError(
            "expected --mask IMAGE or --scene SCENE.toml, or "
            f"{Path(target).with_suffix('.toml').name} beside the target naming one; got neither"
        )
    if free and "scene" not in options:
        raise click.UsageError(f"--free {free[0]}: expected --scene SCENE.toml with it, got a mask")
    valid = look_away(ignore, image.values.shape[:2])
    with Progress(quiet, verbose) as progress:
        progress("loading JAX")
        keep_compiled()
        from godfit.fitting import fit as run
        from godfit.report import as_json as record
        from godfit.report import save
        from godfit.taps import convention

        imported = time.perf_counter() - STARTED
        scene = None
        if "scene" in options:
            from godfit.scene import read_scene

            progress("loading meshes")
            scene = options["scene"] = read_scene(options["scene"])
        said = options if scene is None else {**scene.settings, **options}
        if "shader" not in said and not quiet:
            warn("no shader given: 'mitchell' assumed; see `godfit shaders`")
        shader = convention(said.get("shader", "mitchell"))
        if "samples" not in said and "samples" not in shader.defaults and not quiet:
            warn(f"{shader.name} publishes no default: {shader.samples} samples assumed")
        # Loaded while compiled programs run, which need the interpreter little.
        threading.Thread(target=load_drawing, daemon=True).start()
        result = run(
            image, free=free, fix=fixed, start=started, valid=valid, seed=seed,
            progress=progress, **options,
        )  # fmt: skip
        result.timing_s["import"] = imported
        result.timing_s["total"] = time.perf_counter() - STARTED
        progress("drawing")
        command = shlex.join(["godfit", *sys.argv[1:]])
        save(result, folder, command)
    if not quiet:
        for note in [*result.notes, *result.undetermined]:
            warn(note)
    if as_json:
        click.echo(json.dumps(record(result, command), indent=1, ensure_ascii=False))
    else:
        click.echo(result.summary())
        click.echo(f"\n  {folder}{os.sep}: fit.json, fit.png, render.png")
    return 0 if result.converged else NOT_CONVERGED


@cli.command()
@click.argument("scene")
@click.option("-o", "--output", required=True, help="Image to write: .png or .npy (linear floats).")
@click.option(
    "--hard", is_flag=True, help="Pixel centres only, as WebGL draws without multisampling."
)
@click.option("-q", "--quiet", is_flag=True, help="No warnings.")
def mask(scene: str, output: str, hard: bool, quiet: bool) -> int:
    """Draw the occlusion mask of SCENE.toml, anti-aliased."""
    from godfit.image import write_image
    from godfit.inputs import drawn
    from godfit.scene import read_scene

    with Progress(quiet, False) as progress:
        progress("loading meshes")
        stage = read_scene(scene)
        progress("drawing")
        values = drawn(stage, not hard)
    write_image(output, values)
    if not quiet:
        for note in stage.notes:
            warn(note)
    return 0


@cli.command()
@click.argument("mask", metavar="MASK|SCENE.toml")
@click.option("-o", "--output", required=True, help="Image to write: .png or .npy (linear floats).")
@click.option("--params", metavar="FIT.JSON", help="Take shader and parameters from a fit.")
@click.option("--shader", help=SHADER_HELP)
@click.option("--samples", type=int, help="Samples a ray. [default: the shader's own]")
@click.option("--exposure", type=float)
@click.option("--decay", type=float)
@click.option("--density", type=float)
@click.option("--weight", type=float)
@click.option("--light", multiple=True, metavar="U,V", help="Light; repeat for several.")
@click.option("--background", help="Ordinary pass to lay the light on.")
@click.option("--size", metavar="WxH", help="Size of the image. [default: the mask's]")
@click.option("--pass-scale", type=float, default=1.0, help="Size of the light pass to the mask's.")
@click.option("--transfer", type=click.Choice(["none", "srgb"]), default="none")
@click.option(
    "--bits", type=click.Choice(["8", "16"]), default="8", help="Bits of a PNG's channel."
)
@click.option(
    "--tolerance",
    type=float,
    metavar="LEVELS",
    help="Largest error, in 8-bit levels, that a faster method may make. [default: exact]",
)
def render(
    mask: str,
    output: str,
    params: str | None,
    shader: str | None,
    samples: int | None,
    light: tuple[str, ...],
    background: str | None,
    size: str | None,
    pass_scale: float,
    transfer: str,
    bits: str,
    tolerance: float | None,
    **values: float | None,
) -> int:
    """Render the light of MASK, or of the scene SCENE.toml, with the given parameters or the
    shader's defaults."""
    from godfit.image import read_image, write_image
    from godfit.inputs import drawn, model_from, place_of, shrink_mask

    if tolerance is not None and not 0 <= tolerance < float("inf"):
        raise click.BadParameter(
            f"expected a number of levels, 0 or more, got {tolerance:g}", param_hint="--tolerance"
        )
    lights = [pair(text) for text in light]
    settings: dict[str, Any] = {}
    stage = None
    if mask.endswith(".toml"):
        from godfit.scene import read_scene

        stage = read_scene(mask)
        settings = {**stage.settings, **place_of(stage)}
        pass_scale = settings.pop("pass_scale", 1.0) if pass_scale == 1 else pass_scale
        transfer = settings.pop("transfer", "none") if transfer == "none" else transfer
    settings |= read_params(params) if params else {}
    settings |= {k: v for k, v in {"shader": shader, "samples": samples}.items() if v is not None}
    known = {k: v for k, v in values.items() if v is not None}
    shape = whole(size) if size else None
    back = None if background is None else read_image(background, transfer=transfer).values
    if stage is None:
        occlusion = read_image(mask).values
    else:
        occlusion = drawn(stage, stage.antialias is not False)
    model = model_from(settings, known, lights)
    low = shrink_mask(occlusion, pass_scale)
    shape = shape or (occlusion.shape[:2] if back is None else back.shape[:2])
    if back is not None and back.shape[:2] != shape:
        raise InputError(
            f"background: expected {shape[1]}x{shape[0]} pixels, got "
            f"{back.shape[1]}x{back.shape[0]}"
        )
    image = drawn_light(model, low, back, shape, tolerance or 0.0)
    write_image(output, image, transfer=transfer, bits=int(bits))
    return 0


def drawn_light(
    model: Mitchell,
    mask: np.ndarray,
    background: np.ndarray | None,
    size: tuple[int, int],
    tolerance: float,
) -> np.ndarray:
    """The model's image, (h, w) or (h, w, 3), its light pass off by ``tolerance`` levels at most.
    All lights are summed by one method, and their errors add up."""
    if not tolerance:
        from godfit.observation import render as draw

        return draw(model, mask, background, size)
    import equinox as eqx
    import jax.numpy as jnp
    import numpy as np

    from godfit.radial import cheapest

    low = jnp.asarray(mask)
    back = None if background is None else jnp.asarray(background)
    method = cheapest(low, model.light, model.taps[-1], tolerance)
    return np.clip(np.asarray(eqx.filter_jit(model)(low, back, size=size, method=method)), 0, 1)


def pair(text: str) -> tuple[float, float]:
    """``U,V`` -> two numbers."""
    try:
        u, v = (float(n) for n in text.split(","))
    except ValueError:
        raise click.BadParameter(f"expected U,V, got '{text}'", param_hint="--light") from None
    return u, v


def whole(text: str) -> tuple[int, int]:
    """``WxH`` -> (h, w)."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.isdigit() and int(p) > 0 for p in parts):
        raise click.BadParameter(f"expected WxH in pixels, got '{text}'", param_hint="--size")
    return int(parts[1]), int(parts[0])


def read_params(path: str) -> dict[str, Any]:
    """Shader, samples and parameters of a fit.json."""
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
        return {
            "shader": record["shader"],
            "samples": record["samples"],
            **{name: entry["value"] for name, entry in record["params"].items()},
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"'{path}': expected a fit.json, got {type(error).__name__}: {error}"
        ) from error


@cli.command()
def shaders() -> int:
    """List the shader conventions with their formulas and defaults."""
    from godfit.taps import CONVENTIONS

    click.echo("M mask at the pixel, M_i at x - i Delta, Delta = (x - l) rho / n; B background")
    for shader in CONVENTIONS.values():
        defaults = ", ".join(f"{k} {v:g}" for k, v in shader.defaults.items()) or "none published"
        click.echo(f"\n{shader.name}\n  {shader.formula}\n  defaults: {defaults}")
        if shader.remarks:
            click.echo(f"  {shader.remarks}")
    return 0


def warn(text: str) -> None:
    click.echo(f"godfit: warning: {text}", err=True)


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 1 bad input, 2 bad usage, 3 not converged,
    130 interrupted. Errors are one line on stderr."""
    try:
        return cli.main(arguments, prog_name="godfit", standalone_mode=False) or 0
    except click.UsageError as error:
        message, status = error.format_message(), 2
        if isinstance(error, click.NoSuchOption) and error.possibilities:
            near = difflib.get_close_matches(error.option_name, error.possibilities, 1)
            message = f"{error.option_name}: no such option; did you mean {(near or ['-h'])[0]}?"
    except click.ClickException as error:
        message, status = error.format_message(), 1
    except (click.Abort, KeyboardInterrupt):
        message, status = "interrupted; nothing was written", INTERRUPTED
    except InputError as error:
        message, status = str(error), 1
    except MemoryError:
        message, status = "out of memory; give a smaller target or free some", 1
    except OSError as error:
        where = f"'{error.filename}': " if error.filename else ""
        message, status = f"{where}{error.strerror or error}; nothing was written", 1
    print(f"godfit: error: {' '.join(message.split())}", file=sys.stderr)
    return status


def _interrupt(number: int, frame: Any) -> None:
    Progress.interrupted = True
    signal.default_int_handler(number, frame)


def run() -> None:
    """The ``godfit`` command."""
    signal.signal(signal.SIGINT, _interrupt)
    # Where an interrupt falls into a finaliser, Python prints it and goes on; the next stage stops.
    sys.unraisablehook = lambda lost: (
        None if isinstance(lost.exc_value, KeyboardInterrupt) else sys.__unraisablehook__(lost)
    )
    status = main()
    sys.stdout.flush()
    sys.stderr.flush()
    # An orderly end takes a third of a second, and would pull the memory from under compiled
    # programs that an interrupt has left running.
    os._exit(status)


if __name__ == "__main__":
    run()
