"""Is Hoffman and Preetham's daylight found again, and told from Mitchell's sum?

    python experiments/daylight.py [--seeds FIRST:LAST] [--noise LEVELS ...] [--compare]

Truths are drawn over turbidity 1.2 to 8, g .2 to .9, an optical depth of .1 to 2, the sun up to 10%
outside the frame, views of 40 to 90 degrees, before ridges, bars or blocks that stand nearer than
the sky. Targets of 192x192 bytes are computed in float64 from the published formulas by other code
than the fit's. A truth counts as found if every parameter that the fit says it knows is within four
of its errors, or within half a percent. With --compare, these targets and as many of Mitchell's are
given to `godfit.studies.compare`, which has to prefer the model that made them.
"""

from __future__ import annotations

import argparse

import jax
import numpy as np
import scenes
from scipy import ndimage

from godfit import fit
from godfit.studies.compare import compare

SIZE, SAMPLES = 192, 60
NAMES = ("e_sun", "scale", "turbidity", "g", "light_x", "light_y")
KINDS = ("ridges", "bars", "blocks")
NANOMETRES = np.array([650.0, 570.0, 475.0])


def radiance64(truth: dict[str, float], view: dict[str, np.ndarray | float]) -> np.ndarray:
    """(h, w, 3) from the formulas: Preetham et al. 1999, Hoffman & Preetham 2002, Mitchell 2007."""
    mask, distance = np.asarray(view["mask"], float), np.asarray(view["distance"], float)
    h, w = mask.shape
    u, v = np.meshgrid((np.arange(w) + 0.5) / w, 1 - (np.arange(h) + 0.5) / h)
    tall = np.tan(np.radians(float(view["fov"])) / 2)

    def towards(u, v):
        ray = np.stack([(2 * u - 1) * tall * w / h, (2 * v - 1) * tall, -np.ones_like(u)], -1)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    light = np.array([truth["light_x"]]), np.array([truth["light_y"]])
    sun = towards(*light)[0]
    cos = towards(u, v) @ sun
    t, g = truth["turbidity"], truth["g"]
    metres = NANOMETRES * 1e-9
    n, p, count = 1.0003, 0.035, 2.545e25
    beta_r = 8 * np.pi**3 * (n**2 - 1) ** 2 * (6 + 3 * p) / (6 - 7 * p) / (3 * count * metres**4)
    concentration = (6.544 * t - 6.51) * 1e-17
    beta_m = 0.434 * concentration * np.pi * (2 * np.pi / metres) ** 2
    beta_m = 1e-3 * beta_m * np.array([0.685, 0.679, 0.670])
    zenith = np.degrees(np.arccos(np.clip(sun[1], 0, 1)))
    mass = 1 / (np.cos(np.radians(zenith)) + 0.15 * (93.885 - zenith) ** -1.253)
    haze = 0.04608365822050 * t - 0.04586025928522
    micro = NANOMETRES * 1e-3
    through = np.exp(-mass * (0.008735 * micro**-4.08 + haze * micro**-1.3))
    lobe = (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cos) ** 1.5)
    phase = 3 / (16 * np.pi) * (1 + cos**2)
    scattered = phase[..., None] * beta_r + lobe[..., None] * beta_m
    beta = truth["scale"] * (beta_r + beta_m)
    light_in = truth["e_sun"] * through * truth["scale"] * scattered / beta
    light_in = light_in * (1 - np.exp(-beta * distance[..., None]))
    rows, columns = np.mgrid[:h, :w].astype(float)
    at = truth["light_x"] * w - 0.5, (1 - truth["light_y"]) * h - 0.5
    seen = np.zeros((h, w))
    for k in range(1, SAMPLES + 1):
        share = k / SAMPLES
        where = [rows + share * (at[1] - rows), columns + share * (at[0] - columns)]
        seen += ndimage.map_coordinates(mask, where, order=1, mode="nearest") / SAMPLES
    return seen[..., None] * light_in


