"""``godfit render``: a picture from parameters."""

from __future__ import annotations

from typing import Any

import click

from godfit.commands.options import SHADER, pair, three, whole


@click.command()
@click.argument("mask", metavar="MASK|SCENE.toml")
@click.option("-o", "--output", required=True, help="Image to write: .png or .npy (linear floats).")
@click.option("--model", help="mitchell, hoffman-preetham, volume or flatland. [default: mitchell]")
@click.option("--params", metavar="FIT.JSON", help="Take shader and parameters from a fit.")
@SHADER
@click.option("--exposure", type=float)
@click.option("--decay", type=float)
@click.option("--density", type=float)
@click.option("--weight", type=float)
@click.option("--e-sun", type=float, help="The sun's irradiance, or a lamp's intensity.")
@click.option("--scale", type=float, help="Metres of air that a unit of distance stands for.")
@click.option("--turbidity", type=float, help="Haze: 2 clear, 6 hazy. [default: 2]")
@click.option("--g", type=float, help="Mean cosine of the haze's scattering. [default: .76]")
@click.option("--phase", help="normalised or published. [default: normalised]")
@click.option("--fov", type=float, help="Vertical field of view in degrees, without a scene.")
@click.option("--distance", type=float, help="How far what is seen lies; with a scene, the sky.")
@click.option("--source", default="sun", help="Of a volume: sun or lamp. [default: sun]")
@click.option("--steps", type=int, help="Of a volume's rays, or of a march. [default: 128]")
@click.option("--rays", type=int, help="Flatland: rays of a pixel. [default: 64]")
@click.option("--method", help="Flatland: distance, march or cascades. [default: distance]")
@click.option("--sun-angle", type=float, help="Flatland: degrees from the right. [default: 120]")
@click.option("--sun-width", type=float, help="Flatland: degrees to either side. [default: 60]")
@click.option("--sun", metavar="R,G,B", help="Flatland: the sun's radiance. [default: .95,.95,.9]")
@click.option("--sky", metavar="R,G,B", help="Flatland: the sky's radiance. [default: .02,.08,.2]")
@click.option("--jitter", is_flag=True, help="Flatland: every pixel turns its rays; see --seed.")
@click.option("--grain", type=float, help="Flatland: standard deviation of noise laid on.")
@click.option("--seed", type=int, help="Flatland: of jitter and grain. [default: 0]")
@click.option("--published", is_flag=True, help="Flatland: as the article's shaders have it.")
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
    model: str | None,
    params: str | None,
    shader: str | None,
    samples: int | None,
    phase: str | None,
    fov: float | None,
    distance: float | None,
    source: str,
    steps: int | None,
    rays: int | None,
    method: str | None,
    sun: str | None,
    sky: str | None,
    jitter: bool,
    grain: float | None,
    seed: int | None,
    published: bool,
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
    shader's defaults.

    --model hoffman-preetham takes a mask that is 1 where the sky is seen; --model volume marches
    through the air of a SCENE.toml. Both need --e-sun and --scale. --model flatland takes a canvas:
    RGBA (colour emits, alpha hides, black and opaque throws shadows) or a .toml of shapes.
    """
    from godfit.commands import rendering
    from godfit.io.image import read_image, write_image
    from godfit.report.record import read_params
    from godfit.request import (
        check_model,
        daylight_from,
        drawn,
        model_from,
        open_sky,
        place_of,
        shrink_mask,
    )

    if tolerance is not None and not 0 <= tolerance < float("inf"):
        raise click.BadParameter(
            f"expected a number of levels, 0 or more, got {tolerance:g}", param_hint="--tolerance"
        )
    lights = [pair(text) for text in light]
    before = read_params(params) if params else {}
    in_plane = {
        "rays": rays, "method": method, "jitter": jitter or None, "grain": grain, "seed": seed,
        "published": published or None, "sun": three(sun, "--sun"), "sky": three(sky, "--sky"),
        "sun_angle": values.pop("sun_angle"), "sun_width": values.pop("sun_width"),
    }  # fmt: skip
    if (model or before.get("model")) == "flatland":
        from godfit.flatland.inputs import rendered

        in_plane |= {"steps": steps, "exposure": values["exposure"]}
        image = rendered(mask, before | given(in_plane))
        write_image(output, image, transfer=transfer, bits=int(bits))
        return 0
    for name in given(in_plane):
        raise click.UsageError(f"--{name.replace('_', '-')}: expected --model flatland with it")
    stage, settings = None, {}
    if mask.endswith(".toml"):
        from godfit.scenes.scene import read_scene

        stage = read_scene(mask)
        settings = {**stage.settings, **place_of(stage)}
        pass_scale = settings.pop("pass_scale", 1.0) if pass_scale == 1 else pass_scale
        transfer = settings.pop("transfer", "none") if transfer == "none" else transfer
    settings |= before
    kind = model or settings.get("model", "mitchell")
    if kind != "volume":
        check_model(
            kind, (), shader, 1 if kind == "mitchell" else max(len(lights), 1), fov, distance
        )
    settings |= given({"shader": shader, "samples": samples})
    known = given(values)
    back = None if background is None else read_image(background, transfer=transfer).values
    if kind != "mitchell":
        if stage is not None:
            # That of a fit is a typical one; the scene has them all.
            settings.pop("distance", None)
        settings |= given({"fov": fov, "distance": distance, "phase": phase})
        lit = daylight_from(settings, known, lights, stage)
        if kind == "volume":
            image = rendering.volume(lit, stage, back, source, steps or 128)
        elif stage is None:
            image = rendering.daylight(lit, read_image(mask).values, back)
        else:
            image = rendering.daylight(lit, drawn(open_sky(stage), True), back)
    else:
        lit = model_from(settings, known, lights)
        if stage is None:
            occlusion = read_image(mask).values
        else:
            occlusion = drawn(stage, stage.antialias is not False)
        shape = whole(size) if size else (occlusion if back is None else back).shape[:2]
        low = shrink_mask(occlusion, pass_scale)
        image = rendering.mitchell(lit, low, back, shape, tolerance or 0.0)
    write_image(output, image, transfer=transfer, bits=int(bits))
    return 0


def given(values: dict[str, Any]) -> dict[str, Any]:
    """Those that were given."""
    return {name: value for name, value in values.items() if value is not None}
