"""PLY files: vertices, polygons and triangle strips (Turk 1994, "The PLY Polygon File Format")."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from godfit.errors import InputError

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
"""The names of a PLY file's numbers, old and new, and NumPy's."""
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""By format, NumPy's sign of the order of bytes; none for text."""
CORNER_LISTS = ("vertex_indices", "vertex_index")
"""Names of the list that holds a face's or a strip's corners."""
STRIP_END = -1
"""Index in a list of strips that ends a strip."""


class Property(NamedTuple):
    """A property of an element: its name, the type of its numbers, and that of a list's length
    (None for a single number)."""

    name: str
    kind: str
    count: str | None


class Element(NamedTuple):
    """An element of a file: its name, how many there are, and their properties."""

    name: str
    rows: int
    properties: tuple[Property, ...]


Columns = dict[str, np.ndarray | list[np.ndarray]]
"""The properties of an element by name: (rows,) numbers, or for a list one array a row."""


def read_ply(path: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    """The vertices (v, 3) float64 of a PLY file, and its faces as rings of indices; a strip of
    triangles has a ring for each triangle. Raises InputError, ValueError, LookupError."""
    data = path.read_bytes()
    order, elements, start = _header(data)
    source = _Text(data[start:]) if order == "" else _Binary(data[start:], order)
    found: dict[str, Columns] = {}
    for element in elements:
        found[element.name] = source.element(element, path)
    vertex = found["vertex"]
    vertices = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], -1)
    rings: list[np.ndarray] = []
    for name in ("face", "tristrips"):
        columns = found.get(name, {})
        lists = next((columns[key] for key in CORNER_LISTS if key in columns), [])
        if name == "face":
            rings += list(lists)
        else:
            for strip in lists:
                rings += list(strip_triangles(strip))
    return vertices, rings


def strip_triangles(indices: np.ndarray) -> np.ndarray:
    """The triangles (n, 3) of strips (m,) with ``STRIP_END`` after each strip but the last. Every
    second triangle is turned, so that all of a strip face one way."""
    ends = np.flatnonzero(np.asarray(indices) == STRIP_END)
    found = [np.zeros((0, 3), np.int64)]
    for strip in np.split(np.asarray(indices, np.int64), ends):
        strip = strip[strip != STRIP_END]
        triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], -1)
        triangles[1::2] = triangles[1::2][:, [1, 0, 2]]
        found.append(triangles)
    return np.concatenate(found)


def _header(data: bytes) -> tuple[str, list[Element], int]:
    """The order of bytes, the elements, and the byte at which the numbers begin."""
    if not data.startswith(b"ply"):
        raise ValueError("Not a ply file")
    end = data.find(b"end_header")
    if end < 0:
        raise ValueError("no end of the header")
    order, elements = None, []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        key, *rest = line.split() or [""]
        if key == "format":
            order = ORDERS[rest[0]]
        elif key == "element":
            elements.append(Element(rest[0], int(rest[1]), ()))
        elif key == "property":
            count = TYPES[rest[1]] if rest[0] == "list" else None
            made = Property(rest[-1], TYPES[rest[-2]], count)
            elements[-1] = elements[-1]._replace(properties=(*elements[-1].properties, made))
    if order is None:
        raise ValueError("no format in the header")
    return order, elements, data.index(b"\n", end) + 1


