"""Which convention and how many samples made a picture.

Every convention that is one sum over taps is the general sum with some of its numbers held: no
value at the pixel itself, a decay of 1, a weight that goes with the exposure, rays of one length.
So one compiled model serves all of them, and what is compared are sets of held numbers and numbers
of taps. The number of taps is determined by the bands that they leave
(``godfit/inference/sample_count.py``). Conventions with the same held numbers are one: no picture
distinguishes DawnTime from Vesper.

All are compared by the likelihood of the same few thousand pixels, from the same start. A number
that is free costs as much as in Schwarz's criterion (Ann. Statist. 6 (1978), 461).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from godfit.errors import Remark
from godfit.inference import sample_count
from godfit.inference.evaluate import model_at
from godfit.inference.fitted import Found
from godfit.inference.information import misfit
from godfit.inference.noise import WITHIN_ROUNDING
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.solver import tangent_at
from godfit.inference.strategy import Effort, Report, stages, starting_points
from godfit.io.image import LEVELS
from godfit.io.jpeg import was_jpeg
from godfit.models.build import mitchell_template
from godfit.models.coordinates import DENSITY
from godfit.models.mitchell import Mitchell, resampled
from godfit.scattering.conventions import CONVENTIONS, Convention, convention
from godfit.scattering.forms import Form, Named, count_of, form_of, forms, named
from godfit.scattering.radial.exact import at_run_time
from godfit.search import density_minima, multigrid

GENERAL_SUM = "mitchell"
"""The convention with every number of the general sum free, which stands for all."""
NO_OWN = 1e-6
"""Weight of the pixel's own value that stands for none: thousandths of a level, and a weight of the
taps relative to it that float32 holds."""
FREE_NUMBER = 0.5 * math.log(SEARCH_PIXELS)
"""Log-likelihood that one more free number must gain, by Schwarz's criterion."""
ANY_COUNT = math.log(sample_count.MOST_SAMPLES)
"""Log-likelihood that a number of taps must gain which no shader has by default: one of so many."""
CLEAR_GAIN = 30.0
"""Gain in log-likelihood of SEARCH_PIXELS from which another convention is clearly better: kinks of
the mask and the choice among hundreds of numbers make it differ by less."""
CLEAR_SHARE = 0.5
"""Share of the noise that a clearly better convention leaves at most, where the residual is no
white noise: correlated errors make likelihoods differ by far more than they mean."""
NUMBERS_TRIED = 3
"""Numbers of taps that the bands suggest and that are tried, each with and without own pixel."""
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


@dataclasses.dataclass(frozen=True, eq=False)
class Explained:
    """A picture as one convention, or several that are one, explain it: where ``problem`` settled
    on a few thousand pixels, and ``score``, that log-likelihood less the price of what is free.
    ``names`` are the conventions, likeliest first."""

    names: list[Named]
    problem: Problem
    settled: Settled
    score: float

    @property
    def finite(self) -> bool:
        """Whether the search met anything finite."""
        return math.isfinite(self.score)


