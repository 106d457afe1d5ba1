"""TOML tables whose every key is asked for once, with errors that name the file and the key."""

from __future__ import annotations

import difflib
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from godfit.errors import InputError

Colour = tuple[float, float, float]


class Table:
    """A table of the file; every key is asked for once, and what is left over is an error."""

    def __init__(self, path: Path, name: str, data: Any) -> None:
        self.path, self.name = path, name
        self.asked: dict[str, None] = {}
        if not isinstance(data, dict):
            raise InputError(f"'{path}': {name}: expected a table, got {data!r}")
        self.data = data

    @staticmethod
    def read(path: Path, what: str) -> Table:
        """The whole file; raises InputError where it is none: it should be ``what``."""
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(f"'{path}': expected {what}, got no such file") from None
        except (OSError, ValueError) as error:  # Not UTF-8, not TOML, or a null in the path.
            raise InputError(f"'{path}': expected TOML, got {error}; mend the file") from error
        return Table(path, "", data)

    def error(self, key: str, expected: str, got: str) -> InputError:
        where = f"{self.name}.{key}" if self.name else key
        return InputError(f"'{self.path}': {where}: expected {expected}, got {got}")

    def get(self, key: str, default: Any, expected: str) -> Any:
        self.asked[key] = None
        value = self.data.get(key, default)
        if value is None:
            raise self.error(key, expected, "nothing; add it")
        return value

    def table(self, key: str, default: Any = None) -> Table:
        return Table(self.path, key, self.get(key, default, f"a table [{key}]"))

    def tables(self, key: str) -> list[Any]:
        value = self.get(key, [], "tables")
        if not isinstance(value, list):
            raise self.error(key, f"tables [[{key}]]", f"one table; write [[{key}]]")
        return value

    def text(self, key: str) -> str | None:
        self.asked[key] = None
        value = self.data.get(key)
        if value is not None and not isinstance(value, str):
            raise self.error(key, "text", repr(value))
        return value

    def switch(self, key: str) -> bool | None:
        self.asked[key] = None
        value = self.data.get(key)
        if value is not None and not isinstance(value, bool):
            raise self.error(key, "true or false", repr(value))
        return value

    def number(
        self,
        key: str,
        default: float | None = None,
        above: float = -np.inf,
        below: float = np.inf,
    ) -> float:
        expected = "a finite number"
        if above > -np.inf:
            expected += f" above {above:g}"
        if below < np.inf:
            expected += f" and below {below:g}"
        value = self.get(key, default, expected)
        if not is_number(value) or not above < value < below:
            raise self.error(key, expected, repr(value))
        return float(value)

    def whole(self, key: str, least: int, most: int, default: int | None = None) -> int:
        expected = f"a whole number from {least} to {most}"
        value = self.get(key, default, expected)
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            raise self.error(key, expected, repr(value))
        return value

    def three(
        self, key: str, default: list[float] | None = None, above: float = -np.inf
    ) -> list[float]:
        expected = "three finite numbers" + (f" above {above:g}" if above > -np.inf else "")
        value = self.get(key, default, expected)
        if (
            not isinstance(value, list)
            or len(value) != 3
            or not all(is_number(v) and v > above for v in value)
        ):
            raise self.error(key, expected, repr(value))
        return [float(v) for v in value]

    def colour(self, key: str, default: str) -> Colour:
        expected = '"#rrggbb" or three numbers from 0 to 1'
        value = self.get(key, default, expected)
        if isinstance(value, str) and re.fullmatch(r"#([0-9a-fA-F]{3}){1,2}", value):
            digits = value[1:] if len(value) == 7 else "".join(2 * c for c in value[1:])
            r, g, b = (int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4))
            return r, g, b
        if (
            isinstance(value, list)
            and len(value) == 3
            and all(is_number(v) and 0 <= v <= 1 for v in value)
        ):
            return float(value[0]), float(value[1]), float(value[2])
        raise self.error(key, expected, repr(value))

    def may_have(self, *keys: str) -> None:
        """Keys that are no error though nobody may ask for them."""
        self.asked |= dict.fromkeys(keys)

    def finish(self) -> None:
        """Raise for keys that nobody asked for."""
        for key in self.data:
            if key not in self.asked:
                near = difflib.get_close_matches(key, self.asked, n=1, cutoff=0.0)
                raise self.error(
                    key, f"one of {', '.join(self.asked)}", f"this key; did you mean '{near[0]}'?"
                )


def is_number(value: Any) -> bool:
    # Finite in float32 as well; whole numbers in TOML may be of any length.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e18
