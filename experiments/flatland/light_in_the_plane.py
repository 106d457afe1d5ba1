"""Light in the plane: how much time does each way take, how wrong is it, and what can be read back?

    python experiments/flatland/light_in_the_plane.py [PART ...] [--size N] [--repeats N]
                                                      [--truths N] [--figure FILE]

Parts, by default all: ``chart`` (error against time of march, distance march and cascades over rays
and steps), ``bar`` (512x512, 32 rays: the distance march, and the march that is as near to it),
``sizes`` (the same ways at several resolutions), ``flood`` (what the jump flood's errors do),
``noise`` (jitter against rays and against accumulated frames), ``forms`` (closed forms),
``gradients`` (ten canvases), ``recovery`` (random skies, fitted to bytes).

The canvases are those of data_synthetic, at the size asked for. Errors are rms over all pixels, as
a share of the rms of the reference: the distance march of 1,024 rays in float64, which is exact but
for the rays. Times are medians of warm runs in float32, the ways in turn.
"""

from __future__ import annotations

import argparse
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from scipy.ndimage import distance_transform_edt

from godfit import fit
from godfit.flatland import (
    Canvas,
    Sky,
    accumulated,
    canvas,
    effective_frames,
    from_rgba,
    render,
    weights,
)
from godfit.flatland import rays as walks
from godfit.flatland.jump_flood import jump_flood
from godfit.flatland.walk_kernel import FILLED, OUTSIDE
from tests.support.plane_measures import SKY, measured, reference, rms, scenes, shapes
from tests.support.synthetic import canvases

RAYS = (8, 16, 32, 64, 128, 256)
CASCADES = (4, 8, 16)


def ways(size: int) -> dict[str, dict]:
    found = {f"distance, {r} rays": {"rays": r} for r in RAYS}
    diagonal = math.hypot(size, size)
    for r in (8, 32):
        for pixels in (4.0, 1.0):
            steps = round(diagonal / pixels)
            options = {"rays": r, "method": "march", "steps": steps}
            found[f"march, {r} rays, steps of {pixels:g}"] = options
    return found | {f"cascades of {r}": {"rays": r, "method": "cascades"} for r in CASCADES}


def chart(size: int, repeats: int) -> dict[str, dict[str, tuple]]:
    print(f"\n## chart: {size}x{size}, float32; ms and error in % of the light's rms")
    found = {}
    for name, values in scenes(size).items():
        found[name] = measured(values, ways(size), repeats, reference(values))
    print(f"{'':<32}" + "".join(f"{name:>18}" for name in found))
    for way in ways(size):
        cells = [f"{1e3 * found[n][way][0]:9.1f} {100 * found[n][way][1]:7.2f}%" for n in found]
        print(f"{way:<32}" + "".join(f"{cell:>18}" for cell in cells))
    for name, rows in found.items():
        for r in CASCADES:
            time, error = rows[f"cascades of {r}"]
            near = [(rows[f"distance, {n} rays"], n) for n in RAYS]
            equal = [(t, n) for (t, e), n in near if e <= error]
            if equal:
                t, n = min(equal)
                print(f"  {name}: cascades of {r} take {time / t:.2f} times as long as the "
                      f"distance march of {n} rays, the first no less exact")  # fmt: skip
            else:
                print(f"  {name}: cascades of {r} are nearer than any distance march here")
    return found


def bar(size: int, repeats: int) -> None:
    """The distance march, and marches that come as near to what it would be with any steps."""
    print(f"\n## bar: {size}x{size}, 32 rays; error against the same 32 rays in float64")
    for name, values in scenes(size).items():
        exact = reference(values, 32)
        diagonal = math.hypot(size, size)
        steps = {f"march of {p:g}": round(diagonal / p) for p in (2.0, 1.0, 0.5, 0.25)}
        rows = measured(
            values,
            {"distance": {"rays": 32}}
            | {k: {"rays": 32, "method": "march", "steps": n} for k, n in steps.items()},
            repeats,
            exact,
        )
        base = rows["distance"][0]
        for way, (time, error) in rows.items():
            print(f"  {name:<8}{way:<16}{1e3 * time:9.1f} ms {100 * error:8.3f}%  "
                  f"{time / base:6.2f} times")  # fmt: skip


