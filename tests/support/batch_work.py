"""Frames for batches, and work that stands for their fits where only the batch is tested.

The name of a frame says what happens to it: ``crash`` ends its worker, ``once`` ends the first
worker that has it, ``raise`` raises. All others get a record that depends on their bytes alone.

    python -m tests.support.batch_work ARGUMENTS

runs the command line with this work in place of fits.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

from godfit.errors import InputError
from godfit.studies.batch.worker import CONVERGED, FAILED, NOT_CONVERGED, Outcome, Task
from tests.support import random_targets

SECONDS_VARIABLE = "GODFIT_TEST_SECONDS"
"""Environment variable with the seconds that a frame takes."""
SAMPLES = 60
FATAL = ("crash", "once", "raise")
"""Parts of names of frames that are not fitted as others are."""


def write_frames(folder: Path, count: int, size: int) -> None:
    """Pictures ``frames/f_I.png`` of random truths with masks ``masks/f_I.png``, ``size`` pixels a
    side."""
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    (folder / "masks").mkdir(exist_ok=True)
    for i in range(count):
        rng = np.random.default_rng(i)
        light = rng.uniform(0.3, 0.7, 2)
        mask = np.floor(random_targets.triangles(rng, size, light) * 255 + 0.5).astype(np.uint8)
        truth = {
            "exposure": 0.05, "decay": 0.975, "density": 0.85, "weight": 0.6,
            "light_x": light[0], "light_y": light[1], "samples": SAMPLES,
        }  # fmt: skip
        picture = random_targets.to_bytes(random_targets.render64(mask / 255, truth).clip(0, 1))
        Image.fromarray(mask).save(folder / "masks" / f"f_{i}.png")
        Image.fromarray(picture).save(folder / "frames" / f"f_{i}.png")


def made_up(data: bytes) -> dict:
    """A record as of fit.json that depends on ``data`` alone."""
    digest = hashlib.sha256(data).digest()
    share = [byte / 255 for byte in digest]
    names = ("exposure", "decay", "density", "weight", "light_x", "light_y")
    params = {
        name: {"value": share[i], "stderr": None if i == 3 else 1e-3 * share[-i - 1],
               "fixed": False, "at_bound": i == 1}
        for i, name in enumerate(names)
    }  # fmt: skip
    converged = digest[0] % 8 > 0
    return {
        "schema": 2, "converged": converged, "message": "converged" if converged else "no minimum",
        "model": "mitchell", "shader": "dawntime", "samples": SAMPLES, "params": params,
        "combined": {"exposure*weight": {"value": share[7], "stderr": 0.001, "fixed": False,
                                         "at_bound": False}},
        "correlations": {"exposure,weight": -0.5}, "undetermined": ["only a product is known"],
        "warnings": [{"code": "clipped", "text": "a word", "option": None}], "notes": [],
        "noise_levels": share[8], "rmse_levels": share[9], "psnr_db": None,
        "residual_correlation": 0.1, "residual_tails": 3.0, "log_likelihood": -1.5,
        "size": [8, 6], "pass_size": [8, 6], "pass_scale": 1.0, "transfer": "none", "pixels": 48,
        "pixels_effective": 48.0, "starts_agreed": None, "pixels_clipped": digest[1],
        "timing_s": {"solve": 0.1}, "inputs": {"target": {"path": "x.png", "sha256": ""}},
        "versions": {"godfit": "0"}, "command": "",
    }  # fmt: skip


def stand_in(task: Task) -> Outcome:
    """In place of ``fit_one``."""
    target = Path(task.root, task.targets[0])
    time.sleep(float(os.environ.get(SECONDS_VARIABLE, "0")))
    tried = target.with_suffix(".tried")
    fate = next((word for word in FATAL if word in target.name), "")
    if fate == "crash" or (fate == "once" and not tried.exists()):
        tried.touch()
        os._exit(9)
    if fate == "raise":
        return Outcome(FAILED, error=str(InputError(f"'{task.targets[0]}': expected a picture")))
    record = made_up(target.read_bytes())
    return Outcome(CONVERGED if record["converged"] else NOT_CONVERGED, record, "", 0.1, "here")


if __name__ == "__main__":
    from godfit.__main__ import run
    from godfit.studies.batch import engine
    from tests.support import batch_work

    # By the module's name, under which workers import it.
    engine.fit_one = batch_work.stand_in
    sys.argv[0] = "godfit"
    run()
