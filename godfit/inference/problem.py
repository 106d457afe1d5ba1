"""The problem that a fit solves: a model, a picture, and which of its parameters are free."""

from __future__ import annotations

import dataclasses
import difflib
import functools
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from godfit.errors import InputError
from godfit.inference.allowances.prior import Prior
from godfit.inference.evaluate import model_at
from godfit.inference.likelihood import deviance_residuals, log_likelihood
from godfit.inference.noise import noise_of
from godfit.inference.observation import Observation, Picture
from godfit.io.image import Image
from godfit.io.sources import shrink_mask
from godfit.models.base import AbstractModel
from godfit.models.build import check_values
from godfit.runtime.guest import as_guest

MAX_VALUES = 1 << 21
"""Values (pixels times channels) of a fit, at most: more hardly change the errors, and their
derivatives would fill the memory."""
SEARCH_PIXELS = 2048
"""Pixels of a search: enough to rank minima, few enough to be evaluated in milliseconds."""
BEYOND_SCALE = 1e7
"""Levels that stand for infinity, at which an interval without an end ends: any noise is less."""


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """A model to be fitted to a picture.

    ``model`` gives the kind of model; its own parameters do not matter. ``free`` (p,) are the
    coordinates that may move, ``held`` (p,) the values of the parameters that may not, NaN where
    free. ``seed`` is that of the choice of pixels. ``most`` holds upper bounds, by name, that are
    lower than the model's own: the range of a search. ``prior`` holds what is known of parameters
    beforehand. Coordinates and parameters have the same
    names and order.

    ``point`` (p,) are the coordinates and ``noise_levels`` the noise that a search arrived at, None
    before one. With them, the problem has a ``start`` and a ``log_likelihood`` that JAX
    differentiates, for solvers and samplers of the user's own:

    >>> import godfit
    >>> problem = godfit.problem("frame.png", mask="mask.png", shader="dawntime", samples=30)
    >>> list(problem.start)
    ['exposure', 'decay', 'density', 'weight', 'light_x', 'light_y']
    >>> problem.log_likelihood(problem.start).shape
    ()
    """

    model: AbstractModel
    picture: Picture
    free: np.ndarray
    held: np.ndarray
    seed: int = 0
    most: Mapping[str, float] = dataclasses.field(default_factory=dict)
    prior: Prior = dataclasses.field(default_factory=dict)
    point: np.ndarray | None = None
    noise_levels: float | None = None

    @functools.cached_property
    def names(self) -> list[str]:
        """Names of the coordinates, in order."""
        return list(self.model.parameters)

    @functools.cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(p,) lower and (p,) upper bounds of the coordinates, float32."""
        lower, upper = self.model.bounds()
        ends = {**dict(zip(self.names, upper, strict=True)), **self.most}
        return np.asarray(lower, np.float32), np.asarray(list(ends.values()), np.float32)

    @property
    def small(self) -> Problem:
        """The same for the copy of the picture that searches work on."""
        small = self.picture.small
        scale = small.mask.shape[0] / self.picture.mask.shape[0]
        return self.replaced(picture=small, model=self.model.on_copy(scale))

    def replaced(self, **fields: Any) -> Problem:
        """The problem with other ``fields``."""
        return dataclasses.replace(self, **fields)

    def index(self, name: str) -> int:
        """The place of a coordinate. Raises ValueError where the model has none of this name."""
        return self.names.index(name)

    def is_free(self, name: str) -> bool:
        """Whether the model has a coordinate of this name and it may move."""
        return name in self.names and bool(self.free[self.index(name)])

    def holding(self, name: str, value: float) -> Problem:
        """The problem with one more parameter held."""
        free, held = self.free.copy(), self.held.copy()
        free[self.index(name)], held[self.index(name)] = False, value
        return self.replaced(free=free, held=held)

    def up_to(self, name: str, value: float) -> Problem:
        """The problem with an upper bound on a coordinate; unchanged without that coordinate."""
        return self.replaced(most={name: value}) if name in self.names else self

    def at(self, coordinates: np.ndarray) -> AbstractModel:
        """The model at ``coordinates`` (p,), with the held parameters where they are held."""
        return model_at(coordinates, self.held, self.model)

    @property
    def _known_point(self) -> np.ndarray:
        """``point``. Raises InputError before a search."""
        if self.point is None:
            raise InputError(
                "problem: expected one that a search has been through, got none; make it by "
                "godfit.problem, or take that of a result"
            )
        return self.point

    @functools.cached_property
    def _values(self) -> np.ndarray:
        """(p,) the parameters at ``point``."""
        with jax.ensure_compile_time_eval():
            return np.asarray(list(self.at(self._known_point).values().values()))

    @property
    def start(self) -> dict[str, float]:
        """The free parameters, by name, where the search arrived: on a part of the pixels where
        the picture has many."""
        moving = zip(self.names, self._values, self.free, strict=True)
        return {name: float(value) for name, value, free in moving if free}

    def residuals(self, params: Mapping[str, Any], noise_levels: Any = None) -> Float[Array, " m"]:
        """(m,) signed roots of the deviance of every value, the channels of a pixel side by side,
        and of every prior after them: half the sum of their squares is the negative log-likelihood
        up to a constant. Where noise exceeds rounding, they are (fitted - target) / noise, nearly.

        ``params`` and ``noise_levels`` are those of ``log_likelihood``. Differentiable once, by the
        parameters.
        """
        at, pixels = self._at_params(params), self._precise[1]
        noise = noise_of(self._noise(noise_levels), pixels.own_noise)
        values = deviance_residuals(pixels.predict(at), pixels.lo, pixels.hi, noise, pixels.foreign)
        return jnp.concatenate([values, self._excess(at)])

    def log_likelihood(
        self, params: Mapping[str, Any], noise_levels: Any = None
    ) -> Float[Array, ""]:
        """The log-likelihood of the picture, in the units of ``godfit.inference.likelihood``, with
        the logarithm of the priors' density up to a constant. The noise by a GPU's arithmetic is
        that of ``point``.

        **Arguments:**

        - `params`: numbers by name, those of ``start`` or some of them; the others stay where the
          search left them. Raises InputError for a name that is not among the parameters.
        - `noise_levels`: the standard deviation of the noise before rounding, in 8-bit levels; by
          default that of the search. With a GPU's arithmetic it counts from the least one on.

        Differentiable by both, twice by the parameters. It has no bounds: outside them the sum is
        evaluated as it stands. JAX's own setting decides on the precision; Hessians need
        ``jax_enable_x64``.
        """
        at, pixels = self._at_params(params), self._precise[1]
        # Infinity has no derivative by the noise.
        lo, hi = (jnp.clip(end, -BEYOND_SCALE, BEYOND_SCALE) for end in (pixels.lo, pixels.hi))
        noise = noise_of(self._noise(noise_levels), pixels.own_noise)
        values = log_likelihood(pixels.predict(at), lo, hi, noise, pixels.foreign)
        return values.sum() - 0.5 * jnp.square(self._excess(at)).sum()

    def _excess(self, at: AbstractModel) -> Float[Array, " k"]:
        """How far the parameters of the priors lie above their means, in standard deviations."""
        values = at.values()
        known = [(values[n], row) for n, row in self.prior.items() if n in values]
        return jnp.asarray([(value - mean) / sigma for value, (mean, sigma) in known], float)

    def _at_params(self, params: Mapping[str, Any]) -> AbstractModel:
        """The model with parameters (not coordinates) ``params``."""
        unknown = sorted(set(params) - set(self.names))
        if unknown:
            near = difflib.get_close_matches(unknown[0], self.names, n=1, cutoff=0.0)[0]
            raise InputError(
                f"params: expected names among {', '.join(self.names)}, got '{unknown[0]}'; "
                f"did you mean '{near}'?"
            )
        known = dict(zip(self.names, self._values, strict=True)) | dict(params)
        # Where every parameter is held, no coordinate counts.
        held = jnp.stack([jnp.asarray(known[name], float) for name in self.names])
        return self._precise[0].moved(jnp.asarray(self.point, held.dtype), held)

    def _noise(self, noise_levels: Any) -> Float[Array, ""]:
        return jnp.asarray(self.noise_levels if noise_levels is None else noise_levels, float)

    @property
    def _precise(self) -> tuple[AbstractModel, Observation]:
        """The model at ``point`` and all pixels, in JAX's present precision."""
        precision = jnp.result_type(float)
        if precision not in self._made:
            # A first call may come from within a program that is being traced.
            with jax.ensure_compile_time_eval():
                parts = self.at(self._known_point), self._allowed_for
                self._made[precision] = jax.tree.map(
                    lambda z: z.astype(precision) if eqx.is_inexact_array(z) else z, parts
                )
        return self._made[precision]

    @functools.cached_property
    def _allowed_for(self) -> Observation:
        """All pixels, with the noise that their arithmetic adds."""
        # It differentiates a problem, and so lies above this module.
        from godfit.inference.allowances.arithmetic import with_arithmetic

        pixels = self.picture.observe(pixels_used(self.picture, self.seed))
        with as_guest():
            return with_arithmetic(pixels, self, self._known_point)

    @functools.cached_property
    def _made(self) -> dict[Any, tuple[AbstractModel, Observation]]:
        return {}

    def observe(self, count: int, blur: float = 0.0) -> Observation:
        """``count`` informative pixels of the picture, blurred by ``blur`` pixels."""
        return self.picture.observe(self.picture.informative(count, self.seed), blur)


