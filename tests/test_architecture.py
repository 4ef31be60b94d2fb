"""The layout: small rooms and files, no circles, one meaning a class name, and a page that lists every file."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(path.relative_to(ROOT) for room in ("mavdem", "sitl_scenarios") for path in (ROOT / room).rglob("*.py"))

MAX_LINES, MAX_FILES = 400, 15


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse((ROOT / path).read_text())


def module_of(path: Path) -> str:
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in FILES}


def imports(path: Path) -> set[str]:
    """Modules of ours that a file imports, also inside functions and for type checkers only."""
    found: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name in MODULES}


def test_imports_have_no_circle():
    graph = {module_of(path): imports(path) - {module_of(path)} for path in FILES}
    # It raises CycleError, with the circle, where there is one.
    assert len(list(TopologicalSorter(graph).static_order())) == len(FILES)


@pytest.mark.parametrize("path", FILES, ids=str)
def test_a_file_is_not_long(path):
    assert len((ROOT / path).read_text().splitlines()) <= MAX_LINES


@pytest.mark.parametrize("room", sorted({path.parent for path in FILES}), ids=str)
def test_a_room_is_not_crowded(room):
    names = [path.name for path in FILES if path.parent == room and path.name != "__init__.py"]
    assert len(names) <= MAX_FILES, f"{room} holds {len(names)} files"


@pytest.mark.parametrize("room", sorted({path.parent for path in FILES}), ids=str)
def test_a_module_is_not_shadowed_by_a_function_of_its_own_name(room):
    package = importlib.import_module(".".join(room.parts))
    for path in FILES:
        if path.parent == room and path.name != "__init__.py":
            importlib.import_module(module_of(path))
            assert inspect.ismodule(getattr(package, path.stem)), f"{package.__name__}.{path.stem} is no module"


def test_a_class_name_has_one_meaning():
    places: dict[str, list[str]] = defaultdict(list)
    for path in FILES:
        for node in tree(path).body:
            if isinstance(node, ast.ClassDef):
                places[node.name.lstrip("_")].append(str(path))
    assert not {name: paths for name, paths in places.items() if len(paths) > 1}


def test_the_architecture_page_lists_every_file():
    printed = subprocess.run([sys.executable, "tools/architecture"], cwd=ROOT, capture_output=True, check=True).stdout
    page = (ROOT / "docs" / "architecture.md").read_bytes()
    assert page == printed, "write the list anew: tools/architecture --write"
    assert all(f"- `{path}`: ".encode() in page for path in FILES if path.name != "__init__.py")
