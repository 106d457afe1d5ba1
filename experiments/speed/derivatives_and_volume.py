"""How much time do derivatives and ray marches take, and how wrong are they?

    python experiments/speed/derivatives_and_volume.py [--repeats N] [--size N] [--figure FILE]

**Jacobians.** The six derivatives of dawntime's light pass by exposure, decay, density, weight and
the light, at every pixel of the four masks of ``speed_accuracy.py``, with n = 150, by every method
of the sum. The oracle is the exact method in float64. An error is the root mean square of a
derivative's error over that of the derivative, the largest of the six. Derivatives jump where a tap
crosses from one texel to the next, and float32 takes the other side at a few pixels: that limits
exact methods.

**Volume.** A march (``godfit.models.volume``) of the sun behind a box and a ball, by steps of a ray
and pixels of the shadow map. The oracle has 4096 steps and a map of 8192. An error is the root mean
square in levels, of pictures whose brightest value is 255. A time has the shadow map in it.

Times are medians of warm runs, in turn. What no other is both faster and more accurate than is on
the front, marked by *.
"""

from __future__ import annotations

import argparse
import functools
import statistics
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from godfit.models.atmosphere import Air
from godfit.models.build import view_of_scene
from godfit.models.volume import render
from godfit.scattering.conventions import convention
from godfit.scattering.radial import METHODS, radial_sum
from godfit.scenes.scene import Scene, read_scene
from tests.support import random_targets
from tests.support.timing import timed

KINDS = {
    "hard": ("triangles", (0.56, 0.6)),
    "soft": ("clouds", (0.45, 0.55)),
    "struts": ("lattice", (0.52, 0.63)),
    "off screen": ("maze", (1.25, 1.3)),
}
EXPOSURE, DENSITY, WEIGHT, END, SAMPLES = 0.05, 0.85, 0.7, 0.1, 150
STEPS, RESOLUTIONS = (8, 16, 32, 64, 128, 256, 512), (256, 1024, 4096)
FINEST = 4096, 8192
SCENE = """
[image]
width = {size}
height = {size}
[camera]
position = [0, 0, 0]
target = [0, 0, -1]
fov_y = 70
far = 12
[light]
position = [0, 470, -1000]
radius = 60
[[object]]
primitive = "box"
size = [1, 1, 1]
position = [0.4, 1.2, -5]
rotation = [20, 30, 0]
[[object]]
primitive = "icosphere"
radius = 0.4
position = [-0.9, 0.3, -4]
"""
AIR = Air(2.0, 0.7, 1.0, 4e3)

Row = tuple[float, float]
"""Seconds and the error."""


def jacobian(mask, numbers, method: str):
    """(6, h, w) derivatives by exposure, decay, density, weight and the light."""

    def light_pass(numbers):
        exposure, decay, density, weight, *light = numbers
        taps = convention("dawntime").taps(exposure, decay, density, weight, SAMPLES)[0]
        return radial_sum(mask, jnp.stack(light), taps, method=method)

    along = functools.partial(jax.jvp, light_pass, (numbers,))
    return jax.vmap(lambda way: along((way,))[1])(jnp.eye(6, dtype=numbers.dtype))


def jacobians(kind: str, size: int, repeats: int) -> dict[str, Row]:
    """Time and error of every method on a mask."""
    name, light = KINDS[kind]
    drawn = random_targets.MASKS[name](np.random.default_rng(5), size, np.array(light))
    mask = np.floor(drawn * 255 + 0.5).clip(0, 255) / 255
    numbers = np.array([EXPOSURE, END ** (1 / SAMPLES), DENSITY, WEIGHT, *light])
    program = jax.jit(jacobian, static_argnames="method")
    with jax.enable_x64(True):
        exact = np.asarray(program(jnp.asarray(mask), jnp.asarray(numbers), method="auto"))
    given = jnp.asarray(mask, jnp.float32), jnp.asarray(numbers, jnp.float32)
    calls, errors = {}, {}
    for method in METHODS:
        calls[method] = functools.partial(program.lower(*given, method=method).compile(), *given)
        off = np.asarray(calls[method](), np.float64) - exact
        errors[method] = float(np.sqrt((off**2).mean((1, 2)) / (exact**2).mean((1, 2))).max())
    times = in_turn(calls, repeats)
    return {method: (times[method], errors[method]) for method in METHODS}


