"""Targets of Hoffman and Preetham's daylight behind occluders, and their fits.

A target is computed in float64 from the published formulas by other code than the fit's.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from godfit import fit
from tests.support import random_targets

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


def draw(seed: int, kind: str, size: int = SIZE):
    """(view, image (h, w, 3) float64 unclamped, truth): a sky of 1 behind occluders of 0."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    u, v = np.meshgrid((np.arange(size) + 0.5) / size, 1 - (np.arange(size) + 0.5) / size)
    sky = np.ones((size, size))
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


def attempt(seed: int, kind: str, noise: float, size: int = SIZE):
    """(found, converged, errors over standard errors (6,), description)."""
    view, image, truth = draw(seed, kind, size)
    result = fit(
        random_targets.to_bytes(image, noise, seed), mask=view["mask"], model="hoffman-preetham",
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
