"""Does a change of the code change an answer? Fits data_synthetic before and after, and compares.

    python experiments/accuracy/unchanged.py fit before/    # in a checkout of the old code
    python experiments/accuracy/unchanged.py fit after/     # in a checkout of the new code
    python experiments/accuracy/unchanged.py compare before/ after/

`fit` runs the command line on every target of data_synthetic but the bare pictures (screen_*) and
keeps each fit.json. `compare` prints one line for each target that differs and exits 1 if one does:
a parameter by more than a tenth of the error that was quoted before, a quoted error by more than
2%, the status, the warnings or the undetermined combinations by anything.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[2] / "data_synthetic"
VALUE = 0.1
"""How far a value may move, in the error that was quoted for it."""
ERROR = 0.02
"""How far a quoted error may move, relative."""


def targets() -> list[Path]:
    """The pictures that have a side file, but those that are bare."""
    found = (path for path in sorted(DATA.glob("*.toml")) if not path.name.endswith(".scene.toml"))
    pictures = (path.with_suffix(".png") for path in found if not path.name.startswith("screen_"))
    return [path for path in pictures if path.exists()]


def fit(folder: Path) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    for target in targets():
        with tempfile.TemporaryDirectory() as scratch:
            command = [sys.executable, "-m", "godfit", "fit", target.name, "--json", "-o", scratch]
            run = subprocess.run(command, cwd=DATA, capture_output=True, text=True)
        if run.returncode not in (0, 3):
            print(f"{target.name}: exit {run.returncode}, {run.stderr.strip()}", file=sys.stderr)
            return 1
        (folder / f"{target.stem}.json").write_text(run.stdout)
        print(f"{target.name}: exit {run.returncode}")
    return 0


def said(result: dict) -> tuple[bool, tuple[str, ...], int]:
    """The status, what is undetermined (with numbers taken out) and how many warnings there are."""
    undetermined = tuple(re.sub(r"[-\d.e+]+", "#", text) for text in result["undetermined"])
    return result["converged"], undetermined, len(result["warnings"])


def differences(before: dict, after: dict) -> tuple[list[str], float, float]:
    """What differs, the largest move of a value in errors and of an error, relative."""
    found, moved, scaled = [], 0.0, 0.0
    if said(before) != said(after):
        found.append(f"said {said(before)}, now {said(after)}")
    if before["params"].keys() != after["params"].keys():
        return [*found, "other parameters"], moved, scaled
    for name, old in before["params"].items():
        new = after["params"][name]
        if (old["stderr"] is None) != (new["stderr"] is None):
            found.append(f"{name}: error {old['stderr']}, now {new['stderr']}")
        elif not old["stderr"]:
            if old["value"] != new["value"] and old["fixed"]:
                found.append(f"{name}: held at {old['value']}, now {new['value']}")
        else:
            apart = abs(new["value"] - old["value"])
            value, error = apart / old["stderr"], abs(new["stderr"] / old["stderr"] - 1)
            # Errors can be finer than float32 holds the value.
            last_place = apart <= 1.01 * float(np.spacing(np.float32(abs(old["value"]))))
            scaled = max(scaled, error)
            moved = moved if last_place else max(moved, value)
            if (value > VALUE and not last_place) or error > ERROR:
                found.append(f"{name}: moved by {value:.3g} errors, its error by {error:.1%}")
    return found, moved, scaled


def compare(before: Path, after: Path) -> int:
    names = sorted(path.name for path in before.glob("*.json"))
    bad, moved, scaled = 0, 0.0, 0.0
    for name in names:
        old, new = (json.loads((folder / name).read_text()) for folder in (before, after))
        found, value, error = differences(old, new)
        moved, scaled = max(moved, value), max(scaled, error)
        if found:
            bad += 1
            print(f"{name}: " + "; ".join(found))
    print(
        f"{len(names) - bad} of {len(names)} unchanged; values moved by at most {moved:.2g} of "
        f"their errors, errors by at most {scaled:.2%}"
    )
    return bool(bad) or not names


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["fit", folder]:
            sys.exit(fit(Path(folder)))
        case ["compare", before, after]:
            sys.exit(compare(Path(before), Path(after)))
        case _:
            sys.exit(__doc__)
