"""Two craft that steer: one follows a closed path, one pursues it.

Steering behaviours are those of Reynolds (Steering Behaviors for Autonomous Characters, 1999), with
the rules of the library that Vesper's flight uses. A craft has a mass of 1 and a limit of its
speed; the force on it is the velocity that it wants minus the one that it has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

UPDATE_SECONDS = 1 / 60
"""Time between two updates: the frames of a screen."""

FACING_COSINE = -0.95
"""Cosine between two headings below which the craft fly towards each other."""

SETTLING_LAPS = 6
"""Laps that are not kept: after them every lap is the same."""


@dataclass
class Craft:
    """A craft: ``position`` and ``velocity`` (3,), and its largest speed, a second."""

    position: np.ndarray
    velocity: np.ndarray
    max_speed: float

    def steer(self, target: np.ndarray) -> None:
        """One update towards a place."""
        away = target - self.position
        wanted = self.max_speed * away / max(float(np.linalg.norm(away)), 1e-12)
        self.velocity = self.velocity + (wanted - self.velocity) * UPDATE_SECONDS
        speed = float(np.linalg.norm(self.velocity))
        self.velocity = self.velocity * min(1.0, self.max_speed / max(speed, 1e-12))
        self.position = self.position + self.velocity * UPDATE_SECONDS


class Flight(NamedTuple):
    """One lap: positions and velocities (updates, 3) of the leading and the pursuing craft."""

    leader: np.ndarray
    leader_velocity: np.ndarray
    pursuer: np.ndarray
    pursuer_velocity: np.ndarray


def next_point(craft: Craft, path: np.ndarray, at: int, near: float) -> int:
    """The number of the point of the closed ``path`` (n, 3) that the craft flies to: the one after
    ``at`` once that is nearer than ``near``."""
    return (at + 1) % len(path) if np.linalg.norm(path[at] - craft.position) < near else at


def predicted(pursuer: Craft, leader: Craft) -> np.ndarray:
    """(3,) where the pursuer expects to meet the leader: where that is now if the two fly towards
    each other, and else where it will be after the time in which they cover their distance."""
    away = leader.position - pursuer.position
    headings = [c.velocity / max(float(np.linalg.norm(c.velocity)), 1e-12)
                for c in (pursuer, leader)]  # fmt: skip
    if away @ headings[0] > 0 and headings[0] @ headings[1] < FACING_COSINE:
        return leader.position
    speeds = pursuer.max_speed + float(np.linalg.norm(leader.velocity))
    return leader.position + leader.velocity * float(np.linalg.norm(away)) / speeds


def flown(path: Sequence[Sequence[float]], near: float, speeds: tuple[float, float]) -> Flight:
    """A lap of the closed ``path`` from one pass of its first point to the next, at the largest
    ``speeds`` of leader and pursuer, once both repeat themselves."""
    points, at, laps = np.array(path, float), 1, 0
    leader = Craft(points[0], points[1] - points[0], speeds[0])
    pursuer = Craft(points[-1], points[0] - points[-1], speeds[1])
    kept: list[tuple[np.ndarray, ...]] = []
    while laps <= SETTLING_LAPS:
        before, at = at, next_point(leader, points, at, near)
        laps += before == 0 and at == 1
        leader.steer(points[at])
        pursuer.steer(predicted(pursuer, leader))
        if laps == SETTLING_LAPS:
            kept.append((leader.position, leader.velocity, pursuer.position, pursuer.velocity))
    return Flight(*(np.array(column) for column in zip(*kept, strict=True)))
