"""Draws the synthetic targets: masks by formula, true parameters, and the pictures they make.

    python data_synthetic/make.py [FOLDER]
    python data_synthetic/make.py --gif FILE flight

Masks of targets are painted by formula (painted_masks.py), those of scenes (stages.py) are the
rasteriser's. Canvases of the light in the plane (canvases.py) are drawn by formula or by falling
sand. Screenshots (screens.py) come without a mask and are rendered as users' are. With
--gif a moving scene becomes an animation.

A mask is rounded to bytes before anything is rendered from it, so that the parameters in the table
below are exactly the picture's. Pictures but those of screenshots are rendered by the reference sum
in float64 and rounded once. The command line takes a target's settings from the side file
``x.toml`` beside ``x.png``; manifest.json holds the truth.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import canvases
import equinox as eqx
import imagecodecs
import imageio.v3
import jax
import jax.numpy as jnp
import numpy as np
import painted_masks as masks
import screens
from stages import SEQUENCE_FRAMES, SEQUENCES, STAGES, Stage, mitchell_params

from godfit.flatland import Sky, from_rgba, render
from godfit.flatland.sand import grain_counts
from godfit.io.image import write_image
from godfit.models.mitchell import Mitchell
from godfit.runtime.files import atomic_write
from godfit.scattering.parameters import light_parameters
from godfit.scattering.radial.reference import bilinear
from godfit.scenes.scene import Scene, read_scene
from godfit.scenes.view import drawn_mask, light_on_screen

ANIMATIONS = (*SEQUENCES, "sand")
"""Moving scenes that --gif can write."""

PLANE_RAYS = 128
"""Rays of a pixel of the light in the plane: twice a fit's default."""

GIF_LAP_MS = 4000
"""Milliseconds that one lap of a moving scene takes in its animation."""

SAND_GIF_FRAME_MS = 80
"""Milliseconds of a frame of the falling sand."""

SAND_GIF_FRAME_STEPS = 4
"""Frames of the sand between two frames of its animation."""

SAND_SCALE = 2
"""Pixels a cell of the sand, in its canvases."""

EXACT_LINE = 'arithmetic = "exact"'
"""Line of a side file: nothing but rounding is between a picture and the model."""

Painter = Callable[[int, int], np.ndarray]
"""(height, width) -> the picture."""


class Target(NamedTuple):
    """A target whose mask is painted by formula: its mask, its picture's ``size`` (height, width),
    the settings and parameters of its light pass, its ``lights`` (u, v), and its purpose, ``note``.

    ``mask_size`` is the mask's, if it is smaller; ``background`` paints the ordinary pass.
    """

    mask: Painter
    size: tuple[int, int]
    shader: str
    samples: int
    params: dict[str, float]
    lights: list[tuple[float, float]]
    note: str
    mask_size: tuple[int, int] | None = None
    background: Painter | None = None


