"""A program that uses the package, run by tests/runtime/test_guest.py: what it had set is still
set afterwards, and nothing that it had set breaks a fit. Prints one line of JSON."""

import json
import os
import signal
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np

import godfit

FOLDER = Path(sys.argv[1])
STRICT = {
    "jax_numpy_dtype_promotion": "strict",
    "jax_disable_jit": True,
    "jax_transfer_guard": "disallow",
    "jax_check_tracer_leaks": True,
    "jax_debug_nans": True,
    "jax_enable_x64": True,
}
HELD = {"decay": 0.9, "density": 0.9, "weight": 0.5, "light_x": 0.5, "light_y": 0.5}


def snapshot() -> dict:
    streams = {
        name: (getattr(sys, name), os.fstat(n)[:3])
        for n, name in enumerate(("stdin", "stdout", "stderr"))
    }
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGPIPE)}
    return {
        "streams": streams,
        "filters": (id(warnings.filters), list(warnings.filters)),
        "show": (warnings.showwarning, getattr(warnings, "_showwarnmsg_impl", None)),
        "jax": dict(jax.config.values),
        "numpy": np.geterr(),
        "handlers": handlers,
        "environment": dict(os.environ),
        "folder": os.getcwd(),
        "limit": sys.getrecursionlimit(),
        "hooks": (sys.excepthook, sys.unraisablehook, sys.settrace, sys.getswitchinterval()),
    }


def work(k: int = 0) -> float:
    """A fit with its pictures, a mask, and a fit that fails; returns the fitted exposure."""
    found = godfit.fit(
        str(FOLDER / "target.png"), mask=str(FOLDER / "mask.png"), shader="dawntime", samples=8,
        fix=HELD, inquire=False,
    )  # fmt: skip
    found.render()
    found.save(FOLDER / f"result{k}")
    # Only the command line draws a mask by this function, which has no public name.
    from godfit.scenes.view import drawn_mask

    drawn_mask(godfit.read_scene(FOLDER / "scene.toml"), k % 2 == 0)
    try:
        godfit.fit(str(FOLDER / "target.png"), mask=str(FOLDER / "no.png"), shader="dawntime")
    except godfit.InputError:
        return found.params["exposure"].value
    raise AssertionError("a missing mask was fitted")


def changed(before: dict) -> list[str]:
    after = snapshot()
    return [name for name in before if before[name] != after[name]]


def main() -> dict:
    warnings.filterwarnings("error", category=DeprecationWarning, module="host")
    before, said = snapshot(), {}
    said["value"] = work()
    said["alone"] = changed(before)
    with ThreadPoolExecutor(2) as pool:
        said["of_threads"] = list(pool.map(work, range(2)))
    said["threads"] = changed(before)
    for name, value in STRICT.items():
        jax.config.update(name, value)
    np.seterr(all="raise")
    before = snapshot()
    said["strict_value"] = work()
    said["strict"] = changed(before)
    if hasattr(os, "fork"):
        said["forked"] = forked()
    return said


def forked() -> str:
    """What a fit says in a child that is forked after a fit, or that it does not end."""
    warnings.simplefilter("ignore")  # JAX warns of the fork too.
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(20)
        try:
            work()
            text = "fitted"
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(write, text.encode())
        os._exit(0)
    os.close(write)
    os.waitpid(child, 0)
    return os.read(read, 1 << 16).decode()


if __name__ == "__main__":
    print(json.dumps(main()))