def pixels_used(picture: Picture, seed: int, max_values: int = MAX_VALUES) -> np.ndarray:
    """Sorted indices of all valid pixels, or of those in rows drawn at random where there are more
    than ``max_values`` values."""
    valid = picture.valid
    rows = max(1, max_values // (valid.shape[1] * picture.channels))
    if rows < valid.shape[0]:
        chosen = np.random.default_rng(seed).permutation(valid.shape[0])[:rows]
        only = np.zeros_like(valid)
        only[chosen] = True
        valid = valid & only
    return np.flatnonzero(valid)


def check_size(background: Image, target: Image) -> None:
    """Raise InputError for an ordinary pass of another size than the target's."""
    size, other = target.values.shape[:2], background.values.shape[:2]
    if other != size:
        raise InputError(
            f"background: expected the target's {size[1]}x{size[0]} pixels, got "
            f"{other[1]}x{other[0]}; render it at that size"
        )


def checked_picture(
    target: Image,
    mask: Image,
    background: Image | None,
    valid: np.ndarray | None,
    pass_scale: float,
    channels: int = 1,
) -> Picture:
    """Target, mask and background as one, checked against each other; see ``godfit.fit``."""
    size, values = target.values.shape[:2], mask.values
    if background is not None:
        check_size(background, target)
    values = shrink_mask(values, pass_scale)
    (h, w), (height, width) = values.shape[:2], size
    # A pass at a fraction of an odd size is rounded to whole pixels: one pixel either way.
    if abs(w * height - h * width) > max(width, height, w, h):
        raise InputError(
            f"mask: expected the target's aspect {width}:{height}, got {w}:{h}; "
            "crop or render the mask for the same frame, or fit shift and scale with --register"
        )
    if valid is not None and not valid.any():
        raise InputError("ignore: expected pixels to be left, got all of them ignored; ignore less")
    back = None if background is None else background.values
    return Picture.make(target, values, back, valid, channels)


def given_and_held(
    model: AbstractModel, fix: Mapping[str, float | None], start: Mapping[str, float]
) -> tuple[dict[str, float], np.ndarray]:
    """Values that a search starts from, by name, and (p,) those of the parameters that are held,
    NaN where free. Raises InputError for an unknown name, or a value out of range."""
    table = model.parameters
    given: dict[str, float] = {}
    for option, values in (("start", start), ("fix", fix)):
        for name, value in values.items():
            if name not in table:
                near = difflib.get_close_matches(name, table, n=1, cutoff=0.0)[0]
                raise InputError(
                    f"{option}: expected one of {', '.join(table)}, got '{name}'; "
                    f"did you mean '{near}'?"
                )
            if not model.used[list(table).index(name)]:
                used = [n for n, there in zip(table, model.used, strict=True) if there]
                raise InputError(
                    f"{option}: expected one of {', '.join(used)}, got '{name}', which this shader "
                    "does not have; leave it out"
                )
            if value is None:
                value = given.get(name, model.defaults.get(name))
            if value is None:
                raise InputError(
                    f"fix: expected {name}=VALUE, got no value; it has no default here"
                )
            given[name] = float(value)
        check_values(model, {n: given[n] for n in values}, option)
    # What the formula lacks is held where its stand-in is, so that the rest is computed with that.
    absent = {name: value for name, value in model.absent.items() if name in table}
    given |= absent
    held = [given[n] if n in fix or n in absent else np.nan for n in table]
    return given, np.array(held, np.float32)
