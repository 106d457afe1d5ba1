"""Which convention and how many samples made a picture, and whether a fit's are the right ones.

``comparison.py`` has the sums over taps. What is no such sum is searched by itself.
"""

from __future__ import annotations

import numpy as np

from godfit.errors import Remark
from godfit.inference.fitted import Found
from godfit.inference.information import misfit
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import tangent_at
from godfit.inference.strategy import Effort, stages, starting_points
from godfit.io.image import LEVELS
from godfit.io.jpeg import was_jpeg
from godfit.models.build import mitchell_template
from godfit.models.mitchell import Mitchell
from godfit.scattering.conventions import CONVENTIONS, Convention, convention
from godfit.scattering.forms import Named, form_of
from godfit.search import density_minima, multigrid
from godfit.search.comparison import (
    CLEAR_GAIN,
    FREE_NUMBER,
    GENERAL_SUM,
    Comparison,
    Explained,
    best_first,
)

CLEAR_SHARE = 0.5
"""Share of the noise that a clearly better convention leaves at most, where the residual is no
white noise: correlated errors make likelihoods differ by far more than they mean."""
FAINT_LEVELS = 0.1
"""Levels of a white pixel's own value up to which there is none: shaders that have one show far
more, as exposure alone sets it."""
NO_OWN_PIXEL = (
    "no pixel shows its own value, which {} adds (exposure is 0): give --shader pmndrs, or auto, "
    "which finds a shader without it"
)
"""Objection with the shader."""
TIED = 3.0
"""Difference in log-likelihood within which two conventions are tied: odds of twenty."""
SMALLER_PASS = 0.5
"""Size of a smaller light pass against the mask: that of every engine that has one by default."""


def identified(
    problem: Problem, given: dict[str, float], effort: Effort, samples: int | None = None
) -> list[Explained]:
    """Every convention that could have made the picture of a ``problem`` of the general sum, best
    first. Where no sum over the whole mask explains it, the rival's smaller light pass is tried,
    and where none does so either, compositions of several sums. Sums that differ from the general
    one in what they read, or in the places of their taps, are tried wherever more than rounding is
    left."""
    found = _sums(problem, given, effort, samples)
    if effort.rival is not None and not _is_explained(found):
        effort.report("a smaller light pass")
        found += _sums(effort.rival(), given, effort, samples)
        found = best_first(found)
    if not _rounding_alone(found):
        # A sum of many taps comes near one whose taps lie elsewhere.
        others = [shader for shader in CONVENTIONS.values() if form_of(shader) is None]
        if _is_explained(found):
            others = [shader for shader in others if not shader.composed]
        found += [_apart(problem, given, shader, effort) for shader in others]
    return best_first(found)


def _sums(
    problem: Problem, given: dict[str, float], effort: Effort, samples: int | None
) -> list[Explained]:
    """The picture by every convention that is one sum, best first."""
    starts = starting_points(problem, given)
    if not problem.free.any():
        begin = starts[0]
    else:
        begin = multigrid.climb(problem.small, starts, effort.report, stages=stages(problem.model))
        begin = density_minima.on_subset(problem, begin.coordinates, effort.report)[0]
    comparison = Comparison(problem, begin)
    return comparison.counted_again(comparison.all(effort.report, samples), samples)


def _rounding_alone(found: list[Explained]) -> bool:
    """Whether the best leaves no more than the rounding of the picture's own bytes."""
    return bool(found and found[0].settled.sigma <= density_minima.IMPROVABLE_NOISE)


def _is_explained(found: list[Explained]) -> bool:
    """Whether the best leaves no more than rounding or noise."""
    return bool(found) and (found[0].settled.sigma <= WITHIN_ROUNDING or _like_noise(found[0]))


def _like_noise(explained: Explained) -> bool:
    problem = explained.problem
    observation = problem.observe(SEARCH_PIXELS)
    # A comparison has compiled this program; the prediction alone would be another.
    tangent = tangent_at(explained.settled.coordinates, problem, observation)
    return misfit(tangent.prediction, observation).like_noise


def _apart(
    problem: Problem, given: dict[str, float], shader: Convention, effort: Effort
) -> Explained:
    """The picture as a convention explains it that has no form, from a search of its own."""
    effort.report(f"screening of {shader.name}")
    model = mitchell_template(shader.name, None, len(np.asarray(problem.model.light)))
    problem = problem.replaced(model=model, free=np.isnan(problem.held) & model.used)
    starts = starting_points(problem, given)
    climbed = multigrid.climb(problem.small, starts, lambda text: None, stages=stages(model))
    settled, _ = settle(climbed.coordinates, problem, problem.observe(SEARCH_PIXELS))
    price = FREE_NUMBER * len(shader.parameters)
    names = [Named(shader.name, shader.samples, True)]
    return Explained(names, problem, settled, settled.log_likelihood - price)