class _Text:
    """The numbers of a text file, from the first on."""

    def __init__(self, data: bytes) -> None:
        self.numbers = np.array(data.split(), np.float64)
        self.at = 0

    def element(self, element: Element, path: Path) -> Columns:
        found = self._equal_rows(element)
        if found is not None:
            return found
        columns: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
        for _ in range(element.rows):
            for p in element.properties:
                count = 1 if p.count is None else int(self._taken(1, element, path)[0])
                values = self._taken(count, element, path)
                columns[p.name].append(values.astype(np.int64) if p.kind[0] in "iu" else values)
        return _joined(columns, element)

    def _equal_rows(self, element: Element) -> Columns | None:
        """The columns where every list is as long as in the first row; None where not, or where
        the file ends before the last row."""
        places, at = [], 0
        for p in element.properties:
            count = 1
            if p.count is not None:
                if self.at + at >= len(self.numbers):
                    return None
                count = int(self.numbers[self.at + at])
                at += 1
            places.append((p, at, count))
            at += count
        numbers = self.numbers[self.at : self.at + at * element.rows]
        if at < 1 or len(numbers) < at * element.rows:
            return None
        rows = numbers.reshape(-1, at)
        columns: Columns = {}
        for p, first, count in places:
            values = rows[:, first : first + count]
            if p.kind[0] in "iu":
                values = values.astype(np.int64)
            if p.count is None:
                columns[p.name] = values[:, 0]
            elif count < 0 or (rows[:, first - 1] != count).any():
                return None
            else:
                columns[p.name] = list(values)
        self.at += numbers.size
        return columns

    def _taken(self, count: int, element: Element, path: Path) -> np.ndarray:
        taken = self.numbers[self.at : self.at + count] if count >= 0 else []
        if len(taken) != count:
            raise _cut(element, path)
        self.at += count
        return np.asarray(taken)


class _Binary:
    """The bytes of a binary file, from the first on."""

    def __init__(self, data: bytes, order: str) -> None:
        self.data, self.order, self.at = data, order, 0

    def element(self, element: Element, path: Path) -> Columns:
        if not element.rows:
            return {p.name: [] for p in element.properties}
        found = self._equal_rows(element)
        return self._rows(element, path) if found is None else found

    def _equal_rows(self, element: Element) -> Columns | None:
        """The columns where every list is as long as in the first row; None where not, or where
        the file ends before the last row."""
        fields, lists, at = [], [], self.at
        for i, p in enumerate(element.properties):
            kind = np.dtype(self.order + p.kind)
            if p.count is None:
                fields.append((f"v{i}", kind))
                at += kind.itemsize
                continue
            length = np.dtype(self.order + p.count)
            if at + length.itemsize > len(self.data):
                return None
            count = int(np.frombuffer(self.data, length, 1, at)[0])
            fields += [(f"n{i}", length), (f"v{i}", kind, (count,))]
            lists.append((f"n{i}", count))
            at += length.itemsize + count * kind.itemsize
        row = np.dtype(fields)
        if self.at + row.itemsize * element.rows > len(self.data):
            return None
        rows = np.frombuffer(self.data, row, element.rows, self.at)
        if any((rows[name] != count).any() for name, count in lists):
            return None
        self.at += row.itemsize * element.rows
        return {
            p.name: rows[f"v{i}"] if p.count is None else list(rows[f"v{i}"])
            for i, p in enumerate(element.properties)
        }

    def _rows(self, element: Element, path: Path) -> Columns:
        columns: dict[str, list[np.ndarray]] = {p.name: [] for p in element.properties}
        for _ in range(element.rows):
            for p in element.properties:
                count = 1
                if p.count is not None:
                    count = int(self._taken(p.count, 1, element, path)[0])
                columns[p.name].append(self._taken(p.kind, count, element, path))
        return _joined(columns, element)

    def _taken(self, kind: str, count: int, element: Element, path: Path) -> np.ndarray:
        dtype = np.dtype(self.order + kind)
        if count < 0 or self.at + count * dtype.itemsize > len(self.data):
            raise _cut(element, path)
        taken = np.frombuffer(self.data, dtype, count, self.at)
        self.at += taken.nbytes
        return taken


def _joined(columns: dict[str, list[np.ndarray]], element: Element) -> Columns:
    """The columns with the numbers of properties that are no lists in one array."""
    return {
        p.name: np.concatenate([np.zeros(0), *columns[p.name]])
        if p.count is None
        else columns[p.name]
        for p in element.properties
    }


def _cut(element: Element, path: Path) -> InputError:
    return InputError(
        f"'{path}': expected {element.rows:,} of the element {element.name}, got fewer; the file "
        "is cut short, export it again"
    )
