"""Shader conventions: (exposure, decay, density, weight, samples) -> taps.

Every god-ray shader in use evaluates, for a pixel x and a light l in texture coordinates,

    out(x) = c_0 M(x) + sum_{k=1..K} c_k M(x + t_k (l - x))

with its own c and t (Mitchell, GPU Gems 3, ch. 13, listing 13-1, and its descendants). In all of
them c_k is a geometric and t_k an arithmetic sequence, so that five numbers determine all taps, and
four sums every derivative (see ``godfit.scattering.radial.derivatives``).
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from godfit.errors import InputError

Scalar = Float[Array, ""] | float

UNPUBLISHED_SAMPLES = 100
"""Samples of a shader that publishes no default: the most common of the published ones."""


@dataclass(frozen=True, eq=False)
class TracedCount:
    """A number of taps that a compiled program takes at run time.

    Only methods that do not unroll the taps serve it.
    """

    value: Int[Array, ""]


# Pyright treats a count as an int: only the methods that serve a TracedCount distinguish it.
if TYPE_CHECKING:
    Count = int
else:
    Count = int | Int[Array, ""] | TracedCount


def as_count(number: Any) -> Any:
    """The ``count`` of ``Taps`` for a number that may be traced."""
    return TracedCount(number) if isinstance(number, Tracer) else number


def number_of(taps: Taps) -> Any:
    """The number of taps, traced or not, for kernels that take it at run time."""
    return taps.count.value if isinstance(taps.count, TracedCount) else taps.count


class Taps(eqx.Module):
    """Taps c_k = first * ratio**(k-1) at t_k = (k - lag) * step for k = 1..count, and c_0 = own at
    t_0 = 0. The lag of every shader is 0; that of merged taps, each in place of several, is not.

    ``count`` is a Python number or, inside a program that serves every number, a ``TracedCount``.
    ``unit`` is that of ``step``: ``"ray"``, a fraction of the way from the pixel to the light (0 at
    the pixel, 1 at the light), or ``"uv"``, a distance in texture coordinates. With ``"uv"`` taps
    beyond the light have no weight.

    >>> import godfit
    >>> (taps,) = godfit.CONVENTIONS["dawntime"].taps(0.1, 0.5, 0.8, 1.0, 4)
    >>> [round(float(t), 3) for t in taps.t], [round(float(c), 4) for c in taps.c]
    ([0.2, 0.4, 0.6], [0.05, 0.025, 0.0125])
    """

    own: Scalar
    first: Scalar
    ratio: Scalar
    step: Scalar
    count: Count = eqx.field(static=True)
    unit: Literal["ray", "uv"] = eqx.field(static=True, default="ray")
    lag: Scalar = 0.0

    @property
    def c(self) -> Float[Array, " count"]:
        """Weights c_1..c_K."""
        return self.first * jnp.asarray(self.ratio) ** jnp.arange(self.count)

    @property
    def t(self) -> Float[Array, " count"]:
        """Positions t_1..t_K in ``unit``."""
        return jnp.asarray(self.step) * (jnp.arange(1, self.count + 1) - self.lag)

    @property
    def end(self) -> Scalar:
        """Position of the last tap in ``unit``."""
        return self.step * (self.count - self.lag)

    @property
    def total(self) -> Float[Array, ""]:
        """c_0 + sum c_k: the sum over a mask that is 1 everywhere."""
        return self.own + self.c.sum()


def averaging_taps(samples: Count) -> Taps:
    """Taps whose sum is the mean of the mask over ``samples`` equal steps from pixel to light.

    For a mask that is 1 where the sky is visible this mean is 1 - D, the unoccluded share of the
    ray (Mitchell, GPU Gems 3, ch. 13, equation 3).
    """
    return Taps(0.0, 1 / samples, 1.0, 1 / samples, as_count(samples))


@dataclass(frozen=True)
class Convention:
    """The formula of one shader, from its parameters to taps.

    Most are g E (own M + w sum_{i=1..n-drop} d^(i-order) M_i), with the exposure E, weight w, decay
    d and number of samples n; g is ``gain``. ``own`` is 0 in a shader without the pixel's own
    value, ``drop`` the number of samples that its loop leaves out, and ``order`` 1 where decay is
    applied after a tap, 0 where before.

    A ``box`` convention runs a pass of equal weights for each of its steps (in texture coordinates)
    on 1 - M, one after another, and its light pass is E (1 - result). ``blend`` is how the light
    pass L is composited onto the background B: ``"add"`` is background_gain * B + L, ``"screen"``
    is B + L - B L. ``pass_scale`` is the size of the light pass relative to the picture, where
    nothing else is known.

    ``defaults`` are the published default parameters by name, none where none are published.
    ``density_slider`` is where the slider of density ends in the published program, None where
    none is published.

    Texture coordinates are those of GLSL, v up. In HLSL v runs down; that changes the light's v to
    1 - v and no tap, because taps lie on straight lines to the light.
    """

    name: str
    formula: str
    own: float = 1.0
    drop: int = 0
    order: int = 1
    gain: float = 1.0
    box: tuple[float, ...] = ()
    defaults: dict[str, float] = field(default_factory=dict)
    blend: Literal["add", "screen"] = "add"
    background_gain: float = 1.0
    density_slider: float | None = None
    pass_scale: float = 1.0
    remarks: str = ""

    def taps(
        self, exposure: Scalar, decay: Scalar, density: Scalar, weight: Scalar, samples: Count
    ) -> tuple[Taps, ...]:
        """The taps of each pass. Those of a ``box`` convention do not include the exposure."""
        if self.box:
            return tuple(Taps(1 / 6, 1 / 6, 1.0, step, 5, "uv") for step in self.box)
        scale = self.gain * jnp.asarray(exposure)
        first = scale * weight * jnp.asarray(decay) ** (1 - self.order)
        count = as_count(samples - self.drop)
        return (Taps(self.own * scale, first, decay, density / samples, count),)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of those of exposure, decay, density and weight that the formula uses."""
        return ("exposure",) if self.box else ("exposure", "decay", "density", "weight")

    @property
    def samples(self) -> int:
        """The shader's default number of samples."""
        return int(self.defaults.get("samples", UNPUBLISHED_SAMPLES))

    @property
    def own_pixel(self) -> bool:
        """Whether the pixel's own value enters: without it, only exposure*weight is determined."""
        return self.own != 0


