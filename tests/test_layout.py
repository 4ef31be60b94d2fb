"""The layout: rooms on floors, libraries in their rooms, files that can be read, and rooms within their budgets."""

import ast
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
FILES = sorted(
    path.relative_to(ROOT)
    for room in ("mavdem", "sitl_scenarios")
    for path in (ROOT / room).rglob("*.py")
)
TOOLS = sorted(
    path.relative_to(ROOT) for path in [*(ROOT / "tools").rglob("*.py"), ROOT / "docs" / "conf.py"]
)
MODULES = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in FILES}

MAX_LINES = 600
"""Of one file: a chapter, not a book."""

FLOORS = (
    {"facts"},
    {
        "confidence",
        "downstream",
        "errors",
        "extras",
        "files",
        "forecaster",
        "grouping",
        "heading",
        "machine",
        "unit_slips",
        "units",
    },
    {"flight"},
    {"ingest"},
    {"alignment"},
    {"dem"},
    {"condition"},
    {"health"},
    {"baselines"},
    {"evaluate"},
    {"analysis"},
    {"assessment"},
    {"fleet", "live"},
    {"report"},
    {"documents", "export", "view"},
    {"results"},
    {"paper"},
    {"api"},
    {"__init__"},
    {"serve"},
    {"cli"},
    {"__main__"},
)
"""The way of the data: a room imports itself and rooms on floors below its own."""

ROOMS_OF_LIBRARIES = {
    "rerun": {"view"},
    "pymavlink": {"ingest", "live"},
    "mcap": {"ingest"},
    "rosbags": {"ingest"},
    "zstandard": {"ingest"},
    "lz4": {"ingest"},
    "pyulog": {"ingest"},
    "pyarrow": {"export", "fleet"},
    "fsspec": {"fleet"},
    "distributed": {"fleet"},
    "pandas": {"export"},
    "xarray": {"export"},
    "control": {"export"},
    "click": {"cli"},
    "rich": {"cli"},
    "matplotlib": {"paper", "report"},
    "jinja2": {"report"},
    "sitl_scenarios": {"cli", "paper"},
    "starlette": {"serve"},
    "uvicorn": {"serve"},
    "python_multipart": {"serve"},
}
"""The only rooms of mavdem that may import a library."""

ARRAYS = sys.stdlib_module_names | {"numpy", "scipy", "threadpoolctl", "pydantic"}
USED_BY = {
    "mavdem.dem": {
        "mavdem.dem",
        "mavdem.confidence",
        "mavdem.downstream",
        "mavdem.heading",
        "mavdem.errors",
        "mavdem.facts",
        "mavdem.unit_slips",
    },
    "mavdem.health": {
        "mavdem.health",
        "mavdem.confidence",
        "mavdem.facts",
        "mavdem.heading",
        "mavdem.alignment",
        "mavdem.dem",
        "mavdem.condition",
    },
    "sitl_scenarios": {
        "sitl_scenarios",
        "mavdem.facts",
        "mavdem.errors",
        "mavdem.files",
        "mavdem.ingest.mavlink",
        "mavdem.ingest.vocabulary",
        "mavdem.condition.loop.controllers",
        "mavdem.condition.loop.filters",
        "mavdem.condition.loop.margins",
    },
}
"""Rooms that know arrays only, and what of ours they may use: no file, link or viewer."""


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    """All syntax nodes of a file, which several tests look at."""
    return list(ast.walk(ast.parse((ROOT / path).read_text())))


@cache
def imported(path: Path) -> frozenset[str]:
    """Full names of what a file imports, also inside functions and for type checkers only."""
    names = set()
    for node in nodes_of(path):
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
        library = module.split(".")[0]
        here = room_of(module)
        package = next(
            (known for known in USED_BY if module == known or module.startswith(known + ".")), None
        )
        for name in imported(path):
            source = module_of(name)
            if source is None:
                outside = name.split(".")[0]
                if library == "mavdem" and here not in ROOMS_OF_LIBRARIES.get(outside, {here}):
                    yield f"{path} imports {name}: only {ROOMS_OF_LIBRARIES[outside]} may"
                if package and outside not in ARRAYS:
                    yield f"{path} imports {name}: {package} knows arrays only"
            elif package and not any(
                source == used or source.startswith(used + ".") for used in USED_BY[package]
            ):
                yield f"{path} imports {name}: {package} knows {sorted(USED_BY[package])} only"
            elif source.split(".")[0] == library == "mavdem" and room_of(source) != here:
                if floor(room_of(source)) >= floor(here):
                    yield f"{path} imports {name}, which is downstream"
            elif (
                source.split(".")[0] != library == "mavdem"
                and here not in ROOMS_OF_LIBRARIES["sitl_scenarios"]
            ):
                yield f"{path} imports {name}: only {ROOMS_OF_LIBRARIES['sitl_scenarios']} may"


