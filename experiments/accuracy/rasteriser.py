"""How exact are masks of scenes and their derivatives, and how long do they take?

    python experiments/accuracy/rasteriser.py [--quick] [--figure FILE]

Against 32x32 samples per pixel, on ten random scenes (tests/support/random_scenes.py), float64: the
mean error of the pixels that a contour crosses, the worst of those further than a pixel from every
contour, and the worst relative error of the area of a colour that has a hundredth of the picture;
and the ten derivatives of a smooth loss with respect to the places of the light, the camera and an
object and the light's radius, against central differences of the samples: the length of the
difference over that of the gradient. A step is a quarter of a pixel, or an eighth below 128x128:
what an object uncovers within it is an error of the differences, and shrinks with the pixels.
Coverage is exact: there is no width of an edge to choose or to compare.

Times are medians of warm runs, taken in turn, float32: an icosphere before the light, and the skull
of ../shared where it is there; nine numbers of the pose have a derivative.
"""

from __future__ import annotations

import argparse
import functools
import statistics
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit.scenes import mesh, raster
from godfit.scenes.scene import Camera, Light, Object, Scene
from tests.support import random_scenes
from tests.support.paths import SHARED
from tests.support.timing import timed

SKULL = SHARED / "models" / "skull" / "scene.gltf"
POSE = ("light.position", "light.radius", "camera.position", "object[0].position")
NINE = ("light.position", "camera.position", "object[0].position")
KINDS = ("hard", "anti-aliased", "value and gradient")

gradient = eqx.filter_jit(eqx.filter_grad(random_scenes.loss))


def coverage_error(scene: Scene) -> tuple[float, float, float]:
    """Mean error on edge pixels, worst inside, worst relative error of a colour's area."""
    share, expected = (
        np.asarray(eqx.filter_jit(raster.coverage)(scene)),
        random_scenes.supersampled(scene),
    )
    error, edge = np.abs(share - expected).max(-1), expected.max(-1) < 1
    inside = ~edge
    for axis in (0, 1):
        for shift in (1, -1):
            inside &= (np.roll(expected, shift, axis) == expected).all(-1)
    area = expected.sum((0, 1))
    large = area > 0.01 * edge.size
    wrong = np.abs(share.sum((0, 1)) - area)[large] / area[large]
    return error[edge].mean(), error[inside].max(), wrong.max()


def sampled_loss(scene: Scene) -> float:
    mask = random_scenes.supersampled(scene) @ random_scenes.greys(scene)
    return float((mask * random_scenes.weight(scene.size)).sum())


def gradient_error(scene: Scene) -> float:
    """Relative, of the whole gradient."""
    found, actual, expected = gradient(scene), [], []
    # Over a quarter of a pixel, eight samples, their rounding is a few thousandths of the gradient.
    # In small pictures what comes into sight within a step weighs more: a shorter one errs less.
    step = (0.125 if scene.size[0] < 128 else 0.25) * random_scenes.pixel(scene.size[0])
    for name in POSE:
        value = np.asarray(scene.value(name), float)
        actual += np.asarray(found.value(name)).ravel().tolist()
        for k in np.ndindex(value.shape):
            losses = []
            for sign in (1, -1):
                moved = value.copy()
                moved[k] += sign * step
                losses.append(sampled_loss(scene.replaced({name: jnp.asarray(moved)})))
            expected.append((losses[0] - losses[1]) / (2 * step))
    return float(np.linalg.norm(np.subtract(actual, expected)) / np.linalg.norm(expected))


def accuracy(sizes: list[int], gradient_sizes: list[int], scenes: int) -> dict[str, np.ndarray]:
    print(f"{scenes} scenes: worst, and in brackets median, over the scenes")
    print("  pixels     edge pixels, mean       inside   area               gradient")
    rows = []
    for size in sizes:
        covered, slopes = [], []
        for seed in range(scenes):
            scene = random_scenes.draw(seed, size)
            covered.append(coverage_error(scene))
            if size in gradient_sizes:
                slopes.append(gradient_error(scene))
        edge, inside, area = np.array(covered).T
        slope = np.array(slopes) if slopes else np.full((1, 1), np.nan)
        words = f"{100 * slope.max():.3f}% ({100 * np.median(slope):.3f}%)" if slopes else "-"
        print(
            f"  {size:4d}^2     {edge.max():.5f} ({np.median(edge):.5f})   {inside.max():8.1e}   "
            f"{100 * area.max():.4f}% ({100 * np.median(area):.4f}%)   {words}",
            flush=True,
        )
        rows.append(
            (size, edge.max(), np.median(edge), area.max(), np.median(area), slope.max(),
             np.median(slope))
        )  # fmt: skip
    names = ("size", "edge", "edge_median", "area", "area_median", "slope", "slope_median")
    return dict(zip(names, np.array(rows).T, strict=True))


def ball(subdivisions: int, size: int) -> Scene:
    shape = mesh.primitive("icosphere", radius=0.8, subdivisions=subdivisions)
    return _stage(random_scenes.build(shape, (0.3, 0.2, 3.0)), size, (0.0, 0.0, 0.0), 0.8)


def skull(size: int) -> Scene:
    thing = random_scenes.build(mesh.load(SKULL), (0.0, 0.0, 3.0))
    return _stage(thing, size, (0.0, 0.0, 0.0), 0.8)


