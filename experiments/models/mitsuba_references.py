"""Make tests/models/volume_references.npz: single scattering by Mitsuba 3, which the march must
agree with.

    pip install 'godfit[oracle]'
    python experiments/models/mitsuba_references.py [--samples N] [-o FILE]

Five scenes of a lamp among objects in a cube of one medium, of pure haze or (the least turbidity)
pure molecules, 16x16 pixels. Mitsuba's ``volpath`` with a depth of two is the same integral, with
noise: every image is the mean of BATCHES independent ones, whose spread says how large that is.
Only its variant ``scalar_rgb`` runs on every machine.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from godfit.runtime.files import atomic_write
from godfit.scenes.scene import Scene
from tests.support.mitsuba_scenes import HALF, HAZE, REFERENCES, SIZE, Reference, air_of, scene_of

BATCHES = 16


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
    parser.add_argument("-o", "--output", default="tests/models/volume_references.npz")
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
