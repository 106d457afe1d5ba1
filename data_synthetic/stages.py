"""The scenes of the source projects, rebuilt from primitives; make.py draws them with the program's
own rasteriser. Conventions are those of scene files.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from bodies import Part, Vector3, ball, box, floor, placed, ring, rod, strut
from steering import Flight, flown


@dataclass
class Stage:
    """A scene and the settings of its target. ``light`` and ``camera`` are positions, ``radius`` is
    the light's, ``clear`` the background's colour ("#rrggbb"), ``params`` are the shader's by name
    and ``size`` is (height, width). ``known`` are the keys of the scene whose values manifest.json
    has, beside light and camera."""

    parts: list[Part]
    camera: Vector3
    light: Vector3
    radius: float
    clear: str
    shader: str
    samples: int
    params: dict[str, float]
    note: str
    size: tuple[int, int] = (256, 256)
    antialias: bool = True
    known: tuple[str, ...] = ()
    albedo: str | None = None

    def text(self) -> str:
        """The text of the scene file."""
        height, width = self.size
        surface = {} if self.albedo is None else {"albedo": self.albedo}
        settings = {"shader": self.shader, "samples": self.samples, "pass_scale": PASS_SCALE}
        tables = [
            ("[image]", {"width": width, "height": height, "antialias": self.antialias}),
            ("[camera]", {"position": self.camera, "fov_y": 75, "near": 0.1, "far": 350}),
            ("[light]", {"position": self.light, "radius": self.radius}),
            ("[background]", {"colour": self.clear}),
            *(("[[object]]", part | surface) for part in self.parts),
            ("[scattering]", settings | self.params),
        ]
        return "\n".join(
            f"{head}\n" + "".join(f"{key} = {_toml(value)}\n" for key, value in table.items())
            for head, table in tables
        )


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml, value))}]"
    return f"{round(value, 5) + 0:.10g}"


def mitchell_params(
    exposure: float, decay: float, density: float, weight: float
) -> dict[str, float]:
    """Mitchell's four parameters by name, in the order of the manifest."""
    return {"exposure": exposure, "decay": decay, "density": density, "weight": weight}


PASS_SCALE = 1
"""Size of the light pass of the scenes. Both sources halve it; these targets are small already."""

SOURCE_PARAMS = mitchell_params(0.05, 0.99, 0.8, 0.8)
"""The parameters that DawnTime and Vesper start with."""

VESPER_CLEAR = "#101010"
"""The colour that Vesper clears its mask to."""


def skull() -> Stage:
    """A cranium, rings for the sockets, and two rows of teeth."""
    head = [
        ball(0.86, at=(0, 0.86, -0.1)),
        box(1.34, 0.16, 0.3, at=(0, 0.1, 0.1)),
        box(0.1, 0.36, 0.2, at=(0, -0.12, 0.2)),
        box(0.3, 0.08, 0.2, at=(0, -0.6, 0.2)),
    ]
    for side in (-1, 1):
        head += [
            ball(0.34, at=(0.6 * side, 0.36, -0.1)),
            ring(0.27, 0.085, at=(0.34 * side, -0.16, 0.15)),
            box(0.18, 0.42, 0.3, at=(0.66 * side, -0.22, 0), turn=(0, 0, 12 * side)),
            box(0.42, 0.14, 0.2, at=(0.5 * side, -0.46, 0.1), turn=(0, 0, 24 * side)),
            box(0.09, 0.34, 0.2, at=(0.15 * side, -0.43, 0.2), turn=(0, 0, 18 * side)),
            box(0.16, 0.9, 0.2, at=(0.6 * side, -0.86, -0.1), turn=(0, 0, -14 * side)),
        ]
    for i in range(-3, 4):
        head += [
            box(0.09, 0.2, 0.1, at=(0.125 * i, -0.72, 0.3 - 0.015 * i * i), turn=(0, 0, 2 * i)),
            box(0.085, 0.17, 0.1, at=(0.12 * i, -1.04, 0.3 - 0.015 * i * i), turn=(0, 0, -2 * i)),
        ]
    head += [
        box(0.94, 0.12, 0.2, at=(0, -0.64, 0.1)),
        box(0.92, 0.26, 0.3, at=(0, -1.22, 0.1)),
    ]
    return Stage(
        placed(head, (0, 0.3, 2), (4, -6, 0), 1.35), (-0.04, -0.68, 6.97), (0, 0, 0), 1.15,
        "#111111", "dawntime", 200, SOURCE_PARAMS,
        "A skull before the light, which shows through sockets, nose and teeth.", antialias=False,
    )  # fmt: skip


