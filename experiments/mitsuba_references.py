"""Make tests/volume_references.npz: single scattering by Mitsuba 3, to hold the march against.

    pip install 'godfit[oracle]'
    python experiments/mitsuba_references.py [--samples N] [-o FILE]

Five scenes of a lamp among objects in a cube of one medium, of pure haze or (the least turbidity)
pure molecules, 16x16 pixels. Mitsuba's ``volpath`` with a depth of two is the same integral, with
noise: every image is the mean of BATCHES independent ones, whose spread says how large that is.
Only its variant ``scalar_rgb`` runs on every machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from godfit.models.atmosphere import MIN_TURBIDITY, Air
from godfit.runtime.files import atomic_write
from godfit.scenes.scene import Scene, read_scene

SIZE, HALF, BATCHES = 16, 6.0, 16


@dataclasses.dataclass(frozen=True)
class Reference:
    """A scene, its lamp's place, and the air: turbidity, g, metres a unit, share of haze."""

    objects: str
    light: tuple[float, float, float]
    air: tuple[float, float, float, float]


BOX = '[[object]]\nprimitive = "box"\nsize = [1.0, 1.6, 0.5]\nposition = [0.5, 0.2, -3]\n'
BALL = '[[object]]\nprimitive = "icosphere"\nradius = 0.6\nposition = [-0.8, 0.1, -2.5]\n'
RING = (
    '[[object]]\nprimitive = "torus"\nradius = 0.9\ntube = 0.15\n'
    "position = [0, 0, -3]\nrotation = [60, 20, 0]\n"
)
HAZE, CLEAR = 1.0, MIN_TURBIDITY
REFERENCES = {
    "box, forward haze": Reference(BOX, (0.3, 0.5, -4.0), (2.0, 0.6, 15.0, HAZE)),
    "ball, even haze": Reference(BALL, (-0.9, 0.8, -3.2), (2.0, 0.0, 25.0, HAZE)),
    "box and ball, backward haze": Reference(
        BOX + BALL, (0.0, -0.6, -3.5), (2.0, -0.3, 15.0, HAZE)
    ),
    "ring, molecules": Reference(RING, (0.0, 0.0, -3.2), (CLEAR, 0.0, 1e4, 1e-3)),
    "all, molecules": Reference(BOX + BALL + RING, (0.2, 1.2, -2.6), (CLEAR, 0.0, 2e4, 1e-3)),
}


def air_of(reference: Reference) -> Air:
    turbidity, g, scale, haze = reference.air
    return Air(turbidity, g, 1.0, scale, haze)


def scene_of(reference: Reference, folder: Path) -> Scene:
    """The scene of a reference, its camera at the origin."""
    light = ", ".join(map(str, reference.light))
    (folder / "scene.toml").write_text(
        f"[image]\nwidth = {SIZE}\nheight = {SIZE}\n[camera]\nposition = [0, 0, 0]\n"
        f"target = [0, 0, -1]\nfov_y = 70\n[light]\nposition = [{light}]\nradius = 1e-4\n"
        + reference.objects
    )
    return read_scene(folder / "scene.toml")


def to_the_wall(direction: np.ndarray) -> np.ndarray:
    """How far rays from the middle of the cube go in it."""
    return HALF / np.abs(direction).max(-1)


def image_of(reference: Reference, scene: Scene, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """(h, w, 3) Mitsuba's image of the medium alone, and the standard error of every value."""
    import mitsuba as mi  # pyright: ignore[reportMissingImports]

    mi.set_variant("scalar_rgb")
    air = air_of(reference)
    pure_haze = reference.air[3] == HAZE
    phase: dict[str, Any] = (
        {"type": "hg", "g": reference.air[1]} if pure_haze else {"type": "rayleigh"}
    )
    medium = {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": [1.0, 1.0, 1.0]},
        "sigma_t": {"type": "rgb", "value": [float(b) for b in air.beta_ex]},
        "phase": phase,
    }
    camera = scene.camera
    to_world = mi.ScalarTransform4f().look_at(
        [float(z) for z in camera.position], [float(z) for z in camera.target], [0.0, 1.0, 0.0]
    )
    tree: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 2, "rr_depth": 100},
        "medium": medium,
        "sensor": {
            "type": "perspective",
            "fov": float(camera.fov_y),
            "fov_axis": "y",
            "to_world": to_world,
            "film": {
                "type": "hdrfilm",
                "width": SIZE,
                "height": SIZE,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
            },
            "sampler": {"type": "independent", "sample_count": samples},
            "medium": {"type": "ref", "id": "medium"},
        },
        "wall": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().scale(HALF),
            "bsdf": {"type": "null"},
            "interior": {"type": "ref", "id": "medium"},
        },
        "lamp": {
            "type": "point",
            "position": list(reference.light),
            "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]},
        },
    }
    for i, thing in enumerate(scene.objects):
        vertices, faces = np.asarray(thing.world(), np.float32), np.asarray(thing.faces, np.uint32)
        black = mi.Properties()
        black["mesh_bsdf"] = mi.load_dict(
            {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.0, 0.0, 0.0]}}
        )
        shape = mi.Mesh(f"object{i}", len(vertices), len(faces), props=black)
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = vertices.ravel()
        parameters["faces"] = faces.ravel()
        parameters.update()
        tree[f"object{i}"] = shape
    built = mi.load_dict(tree)
    images = np.array(
        [np.asarray(mi.render(built, seed=seed), np.float64) for seed in range(BATCHES)]
    )
    return images.mean(0), images.std(0, ddof=1) / np.sqrt(BATCHES)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=1024, help="of each of the batches")
    parser.add_argument("-o", "--output", default="tests/volume_references.npz")
    options = parser.parse_args()
    arrays = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, reference in REFERENCES.items():
            scene = scene_of(reference, Path(folder))
            mean, error = image_of(reference, scene, options.samples)
            print(
                f"{name}: mean {mean.mean():.4g}, noise {error.mean() / mean.mean():.2%}",
                flush=True,
            )
            arrays[f"{name}/mean"] = mean.astype(np.float32)
            arrays[f"{name}/error"] = error.astype(np.float32)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    atomic_write(Path(options.output), buffer.getvalue())


if __name__ == "__main__":
    main()
