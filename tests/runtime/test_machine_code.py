"""Machine code of the custom calls: a later run loads it without numba, and does
without it where it is damaged."""

import os
import subprocess
import sys

import pytest

from godfit.runtime.one_core import cores
from godfit.scattering.radial.exact import EXACT

PROGRAM = """
import sys
import numpy as np
from godfit import Mitchell
from godfit.runtime import machine_code

mask = np.random.default_rng(0).random((40, 60)).astype(np.float32)
model = Mitchell(0.05, 0.98, 0.9, 0.7, light=(0.4, 0.6), shader="dawntime", samples=60)
fast, slow = (np.asarray(model(mask, method=m)) for m in ("strips", "reference"))
print(bool(np.allclose(fast, slow, atol=1e-6)), "numba" in sys.modules, len(machine_code._engines))
"""


AHEAD = """
from godfit.commands.study import SUM
from godfit.runtime.machine_code import compile_ahead
compile_ahead(*SUM)
"""


def run(cache, program=PROGRAM) -> list[str]:
    ran = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env=os.environ | {"GODFIT_CACHE": str(cache)},
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.split()


@pytest.mark.skipif("strips" not in EXACT, reason="numba is not installed")
def test_code_is_loaded_without_numba(tmp_path):
    cache = tmp_path / "cache"
    # With a core to spare, a companion compiles what a command will call.
    beside = cores() > 1
    assert run(cache, AHEAD + PROGRAM) == ["True", str(not beside), str(int(beside))]
    assert run(cache) == ["True", "False", "1"]
    (stored,) = cache.glob("machine-*/*")
    whole = stored.read_bytes()
    stored.write_bytes(whole[:-100])
    # numba's own store serves from then on.
    assert run(cache) == ["True", "True", "0"]
    assert not stored.exists()
