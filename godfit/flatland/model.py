"""The light in the plane as a model that ``godfit.fit`` can fit: the sky about a known canvas.

The radiance that reaches a pixel is linear in the sky, so the rays are traced once: the "mask" of
this model is ``basis(canvas, rays)``, and the picture for any sky is a product with it. Blurring or
averaging the basis is the same as blurring or averaging the picture.
"""

from __future__ import annotations

import functools
import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from godfit.flatland.canvas import MODEL_NAME, Canvas
from godfit.flatland.rays import TraceSettings, radiance_and_transmittance, steps_to_cross
from godfit.flatland.sky import Sky
from godfit.models.base import AbstractModel, Vector
from godfit.scattering.parameters import Parameter

PLANE_PARAMETERS = (
    Parameter("exposure", "E", "1", 0.0, math.inf, "scale of the whole picture"),
    Parameter(
        "sun_angle", "phi", "degrees", -math.inf, math.inf, "counterclockwise from the right"
    ),
    Parameter(
        "sun_width", "omega", "degrees", 0.1, 180.0, "how far to either side the sun reaches"
    ),
    *(
        Parameter(f"{name}_{c}", "L", "1", 0.0, math.inf, f"radiance of the {name}, {colour}")
        for name in ("sun", "sky")
        for c, colour in zip("rgb", ("red", "green", "blue"), strict=True)
    ),
)
"""The parameters, in the order of the fit's coordinates."""

FIT_RAYS = 64
"""Rays of a pixel by default: a fit traces them once, so it can do with twice those of a render."""


def basis(canvas: Canvas, rays: int) -> Float[np.ndarray, "h w channels"]:
    """(h, w, 3 + rays), float32: the radiance that a pixel has from the canvas itself, and each
    ray's share of the sky in it.

    The rays are traced in float64: one that passes a corner on the wrong side is off by a whole
    ray's share, which is enough to disturb a fit to bytes.
    """
    # The rays are compiled for the CPU, wherever else JAX runs.
    with jax.enable_x64(True), jax.default_device(jax.local_devices(backend="cpu")[0]):
        exact = Canvas(*(jnp.asarray(np.asarray(z), jnp.float64) for z in jax.tree.leaves(canvas)))
        return np.asarray(_basis(exact, rays))


@functools.partial(jax.jit, static_argnums=1)
def _basis(canvas: Canvas, rays: int):
    h, w = canvas.size
    transmittance = (1 - canvas.opacity)[..., None]
    settings = TraceSettings(rays, steps_to_cross(h, w))
    parts = transmittance * radiance_and_transmittance(canvas, settings)
    return parts.at[..., :3].add(canvas.radiance).astype(jnp.float32)


class Flatland(AbstractModel):
    """``exposure`` (), the ``sky`` and the number of rays (``samples``, not differentiated).

    Fit coordinates, one for each parameter and in their order: exposure, angle, width, exposure
    times the sun's radiance, exposure times the sky's. All but angle and width are linear.
    """

    name: ClassVar[str] = MODEL_NAME
    held_last: ClassVar[str] = "sky_g"
    product: ClassVar[tuple[str, str]] = ("exposure", "sky_g")
    banded: ClassVar[bool] = False
    channels: ClassVar[int] = 3

    exposure: Float[Array, ""]
    sky: Sky
    samples: int = eqx.field(static=True, default=FIT_RAYS)

    def __init__(self, exposure: Any = 1.0, sky: Sky | None = None, samples: int = FIT_RAYS):
        self.exposure = jnp.asarray(exposure, float)
        self.sky = Sky() if sky is None else sky
        self.samples = samples

    @property
    def light(self) -> Float[Array, "0 2"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """(0, 2): no light has a position in the picture."""
        return jnp.zeros((0, 2), self.exposure.dtype)

    @property
    def settings(self) -> dict[str, str | int | float]:
        return {"rays": self.samples}

    @property
    def parameters(self) -> dict[str, Parameter]:
        return {p.name: p for p in PLANE_PARAMETERS}

    @property
    def defaults(self) -> dict[str, float]:
        return {"exposure": 1.0}

    def values(self) -> dict[str, Float[Array, ""]]:
        sky = self.sky
        # The search may go round the circle either way.
        angle = jnp.mod(sky.angle, 360.0)
        numbers = (self.exposure, angle, sky.width, *sky.sun, *sky.sky)
        return dict(zip(self.parameters, numbers, strict=True))

    def coordinates(self) -> Float[Array, " p"]:
        sky = self.sky
        geometry = jnp.stack([self.exposure, sky.angle, sky.width])
        return jnp.concatenate([geometry, self.exposure * sky.sun, self.exposure * sky.sky])

    def moved(self, coordinates: Vector, held: Vector | None = None) -> Flatland:
        if held is None:
            held = jnp.full_like(coordinates, jnp.nan)
        geometry = jnp.where(jnp.isnan(held[:3]), coordinates[:3], held[:3])
        exposure, angle, width = geometry[0], geometry[1], geometry[2]
        # Without exposure there is no light, whatever the colours: the guard keeps 0/0 out.
        divisor = jnp.where(exposure == 0, 1.0, exposure)
        colours = jnp.where(jnp.isnan(held[3:]), coordinates[3:] / divisor, held[3:])
        sky = Sky(angle, width, colours[:3], colours[3:])
        return Flatland(exposure, sky, self.samples)

    def bounds(self) -> tuple[list[float], list[float]]:
        return [p.lower for p in PLANE_PARAMETERS], [p.upper for p in PLANE_PARAMETERS]

    def linear(self) -> np.ndarray:
        return ~np.isin(np.arange(len(PLANE_PARAMETERS)), (1, 2))

    def scales(self, coordinates: np.ndarray) -> np.ndarray:
        # Degrees: useful steps of an angle do not depend on the angle.
        size = np.abs(coordinates) * np.float32(0.1) + np.float32(1e-2)
        size[1], size[2] = 5.0, max(0.1 * abs(coordinates[2]), 1.0)
        return size.astype(np.float32)

    def ranges(self, coordinates: np.ndarray) -> np.ndarray:
        colours = np.maximum(coordinates[3:], 0.1)
        return np.concatenate([[max(coordinates[0], 0.2), 90.0, 45.0], colours])

    def __call__(
        self,
        mask: Float[Array, "h w"] | Float[Array, "h w c"],
        background: Float[Array, "..."] | None = None,
        *,
        size: tuple[int, int] | None = None,
        pixels: Int[Array, " n"] | None = None,
    ) -> Float[Array, "..."]:
        """(h, w, 3) or (n, 3), linear, not clamped. ``mask`` is ``basis(canvas, samples)``; there
        is no ``background``, and ``size`` is the canvas's."""
        if background is not None:
            raise ValueError("flatland: expected no background, got one; draw it on the canvas")
        parts = mask.reshape(-1, mask.shape[-1])
        if pixels is not None:
            parts = parts[pixels]
        around = self.exposure * self.sky.over(self.samples)
        image = self.exposure * parts[:, :3] + parts[:, 3:] @ around.astype(parts.dtype)
        return image.reshape(*(mask.shape[:2] if pixels is None else pixels.shape), 3)