def ship() -> Stage:
    """A hull with two spoked rings, engines and fins."""
    hull = [
        rod(0.26, 4.2, at=(0.1, 0, 0), turn=(0, 0, 90)),
        ball(0.26, at=(-2, 0, 0)),
        box(0.7, 0.24, 0.24, at=(-1.5, 0.28, 0)),
        rod(0.4, 0.5, at=(1.5, 0, 0), turn=(0, 0, 90)),
        box(0.9, 0.9, 0.06, at=(1.8, 0.6, 0), turn=(0, 0, -25)),
        box(0.5, 0.05, 2.2, at=(1.8, 0, 0)),
    ]
    hull += [
        rod(0.2, 0.9, at=(2.3, y, z), turn=(0, 0, 90)) for y in (-0.26, 0.26) for z in (-0.26, 0.26)
    ]
    for x, radius, count in ((-0.6, 1.25, 8), (0.5, 1.0, 6)):
        hull.append(ring(radius, 0.11, at=(x, 0, 0), turn=(0, 90, 0)))
        for angle in 2 * np.pi * (np.arange(count) + 0.2) / count:
            rim = x, radius * float(np.cos(angle)), radius * float(np.sin(angle))
            hull.append(strut(0.045, (x, 0, 0), rim))
    return Stage(
        placed(hull, (0.1, 0.05, 3), (14, 42, 5), 1.2), (0.4, 0.6, 7), (-0.1, 0.1, 0), 1.3,
        "#0c1418", "dawntime", 200, SOURCE_PARAMS,
        "A ship across the light: spokes and rings; the clear colour is not grey.",
        size=(180, 320), albedo="#a09880",
    )  # fmt: skip


def satellite() -> Stage:
    """A slim body, four wings of solar cells, thin struts and a dish."""
    craft = [
        rod(1.5, 9, at=(0, 0, 0)),
        box(3.4, 3, 3.4, at=(0, 5, 0)),
        box(2.6, 2.4, 2.6, at=(0, -5, 0)),
        ring(1.9, 0.25, at=(0, 8.6, 0), turn=(70, 20, 0)),
        strut(0.16, (0, 6, 0), (0, 8.8, 0)),
    ]
    for side in (-1, 1):
        for y in (-4.6, 4.6):
            craft += [
                box(2.3, 4.6, 0.2, at=(side * (6.2 + 2.75 * i), y, 0), turn=(18, 0, 0))
                for i in range(4)
            ]
            for end in (-1.4, 1.4):
                craft += [strut(0.16, (0, y * 0.9, 0), (5.2 * side, y + end, 0))]
                craft += [strut(0.12, (5.2 * side, y + end, 0), (15.4 * side, y + end, 0))]
    return Stage(
        placed(craft, (0, 5, 75), (8, -18, -9), 1.7), (-10, 6, 110), (-8, 25, 0), 15,
        "#1a1a1a", "dawntime", 200, mitchell_params(0.05, 0.985, 0.85, 0.6),
        "Solar cells and struts before a light away from the middle; clear colour #1a1a1a.",
        size=(180, 320), antialias=False,
    )  # fmt: skip