def sizes(repeats: int) -> None:
    print("\n## sizes: ms and error of the stroke")
    for size in (128, 256, 512, 1024):
        values = canvases.stroke(size, size)
        chosen = {
            "distance, 32 rays": {"rays": 32},
            "distance, 128 rays": {"rays": 128},
            "march, 32 rays, steps of 1": {
                "rays": 32, "method": "march", "steps": round(math.hypot(size, size)),
            },
            "cascades of 4": {"rays": 4, "method": "cascades"},
        }  # fmt: skip
        rows = measured(values, chosen, repeats, reference(values))
        for way, (time, error) in rows.items():
            print(f"  {size:>5} {way:<28}{1e3 * time:9.1f} ms {100 * error:7.2f}%")


def flood() -> None:
    print("\n## flood: pixels off by more than half a pixel; pictures with scipy's exact distances")
    total, wrong = 0, 0
    for seed in range(10):
        with jax.enable_x64(True):
            made = canvas(*shapes(seed))
            filled = np.asarray(made.opacity) > 0
            exact = np.asarray(distance_transform_edt(~filled))
            off = np.asarray(jump_flood(jnp.asarray(filled)).distance) - exact
            sky = Sky(*SKY).over(64)
            settings = walks.TraceSettings(64, walks.steps_to_cross(*made.size))
            inputs = walks.trace_inputs(made, sky, settings, None)
            room = np.clip(exact - math.sqrt(2), 0, None)
            free = np.pad(np.where(filled, FILLED, room), 1, constant_values=OUTSIDE)
            exact_inputs = inputs._replace(
                grid=inputs.grid._replace(free_distance=jnp.asarray(free))
            )
            flooded = np.asarray(walks.trace(inputs, settings, 3))
            true = np.asarray(walks.trace(exact_inputs, settings, 3))
        total, wrong = total + off.size, wrong + np.count_nonzero(off > 0.5)
        h, w = made.size
        print(f"  {w}x{h}: {100 * np.mean(off > 0.5):.4f}% off, at most {off.max():.2f} pixels; "
              f"picture {100 * rms(flooded, true):.2g}% rms")  # fmt: skip
    print(f"  ten canvases: {100 * wrong / total:.4f}%")


def noise() -> None:
    print("\n## noise: jittered stroke, 256x256, rms in % of the light's")
    values = canvases.stroke(256, 256)
    made, sky = from_rgba(values), Sky(*SKY)
    exact = reference(values)
    for rays in (1, 2, 4, 8, 16, 32, 64, 128):
        one = jax.jit(functools.partial(render, rays=rays, jitter=True))
        print(f"  {rays:>4} rays {100 * rms(one(made, sky, seed=1), exact):8.2f}%   "
              f"without jitter {100 * rms(render(made, sky, rays=rays), exact):8.2f}%")  # fmt: skip
    frame = jax.jit(functools.partial(render, rays=8, jitter=True))
    single = rms(frame(made, sky, seed=0), exact)
    print("  8 rays, frames accumulated: error, frames that it is worth, and should be")
    for count in (1, 2, 5, 11, 22, 44, 88):
        cells = []
        for how in ("mean", "mix"):
            error = rms(accumulated((frame(made, sky, seed=s) for s in range(count)), how), exact)
            expected = effective_frames(weights(count, how))
            cells.append(f"{how} {100 * error:6.2f}% {(single / error) ** 2:6.2f} {expected:6.2f}")
        print(f"  {count:>4}  " + "   ".join(cells))


