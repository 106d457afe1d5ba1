"""The structure of the package: rooms, the one way in which imports go, and sizes.

A room may use any room below it and none above or beside it. Imports inside functions and under
TYPE_CHECKING count too.
"""

import ast
import itertools
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "godfit"
FLOORS = (
    {"errors"},
    {"runtime"},
    {"io"},
    {"scattering"},
    {"scenes"},
    {"models"},
    {"inference"},
    {"search", "blind", "flatland", "report"},
    {"request"},
    {"fitting"},
    {"studies"},
    {"commands"},
    {"__main__"},
)
"""Rooms from the ground up."""
FLOOR = {room: i for i, rooms in enumerate(FLOORS) for room in rooms}
MOST_FILES_AT_THE_TOP = 8
MOST_FILES_IN_A_ROOM = 20
WITHOUT_LIMIT = {"flatland"}
MOST_PARAMETERS = 6
MOST_LONG_SIGNATURES = 30
LONGEST_CHAIN = 12


def files():
    return sorted(PACKAGE.rglob("*.py"))


def room_of(module: str) -> str:
    """``godfit.inference.noise`` -> ``inference``."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def module_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(tree: ast.AST, module: str) -> set[str]:
    """Modules of the package that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            assert node.module is not None
            if node.module == "godfit":
                # A room, a module at the top, or one of the public names.
                found |= {f"godfit.{alias.name}" for alias in node.names}
            else:
                found.add(node.module)
    return {name for name in found if name.split(".")[0] == "godfit"}


def arrows() -> dict[tuple[str, str], list[str]]:
    """(from, to) rooms and the modules between which the imports go."""
    found: dict[tuple[str, str], list[str]] = {}
    for path in files():
        module = module_of(path)
        for name in imported(ast.parse(path.read_text()), module):
            pair = room_of(module), room_of(name)
            if pair[0] != pair[1]:
                found.setdefault(pair, []).append(f"{module} -> {name}")
    return found


def test_imports_go_down():
    up = []
    for (upper, lower), modules in arrows().items():
        if upper == "__init__":
            # The public names come from every room.
            continue
        assert lower in FLOOR, f"{lower} is no room: {modules}"
        if FLOOR[lower] >= FLOOR[upper]:
            up += modules
    assert up == []


def test_an_import_that_goes_up_would_be_found():
    code = """
from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from godfit.fitting import fit
def late():
    from godfit import request
    import godfit.studies.select
"""
    found = imported(ast.parse(code), "godfit.io.image")
    assert found == {"godfit.fitting", "godfit.request", "godfit.studies.select"}
    assert all(FLOOR[room_of(name)] > FLOOR["io"] for name in found)


def test_chain_of_rooms():
    below: dict[str, set[str]] = {}
    for upper, lower in arrows():
        if upper not in ("__init__", "__main__"):
            below.setdefault(upper, set()).add(lower)

    def longest(room: str) -> int:
        return 1 + max((longest(other) for other in below.get(room, ())), default=0)

    assert max(map(longest, below)) <= LONGEST_CHAIN


def test_every_file_has_a_room():
    top = [path for path in PACKAGE.iterdir() if path.is_file()]
    assert len(top) <= MOST_FILES_AT_THE_TOP, top
    for folder in {path.parent for path in files()} - {PACKAGE}:
        if folder.relative_to(PACKAGE).parts[0] not in WITHOUT_LIMIT:
            count = len(list(folder.glob("*.py")))
            assert count <= MOST_FILES_IN_A_ROOM, (folder.name, count)


def functions():
    """(where, function) of every function outside ``blind``."""
    for path in files():
        if "blind" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{path.relative_to(PACKAGE)}: {node.name}", node


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    of = function.args
    names = [a.arg for a in (*of.posonlyargs, *of.args, *of.kwonlyargs)]
    names += [a.arg for a in (of.vararg, of.kwarg) if a is not None]
    return names[names[:1] in (["self"], ["cls"]) :]


def test_few_functions_take_many_parameters():
    long = [where for where, node in functions() if len(parameters(node)) > MOST_PARAMETERS]
    assert len(long) <= MOST_LONG_SIGNATURES, long


COORDINATES = {"free", "held", "coordinates", "z"}


def test_coordinates_are_found_by_name():
    """No number, and no slice of numbers, picks a coordinate outside ``models`` and the rooms whose
    own model it is."""
    found = []
    for path in files():
        room = path.relative_to(PACKAGE).parts[0]
        if room in ("models", "blind", "flatland"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Subscript):
                continue
            owner = node.value
            name = owner.attr if isinstance(owner, ast.Attribute) else getattr(owner, "id", "")
            ends = [node.slice]
            if isinstance(node.slice, ast.Slice):
                ends = [node.slice.lower, node.slice.upper]
            ends = [e.operand if isinstance(e, ast.UnaryOp) else e for e in ends]
            numbers = [e for e in ends if isinstance(getattr(e, "value", None), int)]
            if name in COORDINATES and numbers:
                found.append(f"{path.relative_to(PACKAGE)}:{node.lineno}")
    assert found == []


@pytest.mark.parametrize("folder", ["tests", "experiments"])
def test_what_is_shared_lies_in_support(folder):
    """No test imports a script or another test, and no script a test."""
    root = PACKAGE.parent
    scripts = {path.stem for path in (root / "experiments").rglob("*.py")}
    tests = {path.stem for path in (root / "tests").rglob("test_*.py")}
    found = []
    for path in (root / folder).rglob("*.py"):
        beside = {other.stem for other in path.parent.glob("*.py")}
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            for name in names:
                first, last = name.split(".")[0], name.split(".")[-1]
                script = folder == "tests" and (first == "experiments" or name in scripts)
                test = last in tests or (first == "tests" and "support" not in name)
                if (script and name not in beside) or test:
                    found.append(f"{path.relative_to(root)}: {name}")
    assert found == []


def test_rooms_are_those_of_the_package():
    folders = {path.parent.relative_to(PACKAGE).parts[:1] for path in files()}
    rooms = set(itertools.chain(*folders)) | {p.stem for p in PACKAGE.glob("*.py")}
    assert rooms - {"__init__"} == set(FLOOR)