def warehouse() -> Stage:
    """A dark hall: a barred window, a beam, a lamp and crates."""
    walls = [
        box(3, 8, 0.2, at=(-3.2, 0, 0)),
        box(3, 8, 0.2, at=(3.2, 0, 0)),
        box(4, 3, 0.2, at=(0, 2.9, 0)),
        box(4, 3, 0.2, at=(0, -2.5, 0)),
        floor(12, 6, at=(0, -1.6, 3)),
    ]
    hall = [part | {"colour": "#030303"} for part in walls]
    hall += [box(0.34 if i % 2 else 0.42, 3, 0.12, at=(0.56 * i, 0.2, 0)) for i in range(-3, 4)]
    hall += [box(3.6, 0.32, 0.12, at=(0, y, 0)) for y in (-0.9, -0.28, 0.3, 0.86, 1.4)]
    hall += [
        box(0.8, 0.8, 0.8, at=(-1.15, -1.2, 0.9), turn=(0, 20, 0)),
        box(0.6, 0.6, 0.6, at=(-1.05, -0.5, 0.9), turn=(0, -12, 0)),
        box(0.9, 0.9, 0.9, at=(1.15, -1.15, 0.7), turn=(0, -30, 0)),
        box(5, 0.13, 0.13, at=(0, 1.05, 0.6), turn=(0, 0, 13)),
        rod(0.025, 1.6, at=(0.42, 1.25, 0.6)),
        ball(0.2, at=(0.42, 0.42, 0.6)),
    ]
    return Stage(
        hall, (0.35, -0.2, 3.4), (0.1, 0.2, -4), 1.25, "#0a0a0a", "dawntime", 200,
        mitchell_params(0.2, 0.99, 0.8, 0.8), "Light through window bars, at a high exposure.",
    )  # fmt: skip


def table() -> Stage:
    """A table with things on it, before a low light."""
    things = [
        box(3.4, 0.14, 1.5, at=(0, 0, 0)),
        *(rod(0.07, 1.5, at=(x, -0.8, z)) for x in (-1.55, 1.55) for z in (-0.6, 0.6)),
        box(3.0, 0.05, 0.05, at=(0, -0.9, 0.6)),
        ball(0.27, at=(-0.95, 0.34, 0.2)),
        ring(0.3, 0.07, at=(0.5, 0.44, 0.1), turn=(0, 25, 0)),
        rod(0.14, 0.55, at=(-0.3, 0.35, -0.1)),
        rod(0.05, 0.4, at=(-0.3, 0.8, -0.1)),
        box(0.6, 0.1, 0.45, at=(1.2, 0.12, 0), turn=(0, 20, 0)),
        box(0.5, 0.09, 0.4, at=(1.2, 0.215, 0), turn=(0, -15, 0)),
        rod(0.11, 0.24, at=(1.2, 0.38, 0)),
        ring(0.08, 0.025, at=(1.35, 0.38, 0)),
    ]
    things = placed(things, (0, -0.3, 2.6), (0, 18, 0))
    things.append(floor(9, 4, at=(0, -1.86, 2.6)) | {"colour": "#010101"})
    return Stage(
        things, (0.2, 0.25, 6.6), (-0.2, -0.5, -1), 1.35, VESPER_CLEAR, "vesper", 150,
        SOURCE_PARAMS, "A table, and what stands on it, before a low light.", albedo="#9c6b42",
    )  # fmt: skip


ORBIT_RADIANS = 0.009
"""Radians that the icosahedron moves round the light in an update, as in the source."""


def icosahedra(update: float) -> Stage:
    """An icosahedron that orbits the light as in the source's updates, smaller ones further in."""
    a, turn = ORBIT_RADIANS * update, np.rad2deg(update)
    things = [ball(1, at=(4 * np.sin(a), 0, 4 * np.cos(a)), turn=(0.01 * turn, 0.005 * turn, 0))]
    for k in range(1, 6):
        b, height = a + np.pi * k / 3, 0.45 * np.sin(2.4 * k)
        at = 2.7 * np.sin(b), height, 2.7 * np.cos(b)
        things.append(ball(0.55, at=at, turn=(0.006 * turn, 40 * k, 0.012 * turn)))
    known = [f"object[{i}].{key}" for i in range(6) for key in ("position", "rotation")]
    return Stage(
        [part | {"subdivisions": 0} for part in things], (0, 0, 8), (0, 0, 0), 1.5, "#080808",
        "dawntime", 140, mitchell_params(0.08, 0.975, 0.8, 0.6),
        "Icosahedra going round the light.", size=(128, 128), known=tuple(known),
    )  # fmt: skip


