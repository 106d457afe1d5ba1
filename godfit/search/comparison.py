"""The sums of all conventions, as explanations of one picture.

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

from godfit.inference import sample_count
from godfit.inference.evaluate import model_at
from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem
from godfit.inference.settle import Settled, settle
from godfit.inference.strategy import Report
from godfit.models.coordinates import DENSITY
from godfit.models.mitchell import Mitchell, resampled
from godfit.scattering.conventions import CONVENTIONS, Convention
from godfit.scattering.forms import Form, Named, count_of, form_of, forms, named
from godfit.scattering.radial.exact import at_run_time
from godfit.search import density_minima

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
MORE_TAPS = 2
"""Taps by which loops of the same number of samples differ, at most."""
ROUND_NUMBERS = (16, 32, 64, 96, 128, 192, 256, *range(10, sample_count.MOST_SAMPLES + 1, 10))
"""Numbers of samples that shaders have, for bands too shallow to scan."""
SHALLOW_BANDS = 0.15
"""Noise in levels up to which it may be that of such bands: those of deeper ones are scanned."""
ROUND_PIXELS = 512
"""Pixels at which round numbers are compared: some of so many values lie beyond their intervals."""
NUMBERS_TRIED = 3
"""Numbers of taps that the bands suggest and that are tried, each with and without own pixel."""


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

    def explained(
        self, form: Form, model: Mitchell, observation: Observation | None = None
    ) -> Explained | None:
        """The picture, or an ``observation`` of it, by a sum of a ``form`` with as many taps as
        ``model``, from its numbers. None where the user holds a number that the form has at another
        value, or where no convention is such a sum."""
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
        observation = observation or self.observation
        settled, _ = settle(np.clip(start, *problem.bounds), problem, observation)
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
            least = min((e.settled.sigma for e in explained), default=np.inf)
            if density_minima.IMPROVABLE_NOISE < least < SHALLOW_BANDS and self._sharp:
                report("round numbers of samples")
                models = self._of_round_numbers(explained[0])
                tried = {(form, count) for form in self.forms for count in models}
                explained, _ = self._ranked(explained, models, tried)
        return explained

    @property
    def _sharp(self) -> bool:
        """Whether the picture is bytes of one pass, whose rounding is all that may be left."""
        picture = self.problem.picture
        return picture.half > 0 and picture.pass_size(self.model) == picture.size

    def _of_round_numbers(self, own: Explained) -> dict[int, Mitchell]:
        """The likeliest sums of round numbers of samples by their numbers of taps, from a few
        hundred pixels. Bands that are too shallow for least squares put some values beyond their
        intervals, and the right number of taps alone puts none there."""
        model = own.problem.at(own.settled.coordinates)
        assert isinstance(model, Mitchell)
        few = self.problem.observe(ROUND_PIXELS)
        # Some loops leave one sample out.
        counts = {number - drop for number in ROUND_NUMBERS for drop in (0, 1)}
        models = {n: resampled(model, n + self.general.drop) for n in sorted(counts)}
        tried = {n: self.explained(Form(), one, few) for n, one in models.items()}
        found = [(e.settled.log_likelihood, n) for n, e in tried.items() if e and e.finite]
        return {n: models[n] for _, n in sorted(found)[-NUMBERS_TRIED:]}

    def counted_again(
        self, explained: list[Explained], samples: int | None = None
    ) -> list[Explained]:
        """Those ``explained`` and all forms with a few taps more or fewer than the best has, at its
        places, or with ``samples`` alone where these are given: the last taps may lie where the
        mask is black everywhere, and loops of the same number of samples differ by as many. The
        best is searched for its density first, which a fit of it would do."""
        tried: set[int] = set()
        counts = None
        if samples is not None:
            counts = {count_of(one, samples) for shaders in self.forms.values() for one in shaders}
        while explained and explained[0].finite:
            best = self._of_likelier_density(explained[0])
            explained = [best, *explained[1:]]
            model = best.problem.at(best.settled.coordinates)
            assert isinstance(model, Mitchell)
            (taps,) = model.taps
            count, step = int(taps.count), float(taps.step)
            if count in tried:
                break
            first = max(count - MORE_TAPS, sample_count.FEWEST_SAMPLES)
            near = {*range(first, count + MORE_TAPS + 1), count} - tried
            near = near if counts is None else near & counts
            tried |= near | {count}
            spacings = {n: sample_count.Spacing(n + self.general.drop, step) for n in near}
            spaced = {n: _spaced(model, spacing) for n, spacing in spacings.items()}
            pairs = {(form, n) for form in self.forms for n in near}
            explained, _ = self._ranked(explained, spaced, pairs)
        return explained

    def _of_likelier_density(self, own: Explained) -> Explained:
        """The same convention at the likeliest of the densities that its bands suggest."""
        at = own.settled.coordinates
        candidates = density_minima.on_subset(own.problem, at, lambda text: None)
        ends = [settle(z, own.problem, self.observation)[0] for z in candidates]
        best = max(ends, key=lambda end: end.log_likelihood)
        gain = best.log_likelihood - own.settled.log_likelihood
        if not gain > 0:
            return own
        return dataclasses.replace(own, settled=best, score=own.score + gain)

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
        return best_first(explained), done


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


def best_first(found: list[Explained]) -> list[Explained]:
    """By score, without what the same conventions explain less well. A search that met nothing
    finite comes last: NaN leaves the others in any order."""
    in_order = sorted(found, key=lambda e: -e.score if e.finite else math.inf)
    return list({tuple(e.names): e for e in reversed(in_order)}.values())[::-1]
