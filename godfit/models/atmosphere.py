"""Air and haze: the analytic daylight model of Hoffman and Preetham.

Rendering Outdoor Light Scattering in Real Time (GDC 2002): a sun of irradiance E, scattered once in
air of one density, over a distance s at an angle theta from the sun:

    L(s, theta) = L_0 F + E beta(theta) / beta_ex (1 - F),    F = exp(-beta_ex s)

with beta_ex = beta_R + beta_M, molecules (Rayleigh) and haze (Mie). The coefficients are those of
Preetham, Shirley & Smits (SIGGRAPH 1999), appendices A.3 and A.1, at three wavelengths that stand
for red, green and blue. What differs from the published demo: its Mie lobe does not integrate to
one (``phase="published"`` reproduces it), and it shrinks Mie's coefficient, some 270 times that of
later models, by about a thousand (``Air.haze``).
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.errors import InputError

WAVELENGTHS = (650.0, 570.0, 475.0)
"""Wavelengths that stand for red, green and blue, in nanometres."""
REFRACTIVE_INDEX = 1.0003
"""Refractive index of air (Preetham et al., A.3)."""
MOLECULES = 2.545e25
"""Molecules in a cubic metre of air (Preetham et al., A.3)."""
DEPOLARISATION = 0.035
"""Depolarisation factor of air (Preetham et al., A.3)."""
MIE_K = (0.685, 0.679, 0.670)
"""K of haze, for each wavelength (Preetham et al., table 2)."""
MIN_TURBIDITY = 0.995
"""Least turbidity: below it the concentration of haze would be negative (6.544 T - 6.51)."""
PHASES = ("normalised", "published")
"""Phase functions of haze: one that integrates to one, and that of the published demo."""
SHORT_PATH = 1e-3
"""Optical depth below which ``path_transmission`` is a series: (1 - exp(-x))/x cancels there."""

Scalar = Float[Array, ""] | float


def rayleigh() -> np.ndarray:
    """(3,) scattering coefficient of molecules, 1/m."""
    metres = np.array(WAVELENGTHS) * 1e-9
    p = DEPOLARISATION
    size = 8 * np.pi**3 * (REFRACTIVE_INDEX**2 - 1) ** 2 * (6 + 3 * p) / (6 - 7 * p)
    return size / (3 * MOLECULES * metres**4)


def mie(turbidity: Scalar) -> Float[Array, "3"]:
    """(3,) scattering coefficient of haze, 1/m, as published; see ``Air.haze``."""
    concentration = (6.544 * jnp.asarray(turbidity, float) - 6.51) * 1e-17
    metres = np.array(WAVELENGTHS) * 1e-9
    return concentration * (0.434 * np.pi * (2 * np.pi / metres) ** 2 * np.array(MIE_K))


def rayleigh_phase(cos: Float[Array, "..."]) -> Float[Array, "..."]:
    """Phase function of molecules, 1/sr, for the cosine of the scattering angle; it integrates to
    one."""
    return 3 / (16 * np.pi) * (1 + cos**2)


def henyey_greenstein(cos: Float[Array, "..."], g: Scalar) -> Float[Array, "..."]:
    """Phase function of haze, 1/sr, for the cosine of the scattering angle; it integrates to one.
    The mean cosine ``g`` lies between -1 and 1, above 0 for a lobe towards the sun (Henyey &
    Greenstein, Astrophys. J. 93 (1941), 70)."""
    return (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cos) ** 1.5)


def air_mass(zenith: Scalar) -> Float[Array, ""]:
    """Relative length of sunlight's path through the air, 1 from the zenith; ``zenith`` in radians,
    0 to pi/2 (Kasten's formula; Preetham et al., A.1)."""
    degrees = jnp.rad2deg(jnp.asarray(zenith, float))
    return 1 / (jnp.cos(zenith) + 0.15 * (93.885 - degrees) ** -1.253)


def sunlight(turbidity: Scalar, zenith: Scalar) -> Float[Array, "3"]:
    """(3,) share of the sun's light that reaches the ground; ``zenith`` in radians (Preetham et
    al., A.1)."""
    micrometres = np.array(WAVELENGTHS) * 1e-3
    haze = 0.04608365822050 * jnp.asarray(turbidity, float) - 0.04586025928522
    depth = 0.008735 * micrometres**-4.08 + haze * micrometres**-1.3
    return jnp.exp(-air_mass(zenith) * depth)


def zenith_angle(sun: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, ""]:
    """Angle in radians between the unit vectors ``sun`` and ``up``; a sun below the horizon counts
    as one on the horizon."""
    across = jnp.cross(sun, up)
    squared = across @ across
    # At the zenith the angle has no derivative; here it is zero.
    safe = jnp.where(squared > 0, squared, 1.0)
    sine = jnp.where(squared > 0, jnp.sqrt(safe), 0.0)
    return jnp.arctan2(sine, jnp.maximum(sun @ up, 0.0))


def path_transmission(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """(1 - exp(-x)) / x, 1 at 0: the mean transmission from the points of a path of optical depth x
    to its end."""
    small = jnp.abs(x) < SHORT_PATH
    safe = jnp.where(small, 1.0, x)
    series = 1 - x / 2 + x**2 / 6 - x**3 / 24
    return jnp.where(small, series, -jnp.expm1(-safe) / safe)


def by_channel(channels: Float[Array, "3"], x: Float[Array, "..."]) -> Float[Array, "... 3"]:
    """The outer product of x and one number for each channel."""
    return x[..., None] * channels.reshape((1,) * x.ndim + (3,))


class Air(eqx.Module):
    """Air with haze in it, by channel.

    ``turbidity`` is 2 for clear air, 6 and more for hazy air; ``g`` is the haze's mean cosine.
    ``e_sun`` is the sun's irradiance above the air, in units that make a radiance of 1 the
    brightest level. ``scale`` is the metres of air in a unit of distance. ``haze`` multiplies Mie's
    coefficient: .001 gives that of later models (Bruneton & Neyret 2008; Hillaire 2020). ``phase``
    is ``"normalised"``, or ``"published"`` for that of the demo, whose haze scatters 2/K times too
    much. Raises InputError for another phase.
    """

    turbidity: Float[Array, ""]
    g: Float[Array, ""]
    e_sun: Float[Array, ""]
    scale: Float[Array, ""]
    haze: float = eqx.field(static=True, default=1e-3)
    phase: str = eqx.field(static=True, default="normalised")

    def __init__(
        self,
        turbidity: Scalar = 2.0,
        g: Scalar = 0.76,
        e_sun: Scalar = 1.0,
        scale: Scalar = 1.0,
        haze: float = 1e-3,
        phase: str = "normalised",
    ):
        if phase not in PHASES:
            raise InputError(f"phase: expected one of {', '.join(PHASES)}, got '{phase}'")
        self.turbidity, self.g = jnp.asarray(turbidity, float), jnp.asarray(g, float)
        self.e_sun, self.scale = jnp.asarray(e_sun, float), jnp.asarray(scale, float)
        self.haze, self.phase = haze, phase

    @property
    def beta_r(self) -> Float[Array, "3"]:
        """Rayleigh's scattering coefficient, per unit of distance."""
        return self.scale * jnp.asarray(rayleigh(), self.scale.dtype)

    @property
    def beta_m(self) -> Float[Array, "3"]:
        """Mie's scattering coefficient, per unit of distance."""
        return self.scale * (self.haze * mie(self.turbidity))

    @property
    def beta_ex(self) -> Float[Array, "3"]:
        """Extinction coefficient, per unit of distance: nothing is absorbed."""
        return self.beta_r + self.beta_m

    def scattered(self, cos: Float[Array, "..."]) -> Float[Array, "... 3"]:
        """beta(theta), per unit of distance and steradian; ``cos`` is that of the angle from the
        sun."""
        beta_m = self.beta_m
        if self.phase == "published":
            beta_m = beta_m * (2 / np.array(MIE_K))
        molecules, haze = rayleigh_phase(cos), henyey_greenstein(cos, self.g)
        return by_channel(self.beta_r, molecules) + by_channel(beta_m, haze)

    def transmitted(self, distance: Float[Array, "..."]) -> Float[Array, "... 3"]:
        """F, the share of light that passes ``distance``."""
        return jnp.exp(-by_channel(self.beta_ex, distance))

    def inscattered(
        self, distance: Float[Array, "..."], cos: Float[Array, "..."], zenith: Scalar
    ) -> Float[Array, "... 3"]:
        """Radiance that the air adds over ``distance``, with the sun at ``zenith`` (radians)."""
        sun = self.e_sun * sunlight(self.turbidity, zenith)
        # (1 - F)/beta_ex would be 0/0 without air, or over no distance.
        path = distance[..., None] * path_transmission(by_channel(self.beta_ex, distance))
        return by_channel(sun, jnp.ones_like(cos)) * self.scattered(cos) * path


def hoffman_preetham(
    air: Air,
    distance: Float[Array, "..."],
    cos: Float[Array, "..."],
    zenith: Scalar,
    surface: Float[Array, "..."] | float = 0.0,
) -> Float[Array, "... 3"]:
    """Radiance L(s, theta) of a surface at ``distance`` with radiance ``surface`` (L_0, three
    channels or a number); ``cos`` is that of the angle between the view and the sun."""
    return surface * air.transmitted(distance) + air.inscattered(distance, cos, zenith)