TARGETS = {
    "disc": Target(
        masks.disc, (256, 256), "dawntime", 100, mitchell_params(0.08, 0.97, 0.9, 0.6),
        [(0.56, 0.6)], "The first example: one light, one channel, every parameter determined.",
    ),
    "bars": Target(
        masks.bars, (200, 320), "mitchell", 100, mitchell_params(0.09, 0.965, 0.85, 0.6),
        [(0.425, 0.52)],
        "A wide frame and thin bars, nearly along the rays above and below the light.",
    ),
    "window": Target(
        masks.window, (256, 256), "vesper", 150, mitchell_params(0.03, 0.985, 0.75, 0.7),
        [(0.46, 0.6)], "A regular grid: shifted copies of it look alike.",
    ),
    "trees": Target(
        masks.trees, (256, 320), "article-glsl", 100,
        mitchell_params(0.2, 0.96815, 0.926, 0.58767), [(0.58, 0.7)],
        "Fine leaves and trunks, at the article's own settings.",
    ),
    # three has no decay, density or weight, so none is listed as its truth.
    "ring": Target(
        masks.ring, (256, 256), "three", 18, {"exposure": 0.95}, [(0.6, 0.68)],
        "Three box passes at fixed steps: exposure and the light are all there is.",
    ),
    "two_lights": Target(
        masks.two_lights, (192, 288), "mitchell", 80, mitchell_params(0.06, 0.97, 0.9, 0.6),
        [(0.24, 0.6), (0.8, 0.45)], "Two lights share the other parameters.",
    ),
    "offscreen": Target(
        masks.skyline, (256, 256), "mitchell", 100, mitchell_params(0.045, 0.98, 0.85, 0.6),
        [(-0.12, 1.2)], "The light is outside the frame: only the rays tell where.",
    ),
    "halfres": Target(
        masks.fan, (256, 256), "dawntime", 200, mitchell_params(0.05, 0.985, 0.8, 0.8),
        [(0.54, 0.56)],
        "The light pass is rendered at half size, stored in 8 bits, and read bilinearly.",
        mask_size=(128, 128),
    ),
    "background": Target(
        masks.peaks, (256, 256), "babylon", 100, mitchell_params(0.16, 0.975, 0.926, 0.58767),
        [(0.55, 0.56)], "A composite: 1.1 times a coloured picture, and the light pass.",
        background=masks.dusk,
    ),
    "clipped": Target(
        masks.rose, (256, 256), "vesper", 120, mitchell_params(0.0535, 0.975, 0.85, 0.8),
        [(0.5, 0.5)], "A tenth of the pixels is clipped at 255.",
    ),
    "coloured": Target(
        masks.glass, (240, 240), "dawntime", 120, mitchell_params(0.08, 0.975, 0.85, 0.6),
        [(0.56, 0.57)], "Three different channels under one set of parameters.",
    ),
    "decay_one": Target(
        masks.barn, (256, 256), "mitchell", 100, mitchell_params(0.12, 1.0, 1.0, 0.1),
        [(0.44, 0.58)], "Decay and density are exactly 1, on their bounds.",
    ),
    "pmndrs": Target(
        masks.asteroids, (216, 384), "pmndrs", 60, mitchell_params(0.6, 0.96, 0.96, 0.09),
        [(0.58, 0.58)], "No tap at the pixel itself: only exposure*weight matters.",
    ),
}  # fmt: skip
"""Targets with a painted mask, by name."""

SCREENSHOTS = {
    "screen_flat": ("flat", 12, None),
    "screen_smooth": ("smooth", 12, None),
    "screen_textured": ("textured", 4, None),
    "screen_jpeg": ("flat", 1, 90),
}
"""By name: the background, the seed, and the quality of a JPEG, None for a PNG."""


def to_bytes(values) -> np.ndarray:
    """Values as an 8-bit file stores them: clamped, rounded half up, still from 0 to 1."""
    return np.floor(np.clip(np.asarray(values), 0, 1) * 255 + 0.5) / 255


