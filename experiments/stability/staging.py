"""Are a light and an object found again from a start a tenth of the frame away?

    python experiments/stability/staging.py [--seeds FIRST:LAST] [--size PIXELS]

A primitive stands before a light; both are moved by a tenth of the picture's height, each in a
direction drawn at random, the light's radius is changed by a quarter, and the fit has to find the
light's position and radius, the object's position and the scattering. Depth and radius of the light
trade exactly, so both are judged on the screen: centre and apparent radius of the light, centre and
apparent size of the object, in pixels. Targets are bytes, rendered in float64 by other code.
"""

from __future__ import annotations

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

from godfit import fit
from godfit.scenes import mesh
from godfit.scenes.scene import Camera, Light, Object, Scene
from godfit.scenes.view import drawn_mask
from tests.support import random_targets

FREE = ("light.position", "light.radius", "object[0].position")
SHAPES = (
    ("torus", {"radius": 1.0, "tube": 0.3}),
    ("box", {"size": [1.6, 0.5, 0.9]}),
    ("icosphere", {"radius": 0.8, "subdivisions": 1}),
    ("cylinder", {"radius": 0.45, "height": 2.0, "segments": 24}),
)
ALLOWED = 0.05


def stage(rng: np.random.Generator, size: int) -> Scene:
    """A primitive in random pose before a light that it hides in part."""
    kind, sizes = SHAPES[rng.integers(len(SHAPES))]
    shape = mesh.primitive(kind, **sizes)
    camera = Camera(
        jnp.array([rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(5, 7)]),
        jnp.zeros(3),
        jnp.array([0.0, 1.0, 0.0]),
        jnp.asarray(rng.uniform(45, 65)),
        0.1,
        100.0,
    )
    light = Light(
        jnp.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(-4, -2)]),
        jnp.asarray(rng.uniform(0.8, 1.3)),
        (1.0, 1.0, 1.0),
    )
    thing = Object(
        jnp.asarray(shape.vertices, jnp.float32),
        jnp.asarray(shape.faces),
        jnp.asarray(mesh.edges(shape.faces)),
        jnp.array([*rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.5, 0.5)]),
        jnp.asarray(rng.uniform(-180, 180, 3)),
        jnp.asarray(rng.uniform(0.8, 1.2)),
        (0.0, 0.0, 0.0),
    )
    return Scene(camera, light, (thing,), (17 / 255, 17 / 255, 17 / 255), (size, size))


def moved(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with the light and the object a tenth of the picture's height away."""
    across = np.asarray(scene.camera_axes()[:2])
    half = np.tan(np.deg2rad(float(scene.camera.fov_y)) / 2)
    values = {"light.radius": scene.light.radius * rng.choice([0.8, 1.25])}
    for name in ("light.position", "object[0].position"):
        place = np.asarray(scene.value(name))
        turn = rng.uniform(0, 2 * np.pi)
        step = 0.2 * half * np.linalg.norm(place - np.asarray(scene.camera.position))
        values[name] = jnp.asarray(place + step * np.array([np.cos(turn), np.sin(turn)]) @ across)
    return scene.replaced(values)


def on_screen(scene: Scene) -> np.ndarray:
    """Centre and apparent radius of the light, centre and size of the object, in pixels (6,)."""
    axes, camera = np.asarray(scene.camera_axes(), float), np.asarray(scene.camera.position, float)
    focal = 0.5 * scene.size[0] / np.tan(np.deg2rad(float(scene.camera.fov_y)) / 2)
    found = []
    for name, radius in (("light", float(scene.light.radius)), ("object[0]", 1.0)):
        x, y, z = axes @ (np.asarray(scene.value(f"{name}.position"), float) - camera)
        found += [focal * x / -z, focal * y / -z, focal * radius / -z]
    return np.array(found)


def attempt(seed: int, size: int) -> tuple[bool, bool]:
    """Whether all was found to ALLOWED pixels, and whether the fit said that it converged."""
    rng = np.random.default_rng(seed)
    while True:
        truth = stage(rng, size)
        mask = drawn_mask(truth, True)
        if np.mean(mask > 0.9) > 0.01 and np.mean(mask < 0.03) > 0.02:
            break
    light = on_screen(truth)[:2] / size
    samples = int(rng.integers(60, 120))
    values = {
        "decay": float(rng.uniform(0.05, 0.5) ** (1 / samples)),
        "density": float(rng.uniform(0.5, 1.0)),
        "weight": float(rng.uniform(0.4, 1.0)),
        "light_x": 0.5 + light[0],
        "light_y": 0.5 + light[1],
        "samples": samples,
        "exposure": 1.0,
    }
    linear = random_targets.render64(mask.astype(float), values)
    target = random_targets.to_bytes(linear / np.quantile(linear, 0.98))
    began = time.perf_counter()
    result = fit(target, scene=moved(truth, rng), free=FREE, shader="dawntime", samples=samples)
    seconds = time.perf_counter() - began
    jax.clear_caches()
    off = np.abs(on_screen(result.model.staged()) - on_screen(truth))  # pyright: ignore[reportAttributeAccessIssue]
    found = bool((off < ALLOWED).all())
    words = "found" if found else ("MISSED, said" if result.converged else "missed, said not")
    print(
        f"seed {seed}: {words} converged; light off by {off[:2].max():.4f}, its radius by "
        f"{off[2]:.4f}, object by {off[3:5].max():.4f}, its size by {100 * off[5] / 30:.3f}%; "
        f"{result.noise_levels:.3g} levels, {seconds:.0f} s",
        flush=True,
    )
    return found, result.converged


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="0:20")
    parser.add_argument("--size", type=int, default=192)
    options = parser.parse_args()
    first, last = (int(n) for n in options.seeds.split(":"))
    runs = [attempt(seed, options.size) for seed in range(first, last)]
    wrong = sum(converged and not found for found, converged in runs)
    print(f"{sum(found for found, _ in runs)} of {len(runs)} found, {wrong} wrong but converged")


if __name__ == "__main__":
    main()
