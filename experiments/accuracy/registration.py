"""Are parameters found within their errors where target and mask come from different sources?

    python experiments/accuracy/registration.py [--frames FOLDER] [--side mask|target]
                                                [--program pillow|once|opencv] [--seeds FIRST:LAST]

Each frame is cropped by one and by two pixels, or one of its two pictures, ``--side``, is made
larger or smaller by 1% with each of a program's common kernels: Pillow's, the same rounded to bytes
``once``, or OpenCV's, which must be installed. Frames are made pictures of triangles
and of clouds, or those of ``FOLDER``: ``NAME_target.png``, ``NAME_occlusion.png`` and the truth in
``NAME.json`` (``params``, ``light_uv``). Printed for each: whether the fit converged, the worst
error of a parameter over its quoted error, and the noise in levels.
"""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from godfit import fit
from tests.support import random_targets

SAMPLES = 80
KINDS = ("triangles", "clouds")
RESIZED = {"larger": 1.01, "smaller": 0.99}
SHADERS = {"dawn": "dawntime", "babylon": "babylon", "pp": "pmndrs"}


def made(first: int, last: int) -> Iterator[tuple[str, Any, Any, dict[str, float], str]]:
    for seed in range(first, last):
        kind = KINDS[seed % len(KINDS)]
        mask, image, truth = random_targets.draw(seed, kind, samples=SAMPLES)
        yield f"{kind} {seed}", random_targets.to_bytes(image), mask, truth, "dawntime"


def frames(folder: Path) -> Iterator[tuple[str, Any, Any, dict[str, float], str]]:
    for path in sorted(folder.glob("*.json")):
        read = json.loads(path.read_text())
        truth = dict(read["params"])
        truth["light_x"], truth["light_y"] = read["light_uv"]
        shader = SHADERS[path.stem.split("_")[0]]
        target, mask = (
            np.asarray(Image.open(path.with_name(f"{path.stem}_{part}.png")).convert("RGB"))
            for part in ("target", "occlusion")
        )
        yield path.stem, target, mask, truth, shader


def cropped(target, truth: dict[str, float], pixels: int):
    """The ``target`` without that many columns at its left and rows at its bottom."""
    h, w = target.shape[:2]
    truth = dict(truth)
    truth["light_x"] = (truth["light_x"] * w - pixels) / (w - pixels)
    truth["light_y"] = (truth["light_y"] * h - pixels) / (h - pixels)
    return target[: h - pixels, pixels:], truth


def by_pillow(kernel: Image.Resampling, picture, size: tuple[int, int]):
    return np.asarray(Image.fromarray(picture).resize(size, kernel))


def rounded_once(kernel: Image.Resampling, picture, size: tuple[int, int]):
    channels = [Image.fromarray(z) for z in np.moveaxis(np.atleast_3d(picture).astype("f4"), -1, 0)]
    made = np.stack([np.asarray(one.resize(size, kernel)) for one in channels], -1)
    return np.uint8(np.round(made).clip(0, 255)).reshape(*made.shape[:2], *picture.shape[2:])


def programs(name: str) -> dict[str, Callable]:
    """Functions (picture, (width, height)) -> resized, by kernel."""
    if name == "opencv":
        cv2 = importlib.import_module("cv2")
        kinds = ("linear", "area", "cubic", "lanczos4")
        return {
            kind: partial(cv2.resize, interpolation=getattr(cv2, f"INTER_{kind.upper()}"))
            for kind in kinds
        }
    way = by_pillow if name == "pillow" else rounded_once
    kernels = {
        kind: partial(way, Image.Resampling[kind.upper()])
        for kind in ("box", "bilinear", "bicubic", "lanczos")
    }
    if name == "once":
        # Programs that round once have the overlap of pixels instead.
        del kernels["box"]
    return kernels


def distorted(target, mask, truth: dict[str, float], side: str, program: str):
    """(name, target, mask, truth) of each distortion."""
    for pixels in (1, 2) if program == "pillow" else ():
        crop, moved = cropped(target, truth, pixels)
        yield f"crop {pixels}", crop, mask, moved
    h, w = (mask if side == "mask" else target).shape[:2]
    for way, factor in RESIZED.items():
        size = round(w * factor), round(h * factor)
        for name, resized in programs(program).items():
            if side == "mask":
                yield f"{way} {name}", target, resized(mask, size), truth
            else:
                yield f"{way} {name}", resized(target, size), mask, truth


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--frames", type=Path)
    parser.add_argument("--side", choices=("mask", "target"), default="mask")
    parser.add_argument("--program", choices=("pillow", "once", "opencv"), default="pillow")
    parser.add_argument("--seeds", default="0:6")
    given = parser.parse_args()
    first, last = (int(end) for end in given.seeds.split(":"))
    total = converged = held = 0
    for name, target, mask, truth, shader in (
        frames(given.frames) if given.frames else made(first, last)
    ):
        for way, changed, under, moved in distorted(target, mask, truth, given.side, given.program):
            result = fit(changed, mask=under, shader=shader, samples=int(truth["samples"]))
            errors = {
                key: abs(one.value - moved[key]) / one.stderr
                for key, one in result.params.items()
                if one.stderr
            }
            worst = max(errors, key=lambda key: errors[key], default="")
            total, converged = total + 1, converged + result.converged
            held += result.converged and errors.get(worst, 0) < 5
            print(
                f"{name:30} {way:17} {'converged' if result.converged else 'NOT':9} "
                f"{errors.get(worst, np.nan):7.1f} {worst:9} noise {result.noise_levels:.3f}",
                flush=True,
            )
    print(f"{converged} of {total} converged, {held} of these within 5 errors in every parameter")


if __name__ == "__main__":
    main()