def forms() -> None:
    print("\n## forms: closed forms at 256 rays, float64")
    with jax.enable_x64(True):
        for radius in (20, 60, 140):
            h, w = 2 * radius + 10, 3 * radius + 10
            y, x = np.indices((h, w)) + 0.5
            r = np.hypot(x - radius - 5, y - radius - 5)
            opacity = (r < radius).astype(float)
            made = canvas(np.repeat(opacity[..., None], 3, -1), opacity)
            far = r > 1.1 * radius
            found = np.asarray(render(made, rays=256))[..., 0][far]
            expected = np.arcsin(radius / r[far]) / np.pi
            print(f"  disc of radius {radius}: mean "
                f"{100 * (found.mean() / expected.mean() - 1):+.2f}%, "
                  f"pixels {100 * rms(found, expected):.2f}% rms")  # fmt: skip
        h, w, d = 60, 3001, 50
        opacity = np.zeros((h, w))
        opacity[d:] = 1
        sky = Sky(90.0, 30.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
        picture = render(canvas(np.zeros((h, w, 3)), opacity), sky, rays=256)
        found = np.asarray(picture)[:40, w // 2, 0]
        expected = 0.5 + np.arctan((d - np.arange(40) - 0.5) / (w / 2)) / np.pi
        print(f"  horizon: pixels {100 * rms(found, expected):.2f}% rms")


def gradients() -> None:
    """Derivative pictures of 1,024 rays against central differences of pictures of 2,039 rays."""
    print("\n## gradients: rms over ten canvases' pixels, against central differences of more rays")
    names = ("exposure", "sun angle", "sun width", "sun", "sky", "emission", "opacity")
    off, size = dict.fromkeys(names, 0.0), dict.fromkeys(names, 0.0)
    worst = dict.fromkeys(names, 0.0)
    with jax.enable_x64(True):
        for seed in range(10):
            radiance, opacity = (z[::5, ::5] for z in shapes(seed))
            made = canvas(radiance + 0.1 * opacity[..., None], np.where(opacity > 0, 0.9, 0.0))
            rng = np.random.default_rng(seed)
            ways = [jnp.asarray(rng.uniform(0, 1, (*made.size, 3))) * made.opacity[..., None]]
            ways += [jnp.asarray(rng.uniform(0, 0.5, made.size)) * (made.opacity > 0)]

            def picture(z, rays, made=made, ways=ways):
                sky = Sky(100 + 60 * z[1], 50 + 20 * z[2], jnp.array(SKY[2]) * (1 + z[3]),
                          jnp.array(SKY[3]) * (1 + z[4]))  # fmt: skip
                held = Canvas(made.radiance + z[5] * ways[0], made.opacity + z[6] * ways[1])
                return render(held, sky, rays=rays, exposure=1 + z[0])

            value = jax.jit(picture, static_argnums=1)

            def slope(way, picture=picture):
                few = functools.partial(picture, rays=1024)
                return jax.jvp(few, (jnp.zeros(7),), (way,))[1]

            slope = jax.jit(slope)
            for i, name in enumerate(names):
                way = jnp.zeros(7).at[i].set(1.0)
                expected = (value(1e-4 * way, 2039) - value(-1e-4 * way, 2039)) / 2e-4
                wrong = float(jnp.square(slope(way) - expected).sum())
                off[name], size[name] = off[name] + wrong, size[name] + float((expected**2).sum())
                share = math.sqrt(wrong / float((expected**2).sum()))
                worst[name] = max(worst[name], share)
    for name in names:
        print(f"  {name:<12}{100 * math.sqrt(off[name] / size[name]):8.3f}%   "
              f"worst canvas {100 * worst[name]:.3f}%")  # fmt: skip


def recovery(truths: int) -> None:
    """Skies drawn at random about the stroke and the window, both with lamps, rendered in float64,
    rounded, fitted."""
    print(f"\n## recovery: {truths} random skies from bytes, two canvases in turn")
    covered: dict[str, list[bool]] = {}
    largest: dict[str, float] = {}
    converged = 0
    for seed in range(truths):
        rng = np.random.default_rng(1000 + seed)
        values = canvases.stroke(128, 128) if seed % 2 else canvases.window(120, 216)
        sun, sky = rng.uniform(0.3, 1.5, 3), rng.uniform(0.05, 0.4, 3)
        truth = {
            "exposure": rng.uniform(0.5, 1.0),
            "sun_angle": rng.uniform(20, 160) if seed % 2 else rng.uniform(120, 170),
            "sun_width": rng.uniform(15, 80),
        }
        truth |= {f"sun_{c}": v for c, v in zip("rgb", sun, strict=True)}
        truth |= {f"sky_{c}": v for c, v in zip("rgb", sky, strict=True)}
        with jax.enable_x64(True):
            around = Sky(truth["sun_angle"], truth["sun_width"], sun, sky)
            image = np.asarray(
                render(from_rgba(values), around, rays=64, exposure=truth["exposure"])
            )
        # Half of them with noise of half a level before the rounding.
        image = 255 * image + (0.5 * rng.normal(size=image.shape) if seed % 4 > 1 else 0)
        target = np.clip(np.floor(image + 0.5), 0, 255).astype(np.uint8)
        result = fit(target, canvas=from_rgba(values), rays=64)
        converged += result.converged
        for name, estimate in result.params.items():
            off = abs(estimate.value - truth[name])
            known = estimate.stderr is not None
            covered.setdefault(name, []).append(bool(known and off < 1.96 * (estimate.stderr or 0)))
            relative = off / (1 if name in ("sun_angle", "sun_width") else truth[name])
            largest[name] = max(largest.get(name, 0), relative)
    print(f"  converged {converged} of {truths}")
    for name, inside in covered.items():
        unit = "degrees" if name in ("sun_angle", "sun_width") else "relative"
        print(f"  {name:<10} within 95%: {sum(inside):>3} of {len(inside)}, "
              f"largest error {largest[name]:.2g} {unit}")  # fmt: skip


def figure(found: dict[str, dict[str, tuple]], size: int, file: str) -> None:
    """Three canvases with their light, and error against time."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    shown = Figure(figsize=(13, 3.4), layout="constrained")
    axes = shown.subplots(1, 4, width_ratios=(1, 1, 1, 1.5))
    drawings = scenes(size)
    for panel, name in zip(axes[:3], ("stroke", "window", "sand"), strict=True):
        values = drawings[name]
        image = render(from_rgba(values), Sky(*SKY), rays=256)
        panel.imshow(np.clip(1.3 * np.asarray(image), 0, 1) ** (1 / 1.8))
        panel.set_title(name, fontsize=10)
        panel.set_axis_off()
    chart = axes[3]
    for way, marker in (("distance", "o"), ("march, 32", "s"), ("cascades", "^")):
        for name, colour in (("stroke", "C0"), ("window", "C1"), ("maze", "C2"), ("sand", "C3")):
            points = sorted(v for k, v in found[name].items() if k.startswith(way))
            times, errors = ([1e3 * t for t, _ in points], [100 * e for _, e in points])
            label = f"{way.split(',')[0]}" if name == "stroke" else None
            chart.loglog(times, errors, marker, ls="-", color=colour, label=label, ms=5, lw=0.8)
    chart.set_xlabel(f"ms, {size}x{size}")
    chart.xaxis.set_minor_formatter(NullFormatter())
    chart.set_ylabel("error, % of the light's rms")
    chart.legend(
        fontsize=8, title="stroke blue, window orange\nmaze green, sand red", title_fontsize=7
    )
    chart.grid(alpha=0.3)
    shown.savefig(file, dpi=80)


PARTS = ("chart", "bar", "sizes", "flood", "noise", "forms", "gradients", "recovery")


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the light in the plane.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--truths", type=int, default=20)
    parser.add_argument("--figure")
    given = parser.parse_args()
    for part in given.parts:
        if part not in PARTS:
            parser.error(f"expected parts of {', '.join(PARTS)}, got '{part}'")
    found = None
    for part in given.parts or PARTS:
        if part == "chart":
            found = chart(given.size, given.repeats)
        elif part in ("bar", "sizes"):
            bar(given.size, given.repeats) if part == "bar" else sizes(given.repeats)
        elif part == "recovery":
            recovery(given.truths)
        else:
            {"flood": flood, "noise": noise, "forms": forms, "gradients": gradients}[part]()
    if given.figure:
        figure(found or chart(given.size, given.repeats), given.size, given.figure)


if __name__ == "__main__":
    main()
