"""Are wrong models found out, and right ones left alone?

    python experiments/diagnostics.py [--targets N] [--clean N] [--kinds NAME ...] [--size PIXELS]

Targets are random masks and truths (``scenes.py``), rendered in float64 by other code than the
fit's, with a defect that the fit is not told of. A defect counts as found if a warning names it. A
clean target, with noise of 0 or 1 level before rounding, hard or soft masks, must get none.
"""

from __future__ import annotations

import argparse
import io
import sys

import numpy as np
import scenes
from PIL import Image
from scipy import ndimage

import godfit
from godfit.runtime.cache import enable_jax_cache

SAMPLES = 40
# What a warning about each defect says.
SAYS = {
    "transfer": "gamma-encoded",
    "register": "shifted",
    "upsampled": "rendered at",
    "convention": "another shader",
    "light": "second light",
    "background": "background was clipped",
    "jpeg": "JPEG",
}


def truth_and_mask(seed: int, size: int):
    """A mask as bytes, a truth with a light in the frame, and the random numbers that follow."""
    rng = np.random.default_rng([seed, 6])
    kind = list(scenes.MASKS)[seed % len(scenes.MASKS)]
    light = rng.uniform(0.1, 0.9, 2)
    mask = np.floor(scenes.MASKS[kind](rng, size, light) * 255 + 0.5).clip(0, 255).astype(np.uint8)
    truth = {
        "decay": float(rng.uniform(0.02, 0.7) ** (1 / SAMPLES)),
        "density": float(rng.uniform(0.5, 1.0)),
        "weight": float(rng.uniform(0.2, 1.0)),
        "light_x": float(light[0]),
        "light_y": float(light[1]),
        "samples": SAMPLES,
        "exposure": 1.0,
    }
    exposed(mask, truth, rng.uniform(0.6, 0.95))
    return mask, truth, rng


def exposed(mask: np.ndarray, truth: dict[str, float], top: float) -> None:
    """Set the truth's exposure so that its 98th percentile is at ``top``."""
    truth["exposure"] = 1.0
    truth["exposure"] = float(
        top / max(np.quantile(scenes.render64(mask / 255, truth), 0.98), 1e-6)
    )


def enlarged(low: np.ndarray, size: int) -> np.ndarray:
    """(size, size) read bilinearly at pixel centres."""
    return np.asarray(
        ndimage.zoom(low, size / low.shape[0], order=1, mode="nearest", grid_mode=True)
    )


def encoded(levels: np.ndarray, quality: int) -> np.ndarray:
    """Bytes after a JPEG of that quality."""
    file = io.BytesIO()
    Image.fromarray(levels).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))


def made(kind: str, seed: int, size: int) -> tuple[np.ndarray, dict]:
    """A target with a defect, and what the fit is given."""
    mask, truth, rng = truth_and_mask(seed, size)
    given = {"mask": mask, "shader": "dawntime", "samples": SAMPLES}
    image = scenes.render64(mask / 255, truth)
    if kind == "clean":
        return scenes.to_bytes(image, float(seed % 2), seed), given
    if kind == "transfer":
        return scenes.to_bytes(np.maximum(image, 0) ** (1 / 2.2)), given
    if kind == "register":
        shift = rng.choice([-1, 1], 2) * rng.uniform(1, 4, 2)
        given["mask"] = np.roll(mask, np.round(shift).astype(int), (0, 1))
        return scenes.to_bytes(image), given
    if kind == "upsampled":
        low = mask.reshape(size // 2, 2, size // 2, 2).mean((1, 3)) / 255
        return scenes.to_bytes(enlarged(scenes.render64(low, truth), size)), given
    if kind == "convention":
        given["shader"] = "pmndrs"
        return scenes.to_bytes(image), given
    if kind == "light":
        other = truth | {"light_x": (truth["light_x"] + 0.5) % 1, "light_y": rng.uniform(0.1, 0.9)}
        both = image + 0.6 * scenes.render64(mask / 255, other)
        return scenes.to_bytes(both / 1.6), given
    if kind == "background":
        noise = ndimage.gaussian_filter(rng.standard_normal((size, size)), size / 16)
        back = np.clip(0.75 + 0.35 * noise / noise.std(), 0, None)
        # An image of floats is not clipped where the background's bytes are.
        target = (0.5 * image + back).astype(np.float32)
        return target, given | {"background": scenes.to_bytes(back)}
    return encoded(scenes.to_bytes(image), int(rng.integers(60, 96))), given


def warned(kind: str, seed: int, size: int) -> godfit.FitResult:
    target, given = made(kind, seed, size)
    return godfit.fit(target, **given)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--targets", type=int, default=20)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--kinds", nargs="+", default=[*SAYS, "clean"])
    options = parser.parse_args()
    enable_jax_cache()
    kept = True
    for kind in options.kinds:
        count = options.clean if kind == "clean" else options.targets
        hits, converged = 0, 0
        for seed in range(count):
            result = warned(kind, seed, options.size)
            said = " | ".join(result.warnings)
            hit = bool(said) if kind == "clean" else SAYS[kind] in said
            hits, converged = hits + hit, converged + result.converged
            if hit == (kind == "clean"):
                print(
                    f"  {kind} {seed}: noise {result.noise_levels:.2f}, correlation "
                    f"{result.residual_correlation:.2f}: {said or 'silent'}",
                    flush=True,
                )
        kept &= hits <= 0.02 * count if kind == "clean" else hits >= 0.95 * count
        word = "false" if kind == "clean" else "found"
        print(f"{kind:<12} {hits:>3} of {count} {word}, {converged} converged", flush=True)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