def marches(size: int, repeats: int) -> dict[str, Row]:
    """Time and error of every number of steps and resolution."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(SCENE.format(size=size))
        scene = read_scene(path)
    distance = np.asarray(view_of_scene(scene).distance)

    def marched(steps: int, resolution: int, scene: Scene = scene):
        return render(scene, AIR, distance, steps=steps, resolution=resolution)

    finest = marched(*FINEST).astype(np.float64)
    calls = {f"{s}, {r}": functools.partial(marched, s, r) for r in RESOLUTIONS for s in STEPS}
    scale = 255 / finest.max()
    errors = {n: scale * float(np.sqrt(((c() - finest) ** 2).mean())) for n, c in calls.items()}
    times = in_turn(calls, repeats)
    return {name: (times[name], errors[name]) for name in calls}


def in_turn(calls, repeats: int) -> dict[str, float]:
    """Median seconds of each of the calls, which have been made once."""
    seconds = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            seconds[name].append(timed(call))
    return {name: statistics.median(times) for name, times in seconds.items()}


def front(rows: dict[str, Row]) -> list[str]:
    """What no other beats in both time and error, fastest first."""
    found, least = [], np.inf
    for name in sorted(rows, key=lambda name: rows[name]):
        if rows[name][1] < least:
            least = rows[name][1]
            found.append(name)
    return found


def table(title: str, columns: dict[str, dict[str, Row]]) -> None:
    print(f"\n{title}")
    print(f"{'':12s}" + "".join(f"{name:>22s}" for name in columns))
    fronts = {name: front(rows) for name, rows in columns.items()}
    for row in next(iter(columns.values())):
        cells = [
            f"{1e3 * rows[row][0]:10.1f} {rows[row][1]:9.2g}{' *'[row in fronts[name]]} "
            for name, rows in columns.items()
        ]
        print(f"{row:12s}" + "".join(cells), flush=True)


def draw(panels: dict[str, tuple[dict[str, Row], str]], path: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.4 * -(-len(panels) // 2)), layout="constrained")
    grid = np.atleast_1d(figure.subplots(-(-len(panels) // 2), 2)).reshape(-1)
    for at, (title, (rows, unit)) in zip(grid, panels.items(), strict=False):
        line = front(rows)
        at.step(*np.transpose([(1e3 * rows[n][0], rows[n][1]) for n in line]), where="post",
                color="0.7", zorder=0)  # fmt: skip
        for name, (seconds, error) in rows.items():
            at.plot(1e3 * seconds, error, "o", color="C0", ms=5, mfc="C0" if name in line else "w")
            at.annotate(name, (1e3 * seconds, error), (4, 3), textcoords="offset points",
                        fontsize=6)  # fmt: skip
        at.set(xscale="log", yscale="log", title=title, xlabel="time, ms", ylabel=unit)
        at.grid(color="0.92")
    for at in grid[len(panels) :]:
        at.set_axis_off()
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--figure")
    options = parser.parse_args()
    found = {kind: jacobians(kind, options.size, options.repeats) for kind in KINDS}
    size = f"{options.size}x{options.size}"
    table(f"Jacobians, {size}, n = {SAMPLES}: ms, relative error; * on the front", found)
    volume = marches(options.size // 4, options.repeats)
    small = f"{options.size // 4}x{options.size // 4}"
    table(f"Volume, {small}, steps and map: ms, levels; * on the front", {"box and ball": volume})
    if options.figure:
        panels = {f"Jacobian, {kind}": (rows, "relative error") for kind, rows in found.items()}
        draw(panels | {"volume": (volume, "levels, rms")}, options.figure)


if __name__ == "__main__":
    main()
