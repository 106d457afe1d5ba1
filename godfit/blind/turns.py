"""Light and shadows of a picture that comes with nothing, until they suit each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from godfit.blind import outline
from godfit.blind.occluders import asked, price
from godfit.inference.evaluate import model_at, predicted
from godfit.inference.likelihood import log_likelihood
from godfit.inference.observation import Observation, Picture
from godfit.inference.problem import Problem
from godfit.inference.solver import Point, Stop, linearise, solve
from godfit.io.filters import shrink
from godfit.models.disc_light import DiscLight

# Solves of one noise, most, their steps, the relative changes that end them, and the share of the
# cost that is worth another turn: the shadows are about to change anyway.
MAX_SOLVES, STEPS, RTOL, WORTH = 12, 6, 1e-3, 0.02
# Turns of shadows and light before what they make is judged.
SOME = 2
# Pixels that shadows are read from: others than those that are seen, many where few are seen.
ROWS = 16_384
# Surprisal may rise by so much on the tangent, which a solve follows.
REACH = 1.01


class Read(NamedTuple):
    """Where a solve ended; the ``mask`` (h, w), of the light pass's size, that it was of; what
    was ``thought`` (h, w) to be open before any shadow was asked; the pixels that are ``seen``;
    coordinates (p,) ``before`` any shadow had a say, if these are known."""

    point: Point
    mask: np.ndarray
    thought: np.ndarray
    seen: Observation
    before: np.ndarray | None = None

    @staticmethod
    def of(point: Point, thought: np.ndarray, seen: Observation) -> Read:
        """Under a mask as it is ``thought`` (h, w)."""
        return Read(point, thought, thought, seen.with_mask(thought))

    def unshadowed(self) -> Read:
        """No shadow asked yet."""
        return self.with_mask(self.thought)

    def with_mask(self, mask: np.ndarray) -> Read:
        """With the shadows (h, w) that were found; the price is still that of what was thought."""
        return self._replace(mask=mask, seen=self.seen.with_mask(mask))

    def at(self, coordinates: np.ndarray) -> Read:
        """Elsewhere (p,), not solved yet."""
        return self._replace(point=self.point._replace(coordinates=coordinates, cost=np.inf))


@dataclass(frozen=True, eq=False)
class Turns:
    """``picture`` under ``model``, whose coordinates are ``held`` (p,) where not ``free`` (p,);
    ``unknown`` (h, w), of any size, is what shadows decide, ``texture`` the background's, in
    levels; ``seed`` is of the pixels that they are read from. Noises ``sigma`` are in levels; no
    less than ``least`` is allowed for."""

    model: DiscLight
    picture: Picture
    unknown: np.ndarray
    texture: float
    free: np.ndarray
    held: np.ndarray
    seed: int
    least: float = 1.0

    @property
    def problem(self) -> Problem:
        return Problem(self.model, self.picture, self.free, self.held, self.seed)

    @property
    def noise(self) -> float:
        """Least noise allowed for, in levels: nothing explains texture, and what is off by as much
        is not foreign."""
        return max(self.least, self.texture)

    def solved(self, read: Read, sigma: float) -> Read:
        """One solve with so much noise allowed for."""
        sigma = max(sigma, self.texture)
        point = solve(
            read.point.coordinates, self.problem, read.seen, sigma, stop=Stop(RTOL, STEPS)
        )
        return read._replace(point=point)

    def descended(self, read: Read, sigma: float) -> Read:
        """Solved until it makes no more headway: radius, veil, attenuation and light trade in a
        long, bent valley."""
        cost = np.inf
        for _ in range(MAX_SOLVES):
            read = self.solved(read, sigma)
            if read.point.settled or not read.point.cost < 0.99 * cost:
                break
            cost = read.point.cost
        return read

    def shaded(self, read: Read) -> Read:
        """With the shadows that suit the light best, and the light moved along on its tangent."""
        z = read.point.coordinates
        here = self.picture.with_mask(read.mask)
        # What is more than open at the rim would hold the radius.
        even = here.with_mask(np.minimum(here.mask, 1))
        unknown = shrink(self.unknown.astype(np.float32), read.mask.shape[:2]) > 0
        scale = self.model.scales(z)

        def slopes(pixels: np.ndarray) -> np.ndarray:
            _, jacobian = linearise(z, self.held, scale, self.model, even.observe(pixels))
            return np.asarray(jacobian).reshape(len(z), len(pixels), -1)[self.free]

        question = asked(
            model_at(z, self.held, self.model), here, unknown, read.thought, ROWS, self.seed,
            self.texture,
        )  # fmt: skip
        if question is None:
            return read
        both = question.answered(slopes)
        moved = z.copy()
        moved[self.free] += (both.step * scale[self.free]).astype(np.float32)
        there = read.with_mask(both.mask).at(self.inside(moved))
        # Where the tangent does not reach, the light stays for the time being.
        if self.surprisal(there) < REACH * self.surprisal(read):
            return there
        return read.with_mask(question.answered(near=both).mask)

    def inside(self, coordinates: np.ndarray) -> np.ndarray:
        """The nearest (p,) that are within the model's bounds."""
        return np.clip(coordinates, *(np.asarray(b, np.float32) for b in self.model.bounds()))

    def surprisal(self, read: Read) -> float:
        """Minus the log-likelihood with the least noise allowed for."""
        seen = read.seen
        levels = predicted(read.point.coordinates, self.held, self.model, seen)
        sigma = np.float32(self.noise)
        return -float(log_likelihood(levels, seen.lo, seen.hi, sigma, seen.foreign).sum())

    def total(self, read: Read) -> float:
        """What a solve left and what the shadows cost."""
        share = len(read.seen.pixels) / (self.picture.size[0] * self.picture.size[1])
        model = model_at(read.point.coordinates, self.held, self.model)
        return read.point.cost + price(model, read.mask, read.thought, self.hidden(read), share)

    def hidden(self, read: Read) -> np.ndarray:
        """(h, w) where in ``read``'s mask glare hides what stands in the way."""
        h, w = read.mask.shape[:2]
        return outline.hidden(self.picture, self.unknown, (h, w))

    def turn(self, read: Read, sigma: float) -> Read:
        """The shadows under the light that was found, and the light under these."""
        return self.descended(self.shaded(read), sigma)

    def turned(self, read: Read, most: int) -> Read:
        """Turn by turn, for as long as it helps."""
        for _ in range(most):
            there = self.turn(read, self.noise)
            before, after = self.total(read), self.total(there)
            if after < before:
                read = there
            if not after < (1 - WORTH) * before:
                break
        return read
