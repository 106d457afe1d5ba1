"""Pictures of every model, (h, w) or (h, w, 3), clamped to [0, 1]."""

from __future__ import annotations

import equinox as eqx
import numpy as np

from godfit.errors import InputError
from godfit.inference.observation import render
from godfit.models import volume as air
from godfit.models.hoffman_preetham import HoffmanPreetham
from godfit.models.mitchell import Mitchell
from godfit.runtime.device import on_device
from godfit.scattering.radial import cheapest
from godfit.scenes.scene import Scene


def mitchell(
    model: Mitchell,
    mask: np.ndarray,
    background: np.ndarray | None,
    size: tuple[int, int],
    tolerance: float = 0.0,
) -> np.ndarray:
    """Mitchell's sum, its light pass off by ``tolerance`` levels at most. All lights are summed by
    one method, and their errors add up."""
    _check(background, size)
    if not tolerance:
        return render(model, mask, background, size)
    low = on_device(mask)
    back = None if background is None else on_device(background)
    method = cheapest(low, model.light, model.taps[-1], tolerance)
    return np.clip(np.asarray(eqx.filter_jit(model)(low, back, size=size, method=method)), 0, 1)


def daylight(model: HoffmanPreetham, mask: np.ndarray, background: np.ndarray | None) -> np.ndarray:
    """Hoffman and Preetham's daylight, past a ``mask`` that is 1 where the sky is seen."""
    size = mask.shape[0], mask.shape[1]
    _check(background, size)
    return render(model, mask, background, size)


def volume(
    model: HoffmanPreetham,
    scene: Scene | None,
    background: np.ndarray | None,
    source: str,
    steps: int,
) -> np.ndarray:
    """The same air, marched through a scene."""
    if scene is None:
        raise InputError("volume: expected a SCENE.toml, got an image; it has no depth")
    _check(background, scene.size)
    distance = np.asarray(model.view.distance)
    image = air.render(
        scene, model.air, distance, source=source, steps=steps, background=background
    )
    return np.clip(image, 0, 1)


def _check(background: np.ndarray | None, size: tuple[int, int]) -> None:
    if background is not None and background.shape[:2] != tuple(size):
        raise InputError(
            f"background: expected {size[1]}x{size[0]} pixels, got "
            f"{background.shape[1]}x{background.shape[0]}"
        )