FLIGHT_PATH = (
    (0.6, 0.75, 3.2), (1.8, 0.5, 2.4), (1.3, -0.6, 1.8), (0.0, 0.2, 1.7), (-1.2, 0.85, 2.2),
    (-1.9, 0.1, 3.0), (-0.9, -0.55, 3.5),
)  # fmt: skip
"""The points of the closed path that the leading craft follows, before the light."""

NEAR_POINT = 0.4
"""Distance from a point of the path at which the craft turns to the next."""

FLIGHT_SPEEDS = 1.5, 1.4
"""Largest speeds of the leading craft and of its pursuer, a second."""

FLIGHT_UPDATES = 679
"""Updates of a lap."""


@functools.cache
def lap() -> Flight:
    """One lap of both craft."""
    return flown(FLIGHT_PATH, NEAR_POINT, FLIGHT_SPEEDS)


def craft(at: np.ndarray, heading: np.ndarray, size: float) -> list[Part]:
    """A small craft at a position, its nose in the direction ``heading``."""
    back = -heading / np.linalg.norm(heading)
    right = np.cross([0, 1, 0], back)
    right /= np.linalg.norm(right)
    parts = [
        rod(0.16, 1.5, at=(0, 0, 0), turn=(90, 0, 0), segments=16),
        ball(0.16, at=(0, 0, -0.75), subdivisions=2),
        box(1.7, 0.07, 0.42, at=(0, 0, 0.1)),
        box(0.7, 0.06, 0.25, at=(0, 0, 0.68)),
        box(0.07, 0.45, 0.3, at=(0, 0.25, 0.65)),
    ]
    turn = np.stack([right, np.cross(back, right), back], 1)
    return placed(parts, (float(at[0]), float(at[1]), float(at[2])), turn, size)


def flight(update: float) -> Stage:
    """One craft on a closed path before the light, a second in pursuit, gates, and rocks."""
    flight = lap()
    count = len(flight.leader)
    k = int(update) % count
    parts = craft(flight.leader[k], flight.leader_velocity[k], 0.85)
    parts += craft(flight.pursuer[k], flight.pursuer_velocity[k], 0.65)
    for gate in (0.18, 0.7):
        at, onwards = (z[int(gate * count)] for z in (flight.leader, flight.leader_velocity))
        turn = (0.0, float(np.rad2deg(np.arctan2(onwards[0], onwards[2]))), 0.0)
        parts += placed([ring(0.55, 0.06, at=(0, 0, 0))], (at[0], at[1], at[2]), turn)
    for k in range(1, 12):  # rocks on a spiral
        out, turn = 0.36 * k**0.5, 2.4 * k
        at = (out * np.cos(turn), out * np.sin(turn), 1.2)
        parts.append(ball(0.1 + 0.09 * (0.618 * k % 1), at=at, turn=(50 * k, 0, 0), subdivisions=1))
    return Stage(
        parts, (0.6, 0.7, 6.4), (0, 0, 0), 0.85, VESPER_CLEAR, "vesper", 150,
        SOURCE_PARAMS, "A craft on a closed path and one that pursues it.",
        size=(128, 128), antialias=False, known=("object[0].position", "object[5].position"),
        albedo="#8088a0",
    )  # fmt: skip


STAGES: dict[str, Callable[[], Stage]] = {
    "skull": skull, "ship": ship, "satellite": satellite, "warehouse": warehouse, "table": table,
}  # fmt: skip
"""Scenes that do not move, by name."""

SEQUENCE_FRAMES = 6
"""Frames of a moving scene that have targets, spread over its lap."""


class Sequence(NamedTuple):
    """A moving scene: the ``stage`` at an update, the updates of a ``lap``, the update of the
    ``first`` frame, and the updates between two frames, ``step``."""

    stage: Callable[[float], Stage]
    lap: float
    first: int
    step: int


SEQUENCES = {
    "icosahedra": Sequence(icosahedra, 2 * np.pi / ORBIT_RADIANS, 20, 60),
    "flight": Sequence(flight, FLIGHT_UPDATES, 10, FLIGHT_UPDATES // SEQUENCE_FRAMES),
}
"""Scenes that move, by name."""