def _defaults(exposure: float, decay: float, density: float, weight: float, samples: int):
    return {
        "exposure": exposure,
        "decay": decay,
        "density": density,
        "weight": weight,
        "samples": samples,
    }


EQUATION_4 = "equation 4 of the slides divides by n: E there is n times E here"
"""What both decks' formula has and neither shader: a fitted exposure is that of the shader."""
CONVENTIONS: dict[str, Convention] = {
    c.name: c
    for c in (
        Convention(
            "mitchell",
            "B + E (M + w sum_{i=1..n} d^(i-1) M_i)",
            remarks="GPU Gems 3, ch. 13; no defaults published, 100 samples assumed",
        ),
        Convention(
            "dawntime",
            "B + E (M + w sum_{i=1..n-1} d^i M_i)",
            drop=1,
            order=0,
            defaults=_defaults(0.05, 0.99, 0.8, 0.8, 200),
            density_slider=1.0,
            pass_scale=0.5,
            remarks=f"decay before use; light pass at half resolution by default; {EQUATION_4}",
        ),
        Convention(
            "vesper",
            "B + E (M + w sum_{i=1..n-1} d^(i-1) M_i)",
            drop=1,
            defaults=_defaults(0.05, 0.99, 0.8, 0.8, 150),
            density_slider=1.0,
            pass_scale=0.5,
            remarks=f"decay after use; light pass at half resolution by default; {EQUATION_4}",
        ),
        Convention(
            "article-glsl",
            "1.1 B + .4 E (M + w sum_{i=1..n} d^(i-1) M_i)",
            gain=0.4,
            defaults=_defaults(0.2, 0.96815, 0.926, 0.58767, 100),
            background_gain=1.1,
            remarks="the last line of the article; its second listing, B + .4 (M + w sum), is "
            "mitchell with E = .4, and its first the same without B",
        ),
        Convention(
            "article-hlsl",
            "1.1 B + .4 E (M + w sum_{i=1..n} d^(i-1) M_i)",
            gain=0.4,
            defaults=_defaults(0.92, 0.97815, 0.966, 0.58767, 100),
            background_gain=1.1,
            remarks="v runs down in D3D: give a light so measured with --light-origin top",
        ),
        Convention(
            "babylon",
            "1.1 B + .4 E (M + w sum_{i=1..n} d^(i-1) M_i)",
            gain=0.4,
            defaults=_defaults(0.3, 0.96815, 0.926, 0.58767, 100),
            background_gain=1.1,
            remarks="VolumetricLightScatteringPostProcess",
        ),
        Convention(
            "pmndrs",
            "screen(B, E w sum_{i=1..n} d^(i-1) M_i)",
            own=0.0,
            defaults=_defaults(0.6, 0.9, 0.96, 0.4, 60),
            blend="screen",
            remarks="GodRaysEffect; no own-pixel tap: only exposure*weight is determined",
        ),
        Convention(
            "three",
            "B + E (1 - box_3 box_2 box_1 (1 - M)), box_p: 6 taps, step 6^-p",
            box=(6.0**-1, 6.0**-2, 6.0**-3),
            defaults={"exposure": 0.69, "samples": 18},
            remarks="Sousa, CryEngine 2; no decay, density or weight",
        ),
    )
}


ENGINE_NAMES = {
    "godrayseffect": "pmndrs", "godrays": "pmndrs", "postprocessing": "pmndrs",
    "reactpostprocessing": "pmndrs", "threejs": "three", "sousa": "three", "cryengine": "three",
    "babylonjs": "babylon", "volumetriclightscattering": "babylon",
    "volumetriclightscatteringpostprocess": "babylon", "gpugems": "mitchell",
    "gpugems3": "mitchell", "mitchell2007": "mitchell", "article": "article-glsl",
    "irrlicht": "article-glsl",
}  # fmt: skip
"""Conventions by the names that engines, effects and books have, without case and punctuation."""
UNLIKE = {
    "unreal": "its light shafts are three passes of a mean over twelve taps",
    "unrealengine": "its light shafts are three passes of a mean over twelve taps",
    "unity": "its sun shafts are passes of a mean over six taps",
    "godot": "its rays are a mean of jittered taps to a power",
    "blender": "its sun beams fall off with the square of the distance along the ray",
}
"""What conventions lack for engines whose sums are others."""


def convention(name: str) -> Convention:
    """The convention of this name, or of the engine or effect of this name. Raises InputError for
    an unknown one, naming the closest."""
    if name in CONVENTIONS:
        return CONVENTIONS[name]
    plain = re.sub("[^a-z0-9]", "", name.lower())
    if plain in ENGINE_NAMES or plain in CONVENTIONS:
        return CONVENTIONS[ENGINE_NAMES.get(plain, plain)]
    expected = f"shader: expected one of {', '.join(CONVENTIONS)}, got '{name}'"
    if plain in UNLIKE:
        raise InputError(f"{expected}: {UNLIKE[plain]}; mitchell is the nearest, in shape alone")
    closest = difflib.get_close_matches(name, CONVENTIONS, n=1, cutoff=0.0)
    raise InputError(f"{expected}; did you mean '{closest[0]}'?")
