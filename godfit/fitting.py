"""The fit: screen, climb, settle on every pixel, and say what the answer is worth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from godfit import inputs, search
from godfit.inference import Evidence, Misfit, evidence, misfit, undetermined
from godfit.inputs import Source
from godfit.models import Mitchell, Vector
from godfit.observation import LEVELS, Observation, Picture
from godfit.parameters import is_light
from godfit.result import Estimate, FitResult
from godfit.screen import starts
from godfit.timing import compile_seconds

STARTS = 6
# More values than this say nothing new, and their derivatives would fill the memory.
MAX_VALUES = 1 << 21
# Log-likelihood on the subset by which a point may fall behind and still be tried on all pixels.
DOUBT = 8.0
CANDIDATES = 3
MAX_DIPS = 5
MAX_RESEEDS = 3


def fit(
    target: Source,
    *,
    mask: Source,
    background: Source | None = None,
    shader: str = "mitchell",
    samples: int | None = None,
    lights: int = 1,
    pass_scale: float = 1.0,
    fix: Mapping[str, float | None] | None = None,
    start: Mapping[str, float] | None = None,
    valid: np.ndarray | None = None,
    transfer: str = "none",
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> FitResult:
    """Fit a shader's parameters and the light's position to an image.

    **Arguments:**

    - `target`: a file, an `Image`, or an array (h, w) or (h, w, 3), row 0 at the top; arrays of
      integers are bytes (or 16-bit words), of floats linear values without rounding.
    - `mask`: the occlusion mask the scattering pass reads; linear, same aspect. A smaller one means
      a light pass at lower resolution.
    - `background`: the ordinary pass that the light is laid on, as large as the target.
    - `shader`, `samples`: a name in `godfit.taps.CONVENTIONS`; its own default number of samples.
    - `lights`: how many lights are summed.
    - `pass_scale`: the size of the light pass against the mask's, at most 1.
    - `fix`: parameters held, at a value or (None) at the start or the shader's default.
    - `start`: parameters to start from. None is needed.
    - `valid`: (h, w), False where the target is to be ignored.
    - `transfer`: `"none"` or `"srgb"`, how the target (and the background) were encoded.
    - `seed`: of the choice of pixels.
    - `progress`: is called with a line of text as the fit goes on.

    **Returns:** a `FitResult`. Raises `InputError`, a ValueError of one line, for input that cannot
    be fitted.
    """
    with jax.enable_x64(False):
        # The program is one of float32, whatever the caller has set.
        return _fit(
            target, mask, background, shader, samples, lights, pass_scale, fix or {}, start or {},
            valid, transfer, seed, progress or (lambda text: None),
        )  # fmt: skip


def _fit(
    target: Source,
    mask: Source,
    background: Source | None,
    shader: str,
    samples: int | None,
    lights: int,
    pass_scale: float,
    fix: Mapping[str, float | None],
    start: Mapping[str, float],
    valid: np.ndarray | None,
    transfer: str,
    seed: int,
    say: Callable[[str], None],
) -> FitResult:
    began, compiled = time.perf_counter(), compile_seconds()
    images = {"target": inputs.image(target, transfer), "mask": inputs.image(mask, "none")}
    if background is not None:
        images["background"] = inputs.image(background, transfer)
    picture = inputs.picture(
        images["target"], images["mask"], images.get("background"), valid, pass_scale
    )
    notes = tuple(f"{role}: {note}" for role, im in images.items() for note in im.notes)
    files = {role: {"path": im.path, "sha256": im.sha256} for role, im in images.items()}
    # What the picture does not need of them would stay in memory to the end.
    del images, target, mask, background
    model = inputs.template(shader, samples, lights)
    given, held = inputs.parameters(model, fix, start)
    names = list(model.parameters)
    used = np.array([is_light(n) or n in model.convention.parameters for n in names])
    free = np.isnan(held) & used
    open_: list[tuple[int, list[int]]] = []
    if not model.convention.own_pixel and free[0] and free[3]:
        # No pixel shows its own value: exposure and weight act only through their product.
        held[0] = given.get("exposure", model.convention.defaults["exposure"])
        free[0] = False
        open_.append((0, [3]))

    say("screening")
    begun = starts(picture.small, model, given, keep=STARTS, seed=seed)
    candidates = [begun[0]]
    if free.any():
        coordinates = search.climb(picture.small, model, begun, free, held, seed, say).coordinates
        candidates = _subset(picture, model, coordinates, free, held, seed, say)
    pixels = _pixels(picture, seed)
    seen = picture.observe(pixels)
    say(f"all {len(pixels):,} pixels")
    settled, tangent = max(
        (search.settle(z, model, seen, free, held) for z in candidates),
        key=lambda found: found[0].log_likelihood,
    )
    settled, tangent = _next_dips(settled, tangent, model, seen, free, held)
    at = evidence(settled, tangent, seen)
    more = undetermined(
        at.blunt, model.ranges(settled.coordinates), free, keep=names.index("weight")
    )
    if more:
        open_ += more
        coordinates = settled.coordinates.copy()
        for index, _ in more:
            free[index] = False
        if not free[0] and free[3]:
            # Exposure has wandered on noise, and weight with it: back to what a user would expect.
            default = model.convention.defaults.get("exposure", coordinates[0])
            coordinates[0] = given.get("exposure", default)
        settled, tangent = search.settle(coordinates, model, seen, free, held)
        at = evidence(settled, tangent, seen)
    return _result(
        settled,
        at,
        picture,
        pixels,
        seen,
        model,
        free,
        held,
        used,
        open_,
        notes,
        files,
        {"compile": compile_seconds() - compiled, "solve": time.perf_counter() - began},
    )


def _subset(
    picture: Picture,
    model: Mitchell,
    coordinates: np.ndarray,
    free: np.ndarray,
    held: np.ndarray,
    seed: int,
    say: Callable[[str], None],
) -> list[np.ndarray]:
    """Sharp images, a few thousand pixels: the best point, and where density is in doubt, those
    that all pixels must decide between."""
    seen = picture.observe(picture.informative(search.PIXELS, seed))
    settled, tangent = search.settle(coordinates, model, seen, free, held)
    along, dip, doubtful = _dips(settled, tangent, model, seen, free)
    if not doubtful and settled.sigma < 2 * search.SIGMAS[0]:
        return [settled.coordinates]
    say("other densities")
    found = search.reseed(settled, along, model, picture, free, held, seed)
    for _ in range(MAX_RESEEDS):
        best = found[0]
        if best.sigma < search.EXPLAINED or _like_noise(best, model, seen, held):
            break
        again = search.correct(best.coordinates, model, picture, free, held, seed)
        again, _ = search.settle(again, model, seen, free, held)
        if again.log_likelihood < best.log_likelihood:
            again = best
        found = search.reseed(again, along, model, picture, free, held, seed)
        if found[0].log_likelihood < best.log_likelihood + 1:
            break
    close: list[search.Settled] = []
    for other in found:
        apart = all(abs(other.coordinates[along] - c.coordinates[along]) > dip / 20 for c in close)
        if apart and other.log_likelihood > found[0].log_likelihood - DOUBT:
            close.append(other)
    return [c.coordinates for c in close[:CANDIDATES]]


def _like_noise(at: search.Settled, model: Mitchell, seen: Observation, held: np.ndarray) -> bool:
    fitted = model.moved(jnp.asarray(at.coordinates), jnp.asarray(held))
    return misfit(np.asarray(seen.predict(fitted)), seen).like_noise


def _dips(
    settled: search.Settled,
    tangent: search.Tangent,
    model: Mitchell,
    seen: Observation,
    free: np.ndarray,
) -> tuple[int, float, bool]:
    """Index of density, the distance between two dips of the cost in it (one band, a shift of the
    rays' end by one tap), and whether its error is wide enough for another dip to be the right one.
    """
    along = list(model.parameters).index("density")
    dip = float(settled.coordinates[along]) / model.samples
    variance = evidence(settled, tangent, seen).covariance(free)[along, along]
    return along, dip, bool(free[along] and variance > (dip / 20) ** 2)


def _next_dips(
    settled: search.Settled,
    tangent: search.Tangent,
    model: Mitchell,
    seen: Observation,
    free: np.ndarray,
    held: np.ndarray,
) -> tuple[search.Settled, search.Tangent]:
    """From dip to dip, both ways, as long as the likelihood gains."""
    along, dip, doubtful = _dips(settled, tangent, model, seen, free)
    if not doubtful:
        return settled, tangent
    covariance = evidence(settled, tangent, seen).covariance(free)
    follow = covariance[:, along] / covariance[along, along]
    for way in (-dip, dip):
        for _ in range(MAX_DIPS):
            start = (settled.coordinates + way * follow).astype(np.float32)
            other = search.settle(start, model, seen, free, held)
            if other[0].log_likelihood <= settled.log_likelihood + 0.5:
                break
            settled, tangent = other
    return settled, tangent


def _pixels(picture: Picture, seed: int) -> np.ndarray:
    """All valid pixels, or those of rows drawn at random where there are too many."""
    valid = picture.valid
    rows = max(1, MAX_VALUES // (valid.shape[1] * picture.channels))
    if rows < valid.shape[0]:
        chosen = np.random.default_rng(seed).permutation(valid.shape[0])[:rows]
        only = np.zeros_like(valid)
        only[chosen] = True
        valid = valid & only
    return np.flatnonzero(valid)


def _result(
    settled: search.Settled,
    at: Evidence,
    picture: Picture,
    pixels: np.ndarray,
    seen: Observation,
    model: Mitchell,
    free: np.ndarray,
    held: np.ndarray,
    used: np.ndarray,
    open_: list[tuple[int, list[int]]],
    notes: tuple[str, ...],
    files: dict[str, dict[str, str]],
    timing: dict[str, float],
) -> FitResult:
    names = list(model.parameters)
    opened = [i for i, _ in open_]
    z = np.where(np.isnan(held), settled.coordinates, held)
    z = np.where(np.isin(np.arange(len(names)), opened), z, settled.coordinates)
    # An open parameter is held only for want of better: what it would move is not known either.
    loose = np.where(np.isin(np.arange(len(names)), opened), np.nan, held).astype(np.float32)
    fitted, values, by_coordinate = _parameters(model, z.astype(np.float32), loose)
    values, by_coordinate = np.asarray(values), np.asarray(by_coordinate, np.float64)
    # The pixels of an upsampled pass share its texels and say no more than these.
    low, full = np.prod(picture.mask.shape[:2]), np.prod(picture.size)
    by_pixel = at.covariance(free) * (full / low)
    covariance = by_coordinate @ by_pixel @ by_coordinate.T
    # A parameter that an open coordinate would change is not known, however well the rest is.
    unknown = (
        (np.abs(by_coordinate[:, opened]) > 0).any(1) if opened else np.zeros(len(names), bool)
    )
    unknown |= np.isin(np.arange(len(names)), opened) | (np.diag(covariance) <= 0)
    stderr = np.sqrt(np.where(unknown, np.nan, np.diag(covariance)))
    covariance[unknown] = covariance[:, unknown] = np.nan
    lower, upper = (np.asarray(b, np.float32) for b in model.bounds())
    # Within its error of a bound, a value is as good as on it.
    error = np.sqrt(np.diag(by_pixel))
    at_bound = (settled.coordinates - lower <= error) | (upper - settled.coordinates <= error)
    params = {
        name: Estimate(
            float(values[i]),
            None if unknown[i] else float(stderr[i]),
            fixed=bool(not np.isnan(held[i]) and i not in opened),
            at_bound=bool(free[i] and at_bound[i]),
        )
        for i, name in enumerate(names)
        if used[i]
    }
    target = picture.levels.reshape(-1, picture.channels)[pixels].reshape(-1)
    error = np.clip(at.prediction, 0, LEVELS) - target
    rmse = float(np.sqrt(np.mean(error.astype(np.float64) ** 2)))
    left = misfit(at.prediction, seen)
    # A pass that is upsampled was rounded once before.
    allowed = search.WITHIN_ROUNDING * (2 if low < full else 1)
    trusted = settled.sigma <= allowed or left.like_noise
    converged = trusted and settled.quiet
    return FitResult(
        converged=converged,
        message=_message(settled, trusted, left),
        model=fitted,
        params=params,
        covariance=covariance,
        correlations=_correlations(names, covariance),
        undetermined=_sentences(open_, names, values),
        notes=notes,
        noise_levels=settled.sigma,
        rmse_levels=rmse,
        psnr_db=float(20 * np.log10(LEVELS / max(rmse, 1e-6))),
        pixels=len(pixels),
        pixels_clipped=int((picture.clipped() & picture.valid).sum()),
        residual_correlation=left.correlation,
        residual_tails=left.tails,
        log_likelihood=settled.log_likelihood,
        timing_s=timing | {"solve": timing["solve"] - timing["compile"]},
        picture=picture,
        inputs=files,
    )


@eqx.filter_jit
def _parameters(model: Mitchell, coordinates: Vector, held: Vector):
    """The model at ``coordinates``, its parameters (p,), their derivatives (p, p) by coordinate."""

    def values(z):
        return jnp.stack(list(model.moved(z, held).values().values()))

    return model.moved(coordinates, held), values(coordinates), jax.jacfwd(values)(coordinates)


def _message(settled: search.Settled, trusted: bool, left: Misfit) -> str:
    if not trusted:
        return (
            f"the residual is not noise (of {settled.sigma:.2f} levels, neighbours correlated by "
            f"{left.correlation:.2f}, tails of {left.tails:.1f} where noise has 3): the shader, "
            "mask or transfer may be another, or the best point was missed; try --start"
        )
    if not settled.quiet:
        return "the steps had not died down when the fit stopped; try --start near this answer"
    return "converged"


def _correlations(names: list[str], covariance: np.ndarray) -> dict[str, float]:
    """Correlations above 0.1 in size, largest first."""
    size = np.sqrt(np.diag(covariance))
    pairs = {
        f"{names[i]},{names[j]}": float(covariance[i, j] / (size[i] * size[j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if np.isfinite(covariance[i, j]) and size[i] > 0 and size[j] > 0
    }
    ordered = sorted(pairs.items(), key=lambda item: -abs(item[1]))
    return {pair: value for pair, value in ordered if abs(value) > 0.1}


def _sentences(
    open_: list[tuple[int, list[int]]], names: list[str], values: np.ndarray
) -> tuple[str, ...]:
    """What is left open, in words."""
    opened = [index for index, _ in open_]
    said, alone = [], []
    for index, partners in open_:
        rest = [names[i] for i in partners if i not in opened]
        if names[index] == "exposure" and 3 not in opened:
            product = values[0] * values[3]
            said.append(f"only exposure*weight is determined ({product:.6g})")
        elif rest:
            together = " and ".join([names[index], *rest])
            said.append(f"only a combination of {together} is determined")
        else:
            alone.append(index)
            continue
        said[-1] += f"; {names[index]} was held at {values[index]:.6g}"
    if alone:
        held = ", ".join(f"{names[i]} (held at {values[i]:.6g})" for i in alone)
        said.append(f"not determined by this picture: {held}")
    return tuple(said)
