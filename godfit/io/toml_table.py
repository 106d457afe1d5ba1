"""Tables of a TOML file and the checks of their values; errors name the file and the key.

A reader of a TOML file requests its keys by the methods of a ``Table``, which check the values. It
then calls ``finish``, which raises for all other keys. All of them raise InputError.
"""

from __future__ import annotations

import difflib
import os
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from godfit.errors import InputError, shown
from godfit.io.regular_files import MAX_TEXT_BYTES, read_regular

Colour = tuple[float, float, float]

MAX_TOML_NUMBER = 1e18
"""Numbers must be smaller: their squares are then finite in float32. TOML's whole numbers may be of
any length."""
MIN_POLYGON_POINTS = 3
"""Fewest points of a polygon with an area."""

VALUE_KINDS: dict[type, tuple[tuple[type, ...], str]] = {
    str: ((str,), "text"),
    int: ((int,), "a whole number"),
    float: ((int, float), "a number"),
    bool: ((bool,), "true or false"),
}
"""Python's types of the values of a kind, and the kind's name in errors."""


class Table:
    """A table of a TOML file: ``name`` is its own, empty for the whole file."""

    def __init__(self, path: Path, name: str, data: Any) -> None:
        self.path, self.name = path, name
        # The keys that were requested or allowed, in order: a set, as dicts keep their order.
        self.known: dict[str, None] = {}
        if not isinstance(data, dict):
            raise InputError(f"'{path}': {name}: expected a table, got {shown(data)}")
        self.data = data

    @staticmethod
    def read(path: Path, what: str) -> Table:
        """The whole file. Raises InputError where it is missing, which names ``what`` it should
        be, and where it is not TOML."""
        try:
            if not os.path.exists(path) and "\0" not in str(path):
                raise InputError(f"'{path}': expected {what}, got no such file")
            data = tomllib.loads(read_regular(path, "TOML", MAX_TEXT_BYTES).decode("utf-8-sig"))
        except InputError:
            raise
        except RecursionError:
            raise InputError(f"'{path}': expected TOML, got brackets nested too deeply") from None
        except (OSError, ValueError) as error:  # Not UTF-8, not TOML, or a null in the path.
            raise InputError(f"'{path}': expected TOML, got {error}; mend the file") from error
        return Table(path, "", data)

    def error(self, key: str, expected: str, got: str) -> InputError:
        """The error for a key of this table, to be raised."""
        where = f"{self.name}.{key}" if self.name else key
        return InputError(f"'{self.path}': {where}: expected {expected}, got {got}")

    def get(self, key: str, default: Any, expected: str) -> Any:
        """The unchecked value of ``key``, or the default; raises if there is neither."""
        self.known[key] = None
        value = self.data.get(key, default)
        if value is None:
            raise self.error(key, expected, "nothing; add it")
        return value

    def optional(self, key: str, kind: type) -> Any:
        """A value of one of VALUE_KINDS; None if the key is missing."""
        self.known[key] = None
        value = self.data.get(key)
        types, expected = VALUE_KINDS[kind]
        # Python counts True and False as whole numbers.
        wrong = not isinstance(value, types) or (isinstance(value, bool) and kind is not bool)
        if value is not None and wrong:
            raise self.error(key, expected, shown(value))
        return value

    def text(self, key: str) -> str | None:
        """A text; None if the key is missing."""
        return self.optional(key, str)

    def switch(self, key: str) -> bool | None:
        """True or false; None if the key is missing."""
        return self.optional(key, bool)

    def table(self, key: str, default: Any = None) -> Table:
        """The table [key]."""
        return Table(self.path, key, self.get(key, default, f"a table [{key}]"))

    def tables(self, key: str) -> list[Any]:
        """The data of the tables [[key]], none if the key is missing."""
        value = self.get(key, [], "tables")
        if not isinstance(value, list):
            raise self.error(key, f"tables [[{key}]]", f"one table; write [[{key}]]")
        return value

    def number(
        self,
        key: str,
        default: float | None = None,
        above: float = -np.inf,
        below: float = np.inf,
    ) -> float:
        """A finite number between ``above`` and ``below``, both excluded."""
        expected = "a finite number"
        if above > -np.inf:
            expected += f" above {above:g}"
        if below < np.inf:
            expected += f" and below {below:g}"
        value = self.get(key, default, expected)
        if not is_number(value) or not above < value < below:
            raise self.error(key, expected, shown(value))
        return float(value)

    def whole(self, key: str, least: int, most: int, default: int | None = None) -> int:
        """A whole number from ``least`` to ``most``, both included."""
        expected = f"a whole number from {least} to {most}"
        value = self.get(key, default, expected)
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            raise self.error(key, expected, shown(value))
        return value

    def numbers(
        self,
        key: str,
        count: int,
        default: list[float] | None = None,
        above: float = -np.inf,
    ) -> list[float]:
        """``count`` finite numbers greater than ``above``; two or three."""
        expected = {2: "two", 3: "three"}[count] + " finite numbers"
        if above > -np.inf:
            expected += f" above {above:g}"
        value = self.get(key, default, expected)
        if not _are_numbers(value, count) or not all(v > above for v in value):
            raise self.error(key, expected, shown(value))
        return [float(v) for v in value]

    def three(
        self, key: str, default: list[float] | None = None, above: float = -np.inf
    ) -> list[float]:
        """Three finite numbers greater than ``above``: a position or a direction."""
        return self.numbers(key, 3, default, above)

    def points(self, key: str) -> list[list[float]]:
        """The points (n, 2) of a polygon, three or more."""
        expected = "three or more places [x, y]"
        value = self.get(key, None, expected)
        if (
            not isinstance(value, list)
            or len(value) < MIN_POLYGON_POINTS
            or not all(_are_numbers(point, 2) for point in value)
        ):
            raise self.error(key, expected, shown(value))
        return [[float(x), float(y)] for x, y in value]

    def colour(self, key: str, default: str | list[float]) -> Colour:
        """A colour (r, g, b), each from 0 to 1; "#rrggbb" and "#rgb" are bytes, not decoded."""
        expected = '"#rrggbb" or three numbers from 0 to 1'
        value = self.get(key, default, expected)
        if isinstance(value, str) and re.fullmatch(r"#([0-9a-fA-F]{3}){1,2}", value):
            digits = value[1:] if len(value) == 7 else "".join(2 * c for c in value[1:])
            r, g, b = (int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4))
            return r, g, b
        if isinstance(value, list) and _are_numbers(value, 3) and all(0 <= v <= 1 for v in value):
            return float(value[0]), float(value[1]), float(value[2])
        raise self.error(key, expected, shown(value))

    def may_have(self, *keys: str) -> None:
        """Allow keys that need not be requested."""
        self.known |= dict.fromkeys(keys)

    def finish(self) -> None:
        """Raise for a key that was neither requested nor allowed, naming the closest known one."""
        for key in self.data:
            if key not in self.known:
                closest = difflib.get_close_matches(key, self.known, n=1, cutoff=0.0)
                got = f"this key; did you mean '{closest[0]}'?"
                raise self.error(key, f"one of {', '.join(self.known)}", got)


def is_number(value: Any) -> bool:
    """Whether a value of a TOML file is a number that is finite in float32."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and abs(value) < MAX_TOML_NUMBER


def _are_numbers(value: Any, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(map(is_number, value))