def draw(seed: int, kind: str):
    """(view, image (h, w, 3) float64 unclamped, truth): a sky of 1 behind occluders of 0."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    u, v = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE, 1 - (np.arange(SIZE) + 0.5) / SIZE)
    sky = np.ones((SIZE, SIZE))
    if kind == "ridges":
        for level in (0.15, 0.35):
            waves = sum(
                rng.uniform(0, 0.3 / k) * np.sin(2 * np.pi * k * u + rng.uniform(0, 6.3))
                for k in range(1, 12)
            )
            sky[v < level * rng.uniform(0.7, 1.3) + 0.3 * waves] = 0
    elif kind == "bars":
        for _ in range(rng.integers(4, 10)):
            angle, offset = rng.uniform(0, np.pi), rng.uniform(-0.6, 0.6)
            across = (u - 0.5) * np.cos(angle) + (v - 0.5) * np.sin(angle) - offset
            sky[np.abs(across) < rng.uniform(0.005, 0.04)] = 0
    else:
        for _ in range(rng.integers(4, 9)):
            x, y = rng.uniform(0, 1, 2)
            wide, high = rng.uniform(0.05, 0.2, 2)
            sky[(np.abs(u - x) < wide / 2) & (np.abs(v - y) < high / 2)] = 0
    light = rng.uniform(-0.1, 1.1), rng.uniform(0.55, 1.1)
    distance = np.where(sky > 0, 1.0, rng.uniform(0.2, 0.8)).astype(np.float32)
    view = {"mask": sky, "distance": distance, "fov": float(rng.uniform(40, 90))}
    truth = {
        "e_sun": 1.0,
        "scale": 1.0,
        "turbidity": float(rng.uniform(1.2, 8)),
        "g": float(rng.uniform(0.2, 0.9)),
        "light_x": float(light[0]),
        "light_y": float(light[1]),
    }
    # At 570 nm the depth is 1.1757e-5 + (6.544 T - 6.51) 1.125e-6 a metre.
    per_metre = 1.1757e-5 + (6.544 * truth["turbidity"] - 6.51) * 1.1249e-6
    truth["scale"] = float(rng.uniform(0.1, 2) / per_metre)
    image = radiance64(truth, view)
    truth["e_sun"] = float(rng.uniform(0.6, 1.1) / np.quantile(image.max(-1), 0.98))
    return view, image * truth["e_sun"], truth


def attempt(seed: int, kind: str, noise: float):
    """(found, converged, errors over standard errors (6,), description)."""
    view, image, truth = draw(seed, kind)
    result = fit(
        scenes.to_bytes(image, noise, seed), mask=view["mask"], model="hoffman-preetham",
        fov=view["fov"], distance=view["distance"], samples=SAMPLES,
    )  # fmt: skip
    scores, missed = np.full(len(NAMES), np.nan), []
    for i, name in enumerate(NAMES):
        estimate = result.params[name]
        if estimate.stderr is None:
            continue
        error = estimate.value - truth[name]
        if abs(error) > max(5e-3 * abs(truth[name]), 4 * estimate.stderr):
            missed.append(f"{name} {estimate.value:.5g} for {truth[name]:.5g}")
        if not estimate.at_bound:
            scores[i] = error / estimate.stderr
    words = f"seed {seed} {kind}: {', '.join(missed) or 'found'}; {result.message}"
    return not missed, result.converged, scores, words


def recovery(first: int, last: int, noises: list[float]) -> None:
    for noise in noises:
        runs = [attempt(seed, kind, noise) for seed in range(first, last) for kind in KINDS]
        for found, converged, _, words in runs:
            if not found or not converged:
                print(f"  {'CONVERGED WRONG ' if converged and not found else ''}{words}")
        z = np.array([run[2] for run in runs])
        covered = [
            f"{name} {np.mean(np.abs(c[~np.isnan(c)]) < 1.96):.3f} of {np.sum(~np.isnan(c))}"
            for name, c in zip(NAMES, z.T, strict=True)
        ]
        print(
            f"noise of {noise:g} levels: {sum(r[0] for r in runs)} of {len(runs)} found, "
            f"{sum(r[1] and not r[0] for r in runs)} wrong but converged\n"
            f"  95% intervals cover: {', '.join(covered)}; "
            f"all {np.mean(np.abs(z[~np.isnan(z)]) < 1.96):.3f}",
            flush=True,
        )


def preference(first: int, last: int) -> None:
    """A line for every pair of targets, one of each model's, and how often each was preferred."""
    right = {"hoffman-preetham": 0, "mitchell": 0}
    count = 0
    for seed in range(first, last):
        for kind, other in zip(KINDS, scenes.FRESH, strict=True):
            count += 1
            view, image, _ = draw(seed, kind)
            sunny = compare(
                scenes.to_bytes(image, 0.0, seed),
                mask=view["mask"],
                fov=view["fov"],
                distance=view["distance"],
                samples=SAMPLES,
                shader="dawntime",
            )
            mask, image, truth = scenes.draw(seed, other, SIZE)
            shaded = compare(
                scenes.to_bytes(image, 0.0, seed),
                mask=mask,
                fov=60.0,
                distance=1000.0,
                samples=int(truth["samples"]),
                shader="dawntime",
            )
            chosen = [found.best.result.model.name for found in (sunny, shaded)]
            right["hoffman-preetham"] += chosen[0] == "hoffman-preetham"
            right["mitchell"] += chosen[1] == "mitchell"
            print(f"  seed {seed}: {kind} by hoffman-preetham prefers {chosen[0]}, "
                  f"{other} by mitchell prefers {chosen[1]}", flush=True)  # fmt: skip
            jax.clear_caches()
    for name, number in right.items():
        print(f"targets of {name}: {number} of {count} prefer it", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="100:107")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 1.0])
    parser.add_argument("--compare", action="store_true")
    options = parser.parse_args()
    first, last = (int(n) for n in options.seeds.split(":"))
    if options.compare:
        preference(first, last)
    else:
        recovery(first, last, options.noise)


if __name__ == "__main__":
    main()
