"""The smallest of the ladder's models that is as good as the best.

Models are compared by Akaike's and Schwarz's criteria (Burnham & Anderson, Model Selection and
Multimodel Inference, 2002, ch. 2) and by held-out pixels. The picture is cut into blocks; one half
of them is fitted and the other predicted, and the other way round. The spread of the blocks gives
the error of the difference between two models (Vuong, Econometrica 57 (1989), 307).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from godfit.errors import InputError
from godfit.fitting import fit
from godfit.inference.criteria import CLEAR, aic, bic
from godfit.inference.likelihood import log_likelihood
from godfit.inference.noise import EXPLAINED, noise_of
from godfit.inference.problem import Problem
from godfit.inference.solver import Intervals, solve_tangent
from godfit.io.sources import Source, read_source
from godfit.models.mitchell import Mitchell
from godfit.report.result import FitResult
from godfit.report.select import Row, Rung, Selection
from godfit.runtime.guest import as_guest
from godfit.runtime.parallel import parallel_map
from godfit.scattering.engines import TapNumbers, equivalents
from godfit.scenes.scene import Scene, read_scene
from godfit.scenes.view import framed, in_single_precision, light_on_screen
from godfit.studies.ladder import LADDER_VALUES, Ladder, like_noise

HELD_OUT_BLOCK = 16
"""Pixels a side of the blocks that are held out: neighbours in a block are correlated."""
HELD_OUT_VALUES = 1 << 16
"""Values that held-out pixels are drawn from, at most: they limit the time."""


def select(
    target: Source,
    *,
    mask: Source | None = None,
    scene: Scene | str | None = None,
    light: tuple[float, float] | None = None,
    fov: float | None = None,
    distance: float | np.ndarray | None = None,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Selection:
    """Fit the ladder's models and select one; arguments are those of `godfit.fit`.

    ``light`` (u, v), else the scene's, else the middle, is the position of the light in rungs that
    do not fit it. With a scene, or with ``fov`` and ``distance``, Hoffman and Preetham's daylight
    is fitted as well. Raises InputError for more than one light.

    >>> import godfit
    >>> godfit.select("frame.png", mask="mask.png", lights=2)
    Traceback (most recent call last):
    ...
    godfit.errors.InputError: select: expected lights 1, got more; it adds a second light itself
    """
    began, say = time.perf_counter(), progress or (lambda text: None)
    if options.get("lights", 1) != 1:
        raise InputError("select: expected lights 1, got more; it adds a second light itself")
    with as_guest():
        if scene is not None and not isinstance(scene, Scene):
            scene = read_scene(scene)
        source = read_source(target, options.get("transfer", "none"))
        place = (0.5, 0.5) if light is None else light
        if light is None and scene is not None:
            on_screen = light_on_screen(in_single_precision(framed(scene, source)))
            place = on_screen["light_x"], on_screen["light_y"]
        geometry = scene is not None or (fov is not None and distance is not None)
        channels = 3 if geometry else None
        base = fit(
            source,
            mask=mask,
            scene=scene,
            seed=seed,
            progress=say,
            channels=channels,
            inquire=False,
            max_values=LADDER_VALUES,
            **options,
        )
        ladder = Ladder(base, place, seed, say)
        rungs = ladder.rungs()
        say("held-out pixels")
        share = base.pixels_effective / base.pixels
        rows, chosen = _compared(rungs, ladder, share)
        daylight = None
        if geometry:
            shared = {
                k: v
                for k, v in options.items()
                if k in ("background", "valid", "transfer", "arithmetic")
            }
            daylight = fit(
                source, mask=mask, scene=scene, model="hoffman-preetham", fov=fov,
                distance=distance, channels=3, inquire=False, max_values=LADDER_VALUES, seed=seed,
                progress=say, **shared,
            )  # fmt: skip
        same = _equivalent(rows[chosen].rung, base)
    seconds = time.perf_counter() - began
    return Selection(tuple(rows), chosen, same, base, daylight, seconds)


def _compared(rungs: list[Rung], ladder: Ladder, share: float) -> tuple[list[Row], int]:
    """The rows, and the index of the recommended one. Only a ``share`` of correlated values counts
    as independent."""
    observation = ladder.observation
    values = share * len(np.asarray(observation.lo))
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    known = np.isfinite(lo) & np.isfinite(hi)
    middle = (np.where(known, lo, 0) + np.where(known, hi, 0)) / 2
    scores, sizes = zip(*parallel_map(lambda rung: _held_out(rung, ladder), rungs), strict=True)
    total = float(sizes[0].sum())
    if total == 0:
        raise InputError(
            "target: expected pixels that can be held out, got too few pixels for that; "
            "give a larger picture"
        )
    likelihoods = [share * rung.settled.log_likelihood for rung in rungs]
    bics = [bic(lk, r.parameters, values) for lk, r in zip(likelihoods, rungs, strict=True)]
    best = int(np.argmin(bics))
    rows = []
    for rung, likelihood, schwarz, score in zip(rungs, likelihoods, bics, scores, strict=True):
        behind = scores[best] - score
        error = math.sqrt(len(behind) * float(behind.var()))
        residual = np.where(known, rung.tangent.prediction - middle, 0)
        rmse = math.sqrt(float(np.square(residual).sum(dtype=np.float64)) / max(known.sum(), 1))
        rows.append(
            Row(
                rung=rung,
                rmse=rmse,
                aic=aic(likelihood, rung.parameters),
                bic=schwarz,
                held_out=float(score.sum() / total),
                behind=float(behind.sum() / total),
                behind_error=error / total,
                like_noise=like_noise(rung, observation),
            )
        )
    chosen = next(i for i, row in enumerate(rows) if i == best or _as_good(row, rows[best]))
    return rows, chosen


def _as_good(row: Row, best: Row) -> bool:
    """Whether ``row`` is within the uncertainty of ``best``."""
    if row.rung.settled.sigma <= EXPLAINED:
        # Even the rounding of every pixel is explained: a larger model cannot be better.
        return True
    # A model that gains nothing on held-out pixels is not supported by them.
    return row.bic - best.bic < CLEAR or row.behind <= 0


def _held_out(rung: Rung, ladder: Ladder) -> tuple[np.ndarray, np.ndarray]:
    """(blocks,) log-likelihood of each block's values when the other half of the blocks is fitted,
    on the rung's tangent, and how many values there are."""
    picture, observation, seed = ladder.picture, ladder.observation, ladder.seed
    w = observation.size[1]
    pixels, channels = np.asarray(observation.pixels), observation.channels
    across = -(-w // HELD_OUT_BLOCK)
    block = pixels // w // HELD_OUT_BLOCK * across + pixels % w // HELD_OUT_BLOCK
    rng = np.random.default_rng(seed)
    half = rng.permutation(int(block.max()) + 1) % 2
    block = np.repeat(block, channels)
    drawn = np.arange(len(block))
    if len(drawn) > HELD_OUT_VALUES:
        drawn = np.sort(rng.choice(len(drawn), HELD_OUT_VALUES, replace=False))
    lo, hi = np.asarray(observation.lo), np.asarray(observation.hi)
    own = None if observation.own_noise is None else np.asarray(observation.own_noise)
    count = int(block.max()) + 1
    score, size = np.zeros(count), np.zeros(count)
    for side in (0, 1):
        rows = drawn[half[block[drawn]] != side]
        others = drawn[half[block[drawn]] == side]
        if not len(rows) or not len(others):
            continue
        tangent, at = rung.tangent, rung.settled
        by = np.zeros_like(at.coordinates)
        if rung.model is None:
            # A veil has one coordinate, its level.
            by[:] = _mean(lo[rows], hi[rows]) - at.coordinates
        elif rung.free.any():
            problem = Problem(rung.model, picture, rung.free, rung.held, seed)
            walls = Intervals(lo[rows], hi[rows], own_noise=None if own is None else own[rows])
            moved = solve_tangent(at.coordinates, problem, tangent.only(rows), walls, at.sigma)
            if np.isfinite(moved.coordinates).all():
                by = moved.coordinates - at.coordinates
        levels = tangent.only(others).moved(by)
        log_likelihoods = log_likelihood(
            jnp.asarray(levels), jnp.asarray(lo[others]), jnp.asarray(hi[others]),
            jnp.asarray(noise_of(at.sigma, None if own is None else own[others]), jnp.float32),
        )  # fmt: skip
        score += np.bincount(block[others], np.asarray(log_likelihoods, np.float64), count)
        size += np.bincount(block[others], minlength=count)
    return score, size


def _mean(lo: np.ndarray, hi: np.ndarray) -> float:
    known = np.isfinite(lo) & np.isfinite(hi)
    return float(((lo + hi) / 2)[known].mean()) if known.any() else 0.0


def _equivalent(rung: Rung, base: FitResult) -> dict[str, dict[str, float]]:
    """Shaders, with their parameters, whose taps are those of the rung: they draw the same picture,
    and no picture distinguishes them. Only where decay and weight are fitted: shaders differ in the
    values they hold them at. Pictures do not depend on the order of decay and weight; they do
    depend on how a background is blended."""
    model = rung.model
    if not isinstance(model, Mitchell) or not model.convention.plain:
        return {}
    shader = model.convention
    moves = dict(zip(model.parameters, rung.free, strict=True))
    if not all(moves[name] for name in ("decay", "density", "weight") if name in shader.parameters):
        return {shader.name: rung.values}
    numbers = TapNumbers.of(model.taps[0])
    lights = {k: v for k, v in rung.values.items() if k.startswith("light")}
    found = {shader.name: rung.values | {"samples": float(model.samples)}}
    exposure = None if shader.own_pixel else float(model.exposure)
    others = equivalents(numbers, shader, base.picture.background is not None, exposure)
    for name, other in others.items():
        values = dict(other.values)
        count = values.pop("samples")
        found[name] = values | lights | {"samples": count}
    return found