def start_of(explained: Explained, name: Named) -> dict[str, float]:
    """The light, and decay and density where the convention ``name`` has them, at the point where a
    picture is explained: parameters of that convention."""
    model, shader = explained.problem.at(explained.settled.coordinates), convention(name.shader)
    assert isinstance(model, Mitchell)
    values = {n: float(v) for n, v in model.values().items()}
    kept = {n: v for n, v in values.items() if n.startswith("light")}
    if not shader.plain:
        return kept
    (taps,) = model.taps
    (unit,) = shader.taps(1.0, 0.9, 1.0, 1.0, name.samples)
    numbers = {"decay": float(taps.ratio), "density": float(taps.step) / float(unit.step)}
    return kept | {n: v for n, v in numbers.items() if n in shader.parameters}


def ranking(found: list[Explained]) -> Remark:
    """A sentence with the convention that explains a picture best, those that are one with it, and
    the best that is another."""
    best, *others = found
    words = f"shader: {best.names[0].words()} explains the picture best (noise of "
    words += f"{best.settled.sigma:.2g} levels)"
    tied = [name.words() for name in best.names[1:]]
    tied += [n.words() for e in others if e.score > best.score - TIED for n in e.names]
    if tied:
        words += f"; the picture does not distinguish it from {', '.join(tied)}"
    others = [e for e in others if e.score <= best.score - TIED]
    if others:
        words += f"; next comes {others[0].names[0].words()} ({others[0].settled.sigma:.2g} levels)"
    return Remark(words + "; --shader overrides this", "shader")


def questioned(found: Found, effort: Effort) -> Found:
    """The fit, with an objection where another convention or another number of samples explains the
    picture clearly better. It is asked only where the residual is more than rounding leaves."""
    problem = found.problem
    model = problem.model
    if not isinstance(model, Mitchell) or found.objection or not problem.free.any():
        return found
    single = form_of(model.convention) is not None
    if single and _without_own(found):
        return found.replaced(objection=NO_OWN_PIXEL.format(model.shader))
    if found.settled.sigma <= density_minima.IMPROVABLE_NOISE:
        return found
    if single:
        comparison = Comparison(problem, found.settled.coordinates)
        own, explained = comparison.own, comparison.all(effort.report)
    else:
        observation = problem.observe(SEARCH_PIXELS)
        own = settle(found.settled.coordinates, problem, observation)[0]
        explained = _sums(_of_general_sum(problem), {}, effort, None)
    if not explained or not _clearly_better(explained[0], own, found):
        return found
    return found.replaced(objection=_objection(explained[0], own, model))


def _of_general_sum(problem: Problem) -> Problem:
    """The same picture under the general sum, with nothing held: numbers of a convention that is no
    single sum mean something else there."""
    assert isinstance(problem.model, Mitchell)
    model = mitchell_template(GENERAL_SUM, None, len(problem.model.light), problem.model.border)
    held = np.full(len(model.parameters), np.nan, np.float32)
    return problem.replaced(model=model, free=np.isnan(held), held=held, most={}, prior={})


def _without_own(found: Found) -> bool:
    """Whether the picture determines that no pixel shows its own value, as the shader has it."""
    problem, model = found.problem, found.problem.model
    assert isinstance(model, Mitchell)
    if not model.convention.own_pixel or not problem.is_free("exposure"):
        return False
    at = problem.index("exposure")
    brightest = LEVELS * model.convention.gain * float(problem.picture.mask.max())
    own = brightest * float(found.settled.coordinates[at])
    error = brightest * float(found.evidence.covariance(problem.free)[at, at]) ** 0.5
    # Some light must be there: without any, the own pixel has none either.
    return own + 2 * error < FAINT_LEVELS and float(np.max(found.evidence.prediction)) > 1


def _clearly_better(other: Explained, own: Settled, found: Found) -> bool:
    """Whether another convention is clearly better than the one that was fitted."""
    if other.score < own.log_likelihood + CLEAR_GAIN:
        return False
    if other.settled.sigma < CLEAR_SHARE * own.sigma:
        return True
    picture = found.problem.picture
    white = misfit(found.evidence.prediction, found.observation).like_noise
    return white and not (picture.half > 0 and was_jpeg(picture.levels[..., 0]))


def _objection(other: Explained, own: Settled, model: Mitchell) -> str:
    best, *tied = other.names
    also = f" (or {', '.join(name.words() for name in tied)})" if tied else ""
    option = "" if best.shader == model.shader else f"--shader {best.shader}"
    if best.samples != model.samples and not (best.default and option):
        option = f"{option} --samples {best.samples}".strip()
    return (
        f"{best.words()}{also} explains the picture far better than {model.shader} with "
        f"{int(model.samples)} samples (noise of {other.settled.sigma:.2g} levels against "
        f"{own.sigma:.2g}); give {option}"
    )