class Comparison:
    """Sums of other numbers of taps and other forms in place of a ``problem``'s, all settled on the
    same pixels, from ``start`` (p,)."""

    def __init__(self, problem: Problem, start: np.ndarray) -> None:
        model = problem.model
        assert isinstance(model, Mitchell)
        self.problem, self.given = problem, model.shader
        self.observation = problem.observe(SEARCH_PIXELS)
        self.own, _ = settle(start, problem, self.observation)
        at = problem.at(self.own.coordinates)
        if not model.convention.own_pixel and "exposure" in problem.names:
            # Its exposure is held because no picture determines it there.
            self.problem = problem.replaced(held=problem.held.copy())
            self.problem.held[problem.index("exposure")] = np.nan
        assert isinstance(at, Mitchell)
        # A convention that lacks a number cannot stand for one that has it.
        self.general = model.convention
        if form_of(self.general) != Form():
            self.general = CONVENTIONS[GENERAL_SUM]
        self.model = _translated(at, self.general)
        self.forms = forms()

    def explained(self, form: Form, model: Mitchell) -> Explained | None:
        """The picture by a sum of a ``form`` with as many taps as ``model``, from its numbers. None
        where the user holds a number that the form has at another value, or where no convention is
        such a sum."""
        count = count_of(self.general, int(model.samples))
        names = named(form, count, self.given)
        fixed = _fixed(form, self.general, count)
        if not names or fixed is None:
            return None
        problem = self.problem.replaced(
            model=model, free=self.problem.free.copy(), held=self.problem.held.copy()
        )
        for name in model.parameters:
            at = problem.index(name)
            if name not in fixed:
                # The given shader may lack what the general one has.
                problem.free[at] |= bool(np.isnan(problem.held[at]))
            elif not np.isnan(problem.held[at]):
                return None
            else:
                problem = problem.holding(name, fixed[name])
        start = np.asarray(model.coordinates(), np.float32)
        settled, _ = settle(np.clip(start, *problem.bounds), problem, self.observation)
        price = FREE_NUMBER * form.free + (0 if names[0].default else ANY_COUNT)
        return Explained(names, problem, settled, settled.log_likelihood - price)

    def all(self, report: Report, samples: int | None = None) -> list[Explained]:
        """Every form that may be the best, each with the numbers of taps that its shaders have by
        default and those that the bands suggest, or with ``samples`` alone where these are given;
        best first."""
        report("other conventions")
        drop = self.general.drop
        defaults = {
            (form, count_of(shader, samples or shader.samples))
            for form, shaders in self.forms.items()
            for shader in shaders
        }
        resized = {n: resampled(self.model, n + drop) for _, n in defaults}
        explained, done = self._ranked([], resized, defaults)
        least = min((e.settled.sigma for e in explained), default=np.inf)
        if samples is None and least > density_minima.IMPROVABLE_NOISE:
            report("other numbers of samples")
            picture, seed = self.problem.picture, self.problem.seed
            # With the pixel's own value free, sums without it are among those that are ranked.
            found = sample_count.spacings(self.model, picture, seed)[:NUMBERS_TRIED]
            spaced = {taps.samples - drop: _spaced(self.model, taps) for _, taps in found}
            tried = {(form, count) for form in self.forms for count in spaced} - done
            explained, _ = self._ranked(explained, spaced, tried)
        return explained

    def _ranked(
        self,
        explained: list[Explained],
        models: dict[int, Mitchell],
        tried: set[tuple[Form, int]],
    ) -> tuple[list[Explained], set[tuple[Form, int]]]:
        """Those ``explained`` and the forms and numbers of taps that are ``tried``, best first, and
        which of these are done with. The sum with every number free comes first: none with as many
        taps is likelier, so that the others are left out where it falls behind."""
        counts: dict[int, list[Form]] = {}
        for form, count in sorted(tried, key=repr):
            counts.setdefault(count, []).append(form)
        whole = {count: self.explained(Form(), models[count]) for count in counts}
        explained = explained + [
            e for count, e in whole.items() if e is not None and (Form(), count) in tried
        ]
        likelihoods = {
            count: np.inf if e is None or not e.finite else e.settled.log_likelihood
            for count, e in whole.items()
        }
        done = set()
        for count in sorted(counts, key=lambda count: -likelihoods[count]):
            best = max((e.score for e in explained if e.finite), default=-np.inf)
            if likelihoods[count] < best - CLEAR_GAIN:
                break
            found = [self.explained(f, models[count]) for f in counts[count] if f != Form()]
            explained += [e for e in found if e is not None]
            done |= {(form, count) for form in counts[count]}
        return _best_first(explained), done
        return sorted(explained, key=lambda e: -e.score)


def _translated(model: Mitchell, shader: Convention) -> Mitchell:
    """The same sum as ``model``, in the terms of another convention that has every number free."""
    if model.convention.name == shader.name:
        return model
    (taps,) = model.taps
    count = int(taps.count)
    samples = count + shader.drop
    own = max(float(taps.own), NO_OWN)
    ratio = max(float(taps.ratio), NO_OWN)
    weight = float(taps.first) / own / ratio ** (1 - shader.order)
    density = float(taps.step) * samples
    return Mitchell(
        own / shader.gain, float(taps.ratio), density, weight, model.light, shader.name, samples,
        border=model.border,
    )  # fmt: skip


def _fixed(form: Form, shader: Convention, count: int) -> dict[str, float] | None:
    """The parameters of ``shader`` that hold a form's numbers, by name; None where none can."""
    held: dict[str, float] = {}
    if form.own is not None:
        held["exposure"] = max(form.own, NO_OWN) / shader.gain
    if form.ratio is not None:
        held["decay"] = form.ratio
    if form.relative is not None:
        if shader.order != 1 and form.ratio is None:
            return None
        held["weight"] = form.relative / (form.ratio or 1.0) ** (1 - shader.order)
    if form.end is not None:
        held["density"] = form.end / count * (count + shader.drop)
    return held


def _spaced(model: Mitchell, taps: sample_count.Spacing) -> Mitchell:
    """``model`` with other taps, of the same attenuation and light along the ray."""
    z = np.array(model.coordinates(), np.float32)
    z[DENSITY] = taps.step * taps.samples
    other = dataclasses.replace(model, samples=at_run_time(taps.samples))
    return model_at(z, np.full(len(z), np.nan, np.float32), other)


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
        found = _best_first(found)
    if not _rounding_alone(found):
        # A sum of many taps comes near one whose taps lie elsewhere.
        others = [shader for shader in CONVENTIONS.values() if form_of(shader) is None]
        if _is_explained(found):
            others = [shader for shader in others if not shader.composed]
        found += [_apart(problem, given, shader, effort) for shader in others]
    return _best_first(found)


def _best_first(found: list[Explained]) -> list[Explained]:
    """By score. A search that met nothing finite comes last: NaN leaves the others in any order."""
    return sorted(found, key=lambda e: -e.score if e.finite else math.inf)


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
    return Comparison(problem, begin).all(effort.report, samples)


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
