"""The layout: rooms on floors, libraries in their rooms, files that can be read, and rooms within their budgets."""

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = sorted(path.relative_to(ROOT) for room in ("mavdem", "sitl_scenarios") for path in (ROOT / room).rglob("*.py"))
TOOLS = sorted(path.relative_to(ROOT) for path in [*(ROOT / "tools").rglob("*.py"), ROOT / "docs" / "conf.py"])
MODULES = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in FILES}

MAX_LINES = 500
"""Of one file: a chapter, not a book."""

FLOORS = (
    {"confidence", "documents", "errors", "files", "forecaster"},
    {"flight"},
    {"ingest"},
    {"alignment"},
    {"dem"},
    {"condition"},
    {"health"},
    {"baselines"},
    {"evaluate"},
    {"analysis"},
    {"fleet", "live"},
    {"report"},
    {"export", "view"},
    {"paper"},
    {"__init__"},
    {"cli"},
    {"__main__"},
)
"""The way of the data: a room imports itself and rooms on floors below its own."""

ROOMS_OF_LIBRARIES = {
    "rerun": {"view"},
    "pymavlink": {"ingest", "live"},
    "mcap": {"ingest"},
    "mcap_ros2": {"ingest"},
    "zstandard": {"ingest"},
    "lz4": {"ingest"},
    "pyulog": {"ingest"},
    "pyarrow": {"export", "fleet"},
    "fsspec": {"fleet"},
    "distributed": {"fleet"},
    "pebble": {"fleet"},
    "pandas": {"export"},
    "xarray": {"export"},
    "control": {"export"},
    "click": {"cli"},
    "rich": {"cli"},
    "matplotlib": {"paper", "report"},
    "jinja2": {"report"},
    "sitl_scenarios": {"cli", "paper"},
}
"""The only rooms of mavdem that may import a library."""

ARRAYS = sys.stdlib_module_names | {"numpy", "scipy", "threadpoolctl", "pydantic"}
USED_BY = {
    "mavdem.dem": {"mavdem.dem", "mavdem.confidence", "mavdem.documents", "mavdem.errors"},
    "mavdem.health": {"mavdem.health", "mavdem.confidence", "mavdem.alignment", "mavdem.dem", "mavdem.condition"},
    "sitl_scenarios": {"sitl_scenarios", "mavdem.errors", "mavdem.files", "mavdem.ingest.mavlink"}
    | {"mavdem.ingest.controllers"},
}
"""Rooms that know arrays only, and what of ours they may use: no file, link or viewer."""


@cache
def imported(path: Path) -> frozenset[str]:
    """Full names of what a file imports, also inside functions and for type checkers only."""
    names: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def module_of(name: str) -> str | None:
    """The module of ours that an imported name is or stands in."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name or None


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else "__init__"


def floor(room: str) -> int:
    found = [number for number, rooms in enumerate(FLOORS) if room in rooms]
    assert len(found) == 1, f"{room} has no floor: say where in the flow it is"
    return found[0]


def against_the_flow() -> Iterator[str]:
    for module, path in MODULES.items():
        library, here = module.split(".")[0], room_of(module)
        package = next((known for known in USED_BY if module == known or module.startswith(known + ".")), None)
        for name in imported(path):
            source = module_of(name)
            if source is None:
                outside = name.split(".")[0]
                if library == "mavdem" and here not in ROOMS_OF_LIBRARIES.get(outside, {here}):
                    yield f"{path} imports {name}: only {ROOMS_OF_LIBRARIES[outside]} may"
                if package and outside not in ARRAYS:
                    yield f"{path} imports {name}: {package} knows arrays only"
            elif package and not any(source == used or source.startswith(used + ".") for used in USED_BY[package]):
                yield f"{path} imports {name}: {package} knows {sorted(USED_BY[package])} only"
            elif source.split(".")[0] == library == "mavdem" and room_of(source) != here:
                if floor(room_of(source)) >= floor(here):
                    yield f"{path} imports {name}, which is downstream"
            elif source.split(".")[0] != library == "mavdem" and here not in ROOMS_OF_LIBRARIES["sitl_scenarios"]:
                yield f"{path} imports {name}: only {ROOMS_OF_LIBRARIES['sitl_scenarios']} may"


def test_nothing_imports_against_the_flow():
    assert not list(against_the_flow())


def test_imports_have_no_circle():
    graph = {module: {module_of(name) for name in imported(path)} - {module, None} for module, path in MODULES.items()}
    # It raises CycleError, with the circle, where there is one.
    assert len(list(TopologicalSorter(graph).static_order())) == len(FILES)


def test_a_file_is_not_long():
    lengths = {str(path): lines_of(path) for path in FILES}
    assert not {path: lines for path, lines in lengths.items() if lines > MAX_LINES}


BUDGETS = {
    "mavdem": 755,
    "ingest": 5585,
    "alignment": 2010,
    "condition": 1985,
    "dem": 8665,
    "health": 1030,
    "baselines": 905,
    "evaluate": 1220,
    "live": 2980,
    "analysis": 1005,
    "fleet": 1855,
    "report": 3575,
    "view": 1355,
    "export": 385,
    "paper": 1755,
    "cli": 2570,
    "sitl_scenarios": 3600,
    "tools": 1270,
}
"""Lines of Python a room may have, docstrings counted: what a new capability needs, something older gives back."""
ALL_LINES, ALL_FILES, TEST_LINES = 42_480, 208, 22_885


def lines_of(path: Path) -> int:
    return len((ROOT / path).read_text().splitlines())


def test_a_room_stays_within_its_budget():
    sizes = Counter[str]()
    for path in [*FILES, *TOOLS]:
        room = path.parts[1] if path.parts[0] == "mavdem" and len(path.parts) > 2 else path.parts[0]
        sizes["tools" if path in TOOLS else room] += lines_of(path)
    assert not {room: lines for room, lines in sizes.items() if lines > BUDGETS.get(room, 0)}
    assert sum(sizes.values()) <= ALL_LINES
    assert len(FILES) + len(TOOLS) <= ALL_FILES
    assert sum(map(lines_of, (ROOT / "tests").rglob("*.py"))) <= TEST_LINES