def enlarge(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """An image (h, w), interpolated bilinearly at the pixel centres of a picture of ``size``."""
    y, x = ((np.arange(n) + 0.5) * m / n - 0.5 for n, m in zip(size, image.shape, strict=True))
    return np.asarray(bilinear(jnp.asarray(image), *map(jnp.asarray, np.meshgrid(x, y))))


def rendered(model: Mitchell, mask: np.ndarray, background=None) -> np.ndarray:
    """The picture by the reference sum, in float64."""
    # One compiled program: op by op takes twice as long.
    image = np.asarray(eqx.filter_jit(model)(jnp.asarray(mask), background, method="reference"))
    if image.dtype != np.float64:
        raise RuntimeError("jax: expected 64-bit floats; set jax_enable_x64")
    return image


def all_stages() -> Iterator[tuple[str, Stage, dict[str, float]]]:
    """Every scene: its name, the scene, and, if it moves, the update."""
    for name, stage in STAGES.items():
        yield f"stage_{name}", stage(), {}
    for name, sequence in SEQUENCES.items():
        for i in range(SEQUENCE_FRAMES):
            update = sequence.first + i * sequence.step
            yield f"{name}_{i}", sequence.stage(update), {"update": update}


def render_stage(path: Path, stage: Stage) -> tuple[Scene, np.ndarray, np.ndarray]:
    """Write the scene file; the scene that it holds, its mask and its picture."""
    atomic_write(path, stage.text().encode())
    scene = read_scene(path)
    mask = to_bytes(drawn_mask(scene, stage.antialias).astype(np.float64))
    light = [tuple(light_on_screen(scene).values())]
    model = Mitchell(**stage.params, light=light, shader=stage.shader, samples=stage.samples)
    return scene, mask, rendered(model, mask)


def make_stage(folder: Path, name: str, stage: Stage) -> dict:
    """Write the scene ``name``, its mask, target and side file; its truth."""
    files = {"target": f"{name}.png", "mask": f"{name}_mask.png", "scene": f"{name}.scene.toml"}
    scene, mask, image = render_stage(folder / files["scene"], stage)
    write_image(folder / files["mask"], mask)
    write_image(folder / files["target"], image)
    settings = {"shader": stage.shader, "samples": stage.samples}
    side_file = f'scene = "{files["scene"]}"\n\n[scattering]\nshader = "{stage.shader}"\n'
    side_file += f"samples = {stage.samples}\n{EXACT_LINE}\n"
    atomic_write(folder / f"{name}.toml", side_file.encode())
    light = {key: round(value, 9) for key, value in light_on_screen(scene).items()}
    names = ("camera.position", "light.position", "light.radius", *stage.known)
    known = {key: np.asarray(scene.value(key)).tolist() for key in names}
    return files | settings | {"params": stage.params | light, "known": known, "note": stage.note}


def make_gif(file: Path, name: str, frames: int = 48) -> None:
    """Write one lap of the moving scene ``name`` as an animation, twice its size; needs x64."""
    sequence = SEQUENCES[name]
    pictures = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(frames):
            stage = sequence.stage(sequence.lap * i / frames)
            *_, image = render_stage(Path(folder) / "scene.toml", stage)
            height, width = image.shape
            image = enlarge(to_bytes(image), (2 * height, 2 * width))
            pictures.append(np.rint(image * 255).astype(np.uint8))
    write_gif(file, pictures, GIF_LAP_MS / frames, mode="L")


def write_gif(file: Path, pictures: list[np.ndarray], frame_ms: float, **options: str) -> None:
    """Write pictures of bytes as an endless animation."""
    data = imageio.v3.imwrite("<bytes>", np.stack(pictures), extension=".gif", plugin="pillow",
                              is_batch=True, duration=frame_ms, loop=0, **options)  # fmt: skip
    assert data is not None
    atomic_write(file, data)


def render_plane(drawn: np.ndarray, truth: canvases.PlaneTruth) -> np.ndarray:
    """(h, w, 3) the light of a canvas (h, w, 4) of bytes."""
    sky = Sky(truth.sun_angle, truth.sun_width, truth.sun, truth.sky)
    return np.asarray(render(from_rgba(drawn), sky, rays=PLANE_RAYS, exposure=truth.exposure))


def all_planes() -> Iterator[tuple[str, np.ndarray, canvases.PlaneTruth, dict]]:
    """Every canvas: its name, its bytes, its sky, and more entries of the manifest."""
    for name, (draw, truth, note) in canvases.CANVASES.items():
        yield name, draw(), truth, {"note": note}
    states = canvases.sand_frames()
    for i, cells in enumerate(states):
        truth = canvases.sand_truth(i, len(states))
        more = {
            "seed": canvases.SAND_SEED,
            "step": i * canvases.SAND_FRAME_STEPS,
            "grains": grain_counts(cells),
        }
        yield f"plane_sand_{i}", canvases.sand_canvas(cells, SAND_SCALE), truth, more


def make_plane(folder: Path, name: str, drawn: np.ndarray, truth: canvases.PlaneTruth) -> dict:
    """Write the canvas ``name``, its target and side file; its truth."""
    files = {"target": f"{name}.png", "canvas": f"{name}_canvas.png"}
    atomic_write(folder / files["canvas"], bytes(imagecodecs.png_encode(drawn)))
    write_image(folder / files["target"], render_plane(drawn, truth))
    side_file = f'canvas = "{files["canvas"]}"\n\n[scattering]\nmodel = "flatland"\n'
    atomic_write(folder / f"{name}.toml", f"{side_file}rays = {PLANE_RAYS}\n".encode())
    params = {
        "exposure": truth.exposure,
        "sun_angle": truth.sun_angle,
        "sun_width": truth.sun_width,
    }
    for key in ("sun", "sky"):
        params |= {f"{key}_{c}": v for c, v in zip("rgb", getattr(truth, key), strict=True)}
    return files | {"rays": PLANE_RAYS, "params": params}


def make_screenshot(
    folder: Path, name: str, background: str, seed: int, quality: int | None
) -> dict:
    """Write the screenshot ``name``, as a JPEG of some ``quality`` if given, and its side file; its
    truth."""
    screen = screens.make_screenshot(seed, background)
    target = f"{name}.png" if quality is None else f"{name}.jpg"
    if quality is None:
        data = imagecodecs.png_encode(screen.image)
    else:
        data = imagecodecs.jpeg_encode(screen.image, level=quality)
    atomic_write(folder / target, bytes(data))
    params = dict(screen.truth)
    settings = {"shader": screens.SCREENSHOT_SHADER, "samples": params.pop("samples")}
    side_file = f'[scattering]\nshader = "{settings["shader"]}"\nsamples = {settings["samples"]}\n'
    atomic_write(folder / f"{name}.toml", side_file.encode())
    more = {"panels": screen.panels, "pass_scale": screen.pass_scale, "kind": background}
    return {"target": target} | settings | {"params": params} | more


def make_sand_gif(file: Path, frames: int = 60) -> None:
    """Write the falling sand and its light as an animation, twice its size; needs x64."""
    pictures = []
    for i, cells in enumerate(canvases.sand_frames(frames, SAND_GIF_FRAME_STEPS)):
        drawn = canvases.sand_canvas(cells, SAND_SCALE)
        image = render_plane(drawn, canvases.sand_truth(i, frames))
        larger = to_bytes(image).repeat(2, 0).repeat(2, 1)
        pictures.append(np.rint(larger * 255).astype(np.uint8))
    write_gif(file, pictures, SAND_GIF_FRAME_MS)


def make_target(folder: Path, name: str, target: Target) -> dict:
    """Write the target ``name``, its mask, its background and its side file; its truth."""
    files = {"target": f"{name}.png", "mask": f"{name}_mask.png"}
    mask = to_bytes(target.mask(*(target.mask_size or target.size)))
    write_image(folder / files["mask"], mask)
    background = None
    if target.background is not None:
        files["background"] = f"{name}_background.png"
        background = to_bytes(target.background(*target.size))
        write_image(folder / files["background"], background)
        background = jnp.asarray(background)

    shader, samples, lights = target.shader, target.samples, target.lights
    params = mitchell_params(1.0, 1.0, 1.0, 1.0) | target.params
    model = Mitchell(**params, light=lights, shader=shader, samples=samples)
    image = rendered(model, mask, background)
    if mask.shape[:2] != target.size:
        image = enlarge(to_bytes(image), target.size)
    write_image(folder / files["target"], image)

    side_file = [f'{key} = "{files[key]}"' for key in files if key != "target"]
    side_file += ["", "[scattering]", f'shader = "{shader}"', f"samples = {samples}", EXACT_LINE]
    side_file += [f"lights = {len(lights)}"] if len(lights) > 1 else []
    atomic_write(folder / f"{name}.toml", ("\n".join(side_file) + "\n").encode())
    light_names = [row.name for row in light_parameters(len(lights))]
    truth = target.params | dict(zip(light_names, sum(lights, ()), strict=True))
    settings = {"shader": shader, "samples": samples}
    return files | settings | {"params": truth, "note": target.note}


def make(folder: Path) -> None:
    """Write every target, its mask, its side file and the manifest to ``folder``; needs x64."""
    targets = {name: make_target(folder, name, target) for name, target in TARGETS.items()}
    scenes = {name: make_stage(folder, name, stage) | more for name, stage, more in all_stages()}
    planes = {
        name: make_plane(folder, name, drawn, truth) | more
        for name, drawn, truth, more in all_planes()
    }
    screenshots = {
        name: make_screenshot(folder, name, *settings) for name, settings in SCREENSHOTS.items()
    }
    manifest = {
        "schema": 1, "targets": targets, "scenes": scenes, "canvases": planes,
        "screenshots": screenshots,
    }  # fmt: skip
    text = json.dumps(manifest, indent=1) + "\n"
    atomic_write(folder / "manifest.json", text.encode())


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the synthetic targets.")
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parent)
    parser.add_argument("--gif", nargs=2, metavar=("FILE", "NAME"),
                        help=f"write one of {', '.join(ANIMATIONS)} as an animation")  # fmt: skip
    given = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if given.gif is None:
        make(given.folder)
        return
    file, name = given.gif
    if name not in ANIMATIONS:
        parser.error(f"--gif: expected one of {', '.join(ANIMATIONS)}, got '{name}'")
    if name == "sand":
        make_sand_gif(Path(file))
    else:
        make_gif(Path(file), name)


if __name__ == "__main__":
    main()
