"""The ladder: nested models of one picture, from a constant veil upwards.

A rung frees parameters that the one below holds. It starts from the fit below, and from the fit of
the whole shader with the held values put in. So the larger model is never the worse. All are fitted
to the same values with the same likelihood; the noise is one of the unknowns.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from godfit.inference import sample_count
from godfit.inference.allowances.arithmetic import with_arithmetic
from godfit.inference.distinct import DOUBT, distinct
from godfit.inference.information import misfit
from godfit.inference.noise import EXPLAINED, WITHIN_ROUNDING
from godfit.inference.observation import Observation
from godfit.inference.problem import SEARCH_PIXELS, Problem, pixels_used
from godfit.inference.settle import settle, veil
from godfit.inference.solver import Tangent
from godfit.inference.strategy import left_open
from godfit.inference.strategy import starts as starts_of
from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import TINT_PARAMETERS, Tinted
from godfit.report.result import FitResult
from godfit.report.select import Rung
from godfit.runtime.parallel import parallel_map
from godfit.search import multigrid

SHIPPED_DEFAULTS = {"decay": 0.99, "density": 0.8, "weight": 0.8}
"""Values that DawnTime and Vesper ship, for shaders that publish no defaults."""
LADDER_VALUES = 1 << 15
"""Values that rungs are fitted to: enough for differences that are visible."""
SAME_START = 1e-3
"""Relative difference of two starts below which they are one."""
INFINITE_COORDINATE = 1e4
"""Stands for the coordinate of decay = 0, which is infinite."""
SECOND_LIGHT_GAIN = 50.0
"""Gain in log-likelihood from which colour is tested on top of a second light."""
RANKING_ROUNDS = 4
"""Rounds of settling that rank the starts on a few pixels."""
Say = Callable[[str], None]
"""Reports a stage of the progress."""


class Ladder:
    """``base`` is the fit of the whole shader with one light; ``place`` (u, v) is the position of
    the light in rungs that do not fit it."""

    def __init__(self, base: FitResult, place: tuple[float, float], seed: int, say: Say) -> None:
        assert isinstance(base.model, Mitchell)
        self.base, self.shader, self.seed, self.say = base, base.model, seed, say
        self.picture = base.picture
        observation = self.picture.observe(pixels_used(self.picture, seed, LADDER_VALUES))
        # All rungs have the noise of the base: their likelihoods are compared.
        at = self._coordinates(base.model)
        self.observation = with_arithmetic(observation, base.problem, at)
        self.ranking_pixels = self.picture.observe(self.picture.informative(SEARCH_PIXELS, seed))
        self.views = list(multigrid.blurred_views(self.picture.small, seed))
        published = self.shader.convention.defaults
        published = published | self.shader.absent
        self.held = {name: published.get(name, SHIPPED_DEFAULTS[name]) for name in SHIPPED_DEFAULTS}
        self.held |= {"light_x": place[0], "light_y": place[1]}

    def rungs(self) -> list[Rung]:
        """The rungs from the smallest model to the largest. Rungs that equal the one below are left
        out: another number of samples where none is better, colour where the target is grey."""
        found = [self.veil()]
        point = self._coordinates(self.shader)
        shader = self.shader.convention
        steps = [
            ("shader defaults", "rays about a light", []),
            ("+ light", "where the light is", ["light_x", "light_y"]),
        ]
        if "decay" in shader.parameters:
            steps += [("+ attenuation", "how fast the rays fade", ["decay"])]
        if "density" in shader.parameters:
            steps += [("+ density", "how far the rays reach", ["density"])]
        if "weight" in shader.parameters and shader.own_pixel:
            steps += [("+ own pixel", "how much a pixel shows of itself", ["weight"])]
        held, given = dict(self.held), []
        for _, _, freed in steps:
            held = {k: v for k, v in held.items() if k not in freed}
            given.append(held)

        def climbed(step: int) -> list[np.ndarray]:
            starts = [point]
            if np.array_equal(self._problem(self.shader, given[step]).free, self.base.free):
                # This is the fit of the whole shader, which is at hand.
                return starts
            if "light_x" in steps[step][2]:
                starts += starts_of(
                    self.shader, self.picture.small, given[step], keep=2, seed=self.seed
                )
            return self._climbed(self.shader, given[step], starts)

        self.say("climbing")
        ways = parallel_map(climbed, range(len(steps)))
        for (name, shows, _), held, starts in zip(steps, given, ways, strict=True):
            self.say(name)
            below = [] if len(found) == 1 else [found[-1].settled.coordinates]
            rung = self._fitted(name, shows, self.shader, held, [*starts, *below])
            if below and rung.settled.log_likelihood < found[-1].settled.log_likelihood:
                # It frees more than the rung below: it climbs again, from there alone.
                again = self._fitted(name, shows, self.shader, held, below)
                rung = max(rung, again, key=lambda r: r.settled.log_likelihood)
            found.append(rung)
        found += self._above(found[-1], held)
        return found

    def _above(self, full: Rung, held: Mapping[str, float]) -> list[Rung]:
        """Rungs beyond the shader as it is."""
        found: list[Rung] = []
        assert isinstance(full.model, Mitchell)
        top = full.model
        if full.settled.sigma > EXPLAINED:
            self.say("+ samples")
            other = sample_count.other_samples(top, self.picture, self.seed)
            if other is not None:
                starts = [self._coordinates(other)]
                rung = self._fitted(
                    "+ samples", f"that the rays have {other.samples} samples", other, held, starts
                )
                rung = dataclasses.replace(rung, parameters=rung.parameters + 1)
                if rung.settled.log_likelihood > full.settled.log_likelihood:
                    found.append(rung)
                    assert isinstance(rung.model, Mitchell)
                    top = rung.model
        if (found or [full])[-1].settled.sigma > EXPLAINED:
            self.say("+ second light")
            rung = self._second((found or [full])[-1], held)
            found.append(rung)
            before = (found or [full])[0].settled.log_likelihood
            if rung.settled.log_likelihood > before + SECOND_LIGHT_GAIN:
                assert isinstance(rung.model, Mitchell)
                top = rung.model
        if self.picture.channels == 3 and not _same_channels(self.picture.levels):
            self.say("+ colour")
            found.append(self._coloured(top, held, sum(r.name == "+ samples" for r in found)))
        return found

    def veil(self) -> Rung:
        """The lowest rung: one value everywhere."""
        settled = veil(self.observation)
        (level,), count = settled.coordinates, len(self.observation.lo)
        prediction, ones = np.full(count, level), np.ones((1, count), np.float32)
        return Rung(
            "veil", "", None, settled, Tangent(prediction, ones, np.ones(1, np.float32)),
            np.ones(1, bool), np.full(1, np.nan, np.float32), 2,
        )  # fmt: skip

    def _second(self, below: Rung, held: Mapping[str, float]) -> Rung:
        """Another light, where it lowers the cost most; the first one starts where it was."""
        assert isinstance(below.model, Mitchell)
        one = below.model
        two = Mitchell(
            one.exposure / 2, one.decay, one.density, one.weight,
            np.tile(np.asarray(one.light)[:1], (2, 1)), one.shader, one.samples,
        )  # fmt: skip
        given = {k: v for k, v in below.values.items() if k not in ("exposure", "weight")}
        starts = [self._coordinates(two)]
        starts += starts_of(two, self.picture.small, given, keep=2, seed=self.seed)
        extra = below.parameters - 1 - int(below.free.sum())
        starts = self._climbed(two, held, starts)
        rung = self._fitted("+ second light", "a second light", two, held, starts)
        return dataclasses.replace(rung, parameters=rung.parameters + extra)

    def _coloured(self, below: Mitchell, held: Mapping[str, float], extra: int) -> Rung:
        model = Tinted(below)
        shown = self.picture.levels.reshape(-1, 3).mean(0) + 1e-3
        z = self._coordinates(model)
        tint = dict(
            zip([row.name for row in TINT_PARAMETERS], shown[[0, 2]] / shown[1], strict=True)
        )
        z = np.array([tint.get(name, at) for name, at in zip(model.parameters, z, strict=True)])
        rung = self._fitted("+ colour", "a light of a colour", model, held, [z])
        return dataclasses.replace(rung, parameters=rung.parameters + extra)

    def _climbed(
        self, model: Mitchell, given: Mapping[str, float], starts: list[np.ndarray]
    ) -> list[np.ndarray]:
        """The first of ``starts``, and where a climb from all of them ends."""
        problem = self._problem(model, given).small
        point = multigrid.climb(problem, starts, lambda text: None, views=self.views)
        return [starts[0], point.coordinates]

    def _problem(self, model: AbstractModel, given: Mapping[str, float]) -> Problem:
        """The fit of ``model`` to the picture with the ``given`` parameters held."""
        held = np.array([given.get(n, np.nan) for n in model.parameters], np.float32)
        problem = Problem(model, self.picture, np.isnan(held) & model.used, held, self.seed)
        shader = model.shading if isinstance(model, Tinted) else model
        opened = left_open(shader, problem)
        if opened is None:
            return problem
        return problem.holding(opened.name, float(model.values()[opened.name]))

    def _fitted(
        self,
        name: str,
        shows: str,
        model: AbstractModel,
        given: Mapping[str, float],
        starts: list[np.ndarray],
    ) -> Rung:
        """The point of largest likelihood from ``starts`` with parameters ``given`` held."""
        problem = self._problem(model, given)
        points = [np.asarray(z, np.float32) for z in starts]
        points = self._distinct_starts(points, problem.free)
        if len(points) > 1:
            # A few pixels rank the starts; those that are too close to rank go on.
            ends = parallel_map(
                lambda z: settle(z, problem, self.ranking_pixels, rounds=RANKING_ROUNDS)[0], points
            )
            best = max(end.log_likelihood for end in ends)
            points = [e.coordinates for e in ends if e.log_likelihood > best - DOUBT]
            points = self._distinct_starts(points, problem.free)
        settled, tangent = max(
            (settle(z, problem, self.observation) for z in points),
            key=lambda found: found[0].log_likelihood,
        )
        free = problem.free
        return Rung(
            name, shows, problem.at(settled.coordinates), settled, tangent, free, problem.held,
            int(free.sum()) + 1,
        )  # fmt: skip

    def _distinct_starts(self, points: list[np.ndarray], free: np.ndarray) -> list[np.ndarray]:
        """Points that differ in ``free`` coordinates: the others are held at the same values."""
        finite = [z for z in points if np.isfinite(z).all()]
        differing = distinct(finite, lambda z, k: np.allclose(z[free], k[free], rtol=SAME_START))
        return differing or points[:1]

    def _coordinates(self, model: AbstractModel) -> np.ndarray:
        z = np.asarray(model.coordinates(), np.float32)
        # decay = 0 has no finite coordinate.
        return np.nan_to_num(z, posinf=INFINITE_COORDINATE)


def like_noise(rung: Rung, observation: Observation) -> bool:
    """Whether the residual of the rung may be noise."""
    return rung.settled.sigma < WITHIN_ROUNDING or (
        misfit(rung.tangent.prediction, observation).like_noise
    )


def _same_channels(levels: np.ndarray) -> bool:
    return bool((levels == levels[..., :1]).all())
