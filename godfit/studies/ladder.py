"""The ladder: how much of a model a picture is given, from a constant veil upwards.

A rung frees what the one below it holds, and is started from there and from the fit of the whole
shader with what it holds put in: nested models, of which the larger is never the worse. All are
fitted to the same values with the same likelihood, noise among the unknowns.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from godfit.inference import sample_count
from godfit.inference.distinct import DOUBT, distinct
from godfit.inference.information import misfit
from godfit.inference.noise import EXPLAINED, WITHIN_ROUNDING
from godfit.inference.observation import Observation
from godfit.inference.problem import PIXELS, Problem, pixels_used
from godfit.inference.settle import settle, veil
from godfit.inference.solver import Tangent
from godfit.inference.strategy import left_open
from godfit.inference.strategy import starts as starts_of
from godfit.models.base import AbstractModel
from godfit.models.mitchell import Mitchell
from godfit.models.tinted import TINT, Tinted
from godfit.report.result import FitResult
from godfit.report.select import Rung
from godfit.runtime.parallel import parallel_map
from godfit.search import multigrid

# What DawnTime and Vesper ship, for shaders that publish no defaults.
SHIPPED = {"decay": 0.99, "density": 0.8, "weight": 0.8}
# Values that rungs are fitted to: enough for differences that anyone would see.
VALUES = 1 << 15
Say = Callable[[str], None]


class Ladder:
    """``base`` is the fit of the whole shader with one light; ``place`` (u, v) is where the light
    is taken to be before it is fitted."""

    def __init__(self, base: FitResult, place: tuple[float, float], seed: int, say: Say) -> None:
        assert isinstance(base.model, Mitchell)
        self.base, self.shader, self.seed, self.say = base, base.model, seed, say
        self.picture = base.picture
        self.observation = self.picture.observe(pixels_used(self.picture, seed, VALUES))
        self.few = self.picture.observe(self.picture.informative(PIXELS, seed))
        self.views = list(multigrid.blurred_views(self.picture.small, seed))
        published = self.shader.convention.defaults
        self.held = {name: published.get(name, SHIPPED[name]) for name in SHIPPED}
        self.held |= {"light_x": place[0], "light_y": place[1]}

    def rungs(self) -> list[Rung]:
        """From least to most. Those that cannot be told from the one below are left out: another
        number of samples where none suits better, colour where there is none."""
        found = [self.veil()]
        point = self._coordinates(self.shader)
        box = self.shader.convention.box
        steps = [
            ("shader defaults", "rays about a light", []),
            ("+ light", "where the light is", ["light_x", "light_y"]),
        ]
        if not box:
            steps += [
                ("+ attenuation", "how fast the rays fade", ["decay"]),
                ("+ density", "how far the rays reach", ["density"]),
            ]
        if not box and self.shader.convention.own_pixel:
            steps += [("+ own pixel", "how much a pixel shows of itself", ["weight"])]
        held, given = dict(self.held), []
        for _, _, freed in steps:
            held = {k: v for k, v in held.items() if k not in freed}
            given.append(held)

        def climbed(step: int) -> list[np.ndarray]:
            starts = [point]
            if np.array_equal(self._problem(self.shader, given[step]).free, self.base.free):
                # This is the fit that the ladder begins with.
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
            found.append(self._fitted(name, shows, self.shader, held, [*starts, *below]))
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
            if rung.settled.log_likelihood > (found or [full])[0].settled.log_likelihood + 50:
                assert isinstance(rung.model, Mitchell)
                top = rung.model
        if self.picture.channels == 3 and not _same_channels(self.picture.levels):
            self.say("+ colour")
            found.append(self._coloured(top, held, sum(r.name == "+ samples" for r in found)))
        return found

    def veil(self) -> Rung:
        """One value everywhere."""
        settled = veil(self.observation)
        (level,), count = settled.coordinates, len(self.observation.lo)
        prediction, ones = np.full(count, level), np.ones((1, count), np.float32)
        return Rung(
            "veil", "", None, settled, Tangent(prediction, ones, np.ones(1, np.float32)),
            np.ones(1, bool), np.full(1, np.nan, np.float32), 2,
        )  # fmt: skip

    def _second(self, below: Rung, held: Mapping[str, float]) -> Rung:
        """Another light, wherever it helps most, the first where it was and free to go."""
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
        tint = dict(zip([row.name for row in TINT], shown[[0, 2]] / shown[1], strict=True))
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
        """The likeliest point from ``starts`` with parameters ``given`` held."""
        problem = self._problem(model, given)
        points = [np.asarray(z, np.float32) for z in starts]
        points = self._apart(points, problem.free)
        if len(points) > 1:
            # A few pixels rank them; those that these cannot tell apart go on.
            ends = parallel_map(lambda z: settle(z, problem, self.few, rounds=4)[0], points)
            best = max(end.log_likelihood for end in ends)
            points = [e.coordinates for e in ends if e.log_likelihood > best - DOUBT]
            points = self._apart(points, problem.free)
        settled, tangent = max(
            (settle(z, problem, self.observation) for z in points),
            key=lambda found: found[0].log_likelihood,
        )
        free = problem.free
        return Rung(
            name, shows, problem.at(settled.coordinates), settled, tangent, free, problem.held,
            int(free.sum()) + 1,
        )  # fmt: skip

    def _apart(self, points: list[np.ndarray], free: np.ndarray) -> list[np.ndarray]:
        """Those that differ in what is ``free``: the rest is held at the same values in all."""
        finite = [z for z in points if np.isfinite(z).all()]
        apart = distinct(finite, lambda z, k: np.allclose(z[free], k[free], rtol=1e-3))
        return apart or points[:1]

    def _coordinates(self, model: AbstractModel) -> np.ndarray:
        z = np.asarray(model.coordinates(), np.float32)
        # decay = 0 has no finite coordinate.
        return np.nan_to_num(z, posinf=1e4)


def like_noise(rung: Rung, observation: Observation) -> bool:
    """Whether what the rung leaves may be noise."""
    return rung.settled.sigma < WITHIN_ROUNDING or (
        misfit(rung.tangent.prediction, observation).like_noise
    )


def _same_channels(levels: np.ndarray) -> bool:
    return bool((levels == levels[..., :1]).all())