def test_nothing_imports_against_the_flow():
    assert not list(against_the_flow())


def test_imports_have_no_circle():
    graph = {
        module: {module_of(name) for name in imported(path)} - {module, None}
        for module, path in MODULES.items()
    }
    # It raises CycleError, with the circle, where there is one.
    assert len(list(TopologicalSorter(graph).static_order())) == len(FILES)


def test_a_file_is_not_long():
    lengths = {str(path): len((ROOT / path).read_text().splitlines()) for path in FILES}
    assert not {path: lines for path, lines in lengths.items() if lines > MAX_LINES}


NODES = {
    "alignment": 19_272,
    "analysis": 8650,
    "assessment": 18_545,
    "baselines": 5250,
    "cli": 17_060,
    "condition": 40_063,
    "dem": 68_601,
    "documents": 10_248,
    "evaluate": 8100,
    "export": 2_549,
    "facts": 4_180,
    "fleet": 15_024,
    "health": 10_584,
    "ingest": 40_695,
    "live": 31_660,
    "mavdem": 5_595,
    "paper": 11_396,
    "report": 32_100,
    "serve": 13_270,
    "sitl_scenarios": 31_396,
    "tools": 15_870,
    "view": 10_820,
}
"""Syntax nodes of Python that a room may have: what a new capability needs, something older gives back."""
ALL_NODES = 419_500
TEST_NODES = 250_000
NODES_A_LINE = 11.0  # condition, health and tools
"""Of code: more is packed, not short."""
ALL_CONSTANTS = 700
"""Named numbers, and tables with numbers: each has a unit, a source and a test at its edge."""


class Size(NamedTuple):
    """Syntax nodes, and lines that are no blanks, comments or docstrings."""

    nodes: int
    lines: int


def size_of(path: Path) -> Size:
    text = (ROOT / path).read_text()
    nodes = nodes_of(path)
    described = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    documented = set()
    for node in nodes:
        if isinstance(node, described) and ast.get_docstring(node, clean=False) is not None:
            docstring = node.body[0]
            documented.update(range(docstring.lineno, docstring.end_lineno + 1))
    stripped = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    lines = [line for number, line in stripped if line and number not in documented]
    code = [line for line in lines if not line.startswith("#")]
    return Size(len(nodes), len(code))


@cache
def sizes() -> dict[str, Size]:
    """Sizes of the rooms, of the scenarios and of the tools."""
    rooms = {}
    for path in [*FILES, *TOOLS]:
        is_room = path.parts[0] == "mavdem" and len(path.parts) > 2
        room = "tools" if path in TOOLS else path.parts[int(is_room)] if is_room else path.parts[0]
        before = rooms.get(room, Size(0, 0))
        size = size_of(path)
        rooms[room] = Size(before.nodes + size.nodes, before.lines + size.lines)
    return rooms


def test_a_room_stays_within_its_budget():
    assert not {room: size for room, size in sizes().items() if size.nodes > NODES.get(room, 0)}
    assert sum(size.nodes for size in sizes().values()) <= ALL_NODES
    tests = (path.relative_to(ROOT) for path in (ROOT / "tests").rglob("*.py"))
    assert sum(size_of(path).nodes for path in tests) <= TEST_NODES


def test_no_room_is_packed():
    packed = {room: size.nodes / size.lines for room, size in sizes().items()}
    assert not {room: density for room, density in packed.items() if density > NODES_A_LINE}


def has_number(value: ast.expr) -> bool:
    numbers = (node.value for node in ast.walk(value) if isinstance(node, ast.Constant))
    return any(
        isinstance(number, int | float) and not isinstance(number, bool) for number in numbers
    )


def constants_of(path: Path) -> Iterator[str]:
    for node in nodes_of(path):
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        else:
            continue
        for target in targets:
            if isinstance(target, ast.Name) and target.id.isupper() and len(target.id) > 1:
                is_plain = not any(
                    isinstance(part, ast.Call | ast.Lambda) for part in ast.walk(node.value)
                )
                if is_plain and has_number(node.value):
                    yield target.id


def test_named_constants_are_few():
    assert sum(1 for path in [*FILES, *TOOLS] for _ in constants_of(path)) <= ALL_CONSTANTS