def _stage(thing: Object, size: int, light, radius: float) -> Scene:
    return Scene(
        Camera(
            jnp.asarray([-0.04, -0.68, 6.97], float),
            jnp.zeros(3),
            jnp.asarray([0.0, 1.0, 0.0], float),
            jnp.asarray(75.0, float),
            0.1,
            350.0,
        ),
        Light(jnp.asarray(light, float), jnp.asarray(radius, float), (1.0, 1.0, 1.0)),
        (thing,),
        (17 / 255, 17 / 255, 17 / 255),
        (size, size),
    )


def parts(scene: Scene) -> list[Callable[[], object]]:
    """The three things to be timed, each warm."""
    hard = eqx.filter_jit(functools.partial(raster.rasterise, antialias=False))
    soft = eqx.filter_jit(raster.rasterise)

    @eqx.filter_jit
    def both(pose, scene):
        return jax.value_and_grad(lambda p: random_scenes.loss(scene.replaced(p)))(pose)

    pose = {name: scene.value(name) for name in NINE}
    made = [lambda: hard(scene), lambda: soft(scene), lambda: both(pose, scene)]
    for part in made:
        timed(part)
    return made


def medians(scenes: list[Scene], repeats: int) -> np.ndarray:
    """(scenes, 3) seconds."""
    rows = [parts(scene) for scene in scenes]
    seconds = [[[timed(part) for part in row] for row in rows] for _ in range(repeats)]
    return np.array(
        [[statistics.median(s[i][k] for s in seconds) for k in range(3)] for i in range(len(rows))]
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="few scenes, small sizes")
    parser.add_argument("--scenes", type=int)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--figure")
    options = parser.parse_args()
    quick = options.quick
    jax.config.update("jax_enable_x64", True)
    exact = accuracy(
        [32, 64, 128] if quick else [32, 64, 128, 256, 512],
        [32, 64] if quick else [32, 64, 128, 256],
        options.scenes or (3 if quick else 10),
    )
    jax.config.update("jax_enable_x64", False)
    head = "".join(f"{kind:>20s}" for kind in KINDS)
    levels = list(range(3, 7 if quick else 9))
    triangles = np.array([20 * 4**n for n in levels])
    by_triangles = medians([ball(n, 512) for n in levels], options.repeats)
    print(f"512x512 pixels, ms\n{'triangles':>11s}{head}")
    for count, row in zip(triangles, 1000 * by_triangles, strict=True):
        print(f"{count:11,d}" + "".join(f"{t:20.1f}" for t in row))
    sizes = np.array([128, 256, 512] if quick else [128, 256, 512, 1024])
    by_pixels = medians([ball(5, int(n)) for n in sizes], options.repeats)
    print(f"20,480 triangles, ms\n{'pixels':>11s}{head}")
    for size, row in zip(sizes, 1000 * by_pixels, strict=True):
        print(f"{size:9d}^2" + "".join(f"{t:20.1f}" for t in row))
    if SKULL.is_file():
        times = 1000 * medians([skull(512)], options.repeats)[0]
        print(f"skull of 31,016 triangles, 512x512 pixels, ms\n{'':11s}{head}")
        print(f"{'':11s}" + "".join(f"{t:20.1f}" for t in times))
    if options.figure:
        draw(exact, triangles, by_triangles, sizes, by_pixels, options.figure)


def draw(exact, triangles, by_triangles, sizes, by_pixels, path: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    axes = figure.subplots(2, 2)

    def panel(at, x, curves, title, xlabel, ylabel, ticks=None):
        for y, style, name in curves:
            at.loglog(x, y, style, label=name, ms=4)
        at.set(title=title, xlabel=xlabel, ylabel=ylabel)
        if ticks is not None:
            at.set_xticks(ticks, [f"{t:g}" for t in ticks])
            at.set_xticks([], minor=True)
        at.grid(color="0.9", which="major")
        at.legend(fontsize=8)

    size = exact["size"]
    panel(
        axes[0, 0],
        size,
        [
            (exact["edge"], "ko-", "edge pixels, mean: worst scene"),
            (exact["edge_median"], "ko:", "edge pixels, mean: median scene"),
            (exact["area"], "s-C0", "area of a colour, relative: worst scene"),
            (exact["area_median"], "s:C0", "area of a colour, relative: median scene"),
        ],
        "coverage against 32x32 samples",
        "width, pixels",
        "error",
        size,
    )
    shown = ~np.isnan(exact["slope"])
    panel(
        axes[0, 1],
        size[shown],
        [
            (exact["slope"][shown], "ko-", "worst scene"),
            (exact["slope_median"][shown], "ko:", "median scene"),
        ],
        "gradient against differences of samples",
        "width, pixels",
        "relative error",
        size[shown],
    )
    for at, x, times, title, xlabel, ticks in (
        (axes[1, 0], triangles, by_triangles, "512x512 pixels", "triangles", None),
        (axes[1, 1], sizes, by_pixels, "20,480 triangles", "width, pixels", sizes),
    ):
        curves = [
            (1000 * times[:, k], style, kind)
            for k, (kind, style) in enumerate(zip(KINDS, ("ko:", "s-C0", "^-C3"), strict=True))
        ]
        panel(at, x, curves, title, xlabel, "time, ms", ticks)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
