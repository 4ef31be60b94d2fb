"""The layout: rooms on floors, libraries in their rooms, files that can be read, and rooms within their budgets."""

import ast
import sys
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = sorted(
    path.relative_to(ROOT)
    for room in ("mavdem", "sitl_scenarios")
    for path in (ROOT / room).rglob("*.py")
)
TOOLS = sorted(
    path.relative_to(ROOT) for path in [*(ROOT / "tools").rglob("*.py"), ROOT / "docs/conf.py"]
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
        "forecaster",
        "grouping",
        "heading",
        "immutable",
        "machine",
        "unit_slips",
        "units",
    },
    {"files", "flight"},
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
    "sitl_scenarios": {"api", "cli", "paper"},
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
        "mavdem.immutable",
        "mavdem.errors",
        "mavdem.facts",
        "mavdem.unit_slips",
    },
    "mavdem.health": {
        "mavdem.health",
        "mavdem.confidence",
        "mavdem.facts",
        "mavdem.heading",
        "mavdem.immutable",
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
def nodes_of(path):
    """All syntax nodes of a file, which several tests look at."""
    return list(ast.walk(ast.parse((ROOT / path).read_text())))


@cache
def imported(path):
    """Full names of what a file imports, also inside functions, for type checkers only, and named by a string."""
    names = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    if "importlib.import_module" in names:
        package = ".".join(path.parent.parts)
        strings = {getattr(node, "value", None) for node in nodes_of(path)}
        names |= {f"{package}.{string}" for string in strings} & MODULES.keys()
    return names


def module_of(name):
    """The module of ours that an imported name is or stands in."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name or None


def within(module, packages):
    """The first of these packages that a module is or stands in."""
    return next((one for one in packages if f"{module}.".startswith(f"{one}.")), None)


def room_of(module):
    return module.split(".")[1] if "." in module else "__init__"


def floor(room):
    """The one floor of a room: ``FLOORS`` must say where in the flow it is."""
    (number,) = (number for number, rooms in enumerate(FLOORS) if room in rooms)
    return number


def against_the_flow():
    for module, path in MODULES.items():
        is_ours = module.split(".")[0] == "mavdem"
        here = room_of(module)
        package = within(module, USED_BY)
        for name in imported(path):
            library = name.split(".")[0]
            source = module_of(name)
            if is_ours and here not in ROOMS_OF_LIBRARIES.get(library, {here}):
                yield f"{path} imports {name}: only {ROOMS_OF_LIBRARIES[library]} may"
            if package and not (within(source, USED_BY[package]) if source else library in ARRAYS):
                yield f"{path} imports {name}: {package} knows arrays and {USED_BY[package]} only"
            is_other = is_ours and library == "mavdem" and room_of(source) != here
            if is_other and floor(room_of(source)) >= floor(here):
                yield f"{path} imports {name}, which is downstream"


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
    lines = ((path, (ROOT / path).read_text().splitlines()) for path in FILES)
    assert not [path for path, of_file in lines if len(of_file) > MAX_LINES]


NODES = {
    "alignment": 19_130,
    "analysis": 8280,
    "assessment": 19_710,
    "baselines": 5080,
    "cli": 14_090,
    "condition": 40_030,
    "dem": 67_160,
    "documents": 11_040,
    "evaluate": 7970,
    "export": 2500,
    "facts": 4260,
    "fleet": 15_910,
    "health": 10_600,
    "ingest": 39_340,
    "live": 31_100,
    "mavdem": 6310,
    "paper": 11_010,
    "report": 32_880,
    "serve": 13_470,
    "sitl_scenarios": 30_200,
    "tools": 15_410,
    "view": 10_750,
}
"""Syntax nodes of Python that a room may have: what a new capability needs, something older gives back."""
ALL_NODES = 416_000
TEST_NODES = 225_000
NODES_A_LINE = 11.0  # condition, health and tools
"""Of code: more is packed, not short."""
ALL_CONSTANTS = 700
"""Named numbers, and tables with numbers: each has a unit, a source and a test at its edge."""


def size_of(path):
    """Syntax nodes of a file, and its lines that are no blanks, comments or docstrings."""
    text = (ROOT / path).read_text()
    nodes = nodes_of(path)
    described = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    documented = set()
    for node in nodes:
        if isinstance(node, described) and ast.get_docstring(node, clean=False) is not None:
            docstring = node.body[0]
            documented.update(range(docstring.lineno, docstring.end_lineno + 1))
    numbered = enumerate(text.splitlines(), 1)
    lines = (line.strip() for number, line in numbered if number not in documented)
    return len(nodes), sum(not line.startswith("#") for line in lines if line)


@cache
def sizes():
    """Nodes and lines of the rooms, of the scenarios and of the tools."""
    nodes, lines = Counter(), Counter()
    for path in [*FILES, *TOOLS]:
        is_room = path.parts[0] == "mavdem" and len(path.parts) > 2
        room = "tools" if path in TOOLS else path.parts[int(is_room)]
        of_file = size_of(path)
        nodes[room] += of_file[0]
        lines[room] += of_file[1]
    return nodes, lines


def test_a_room_stays_within_its_budget():
    nodes, _ = sizes()
    assert not {room: count for room, count in nodes.items() if count > NODES.get(room, 0)}
    assert nodes.total() <= ALL_NODES
    tests = (path.relative_to(ROOT) for path in (ROOT / "tests").rglob("*.py"))
    assert sum(size_of(path)[0] for path in tests) <= TEST_NODES


def test_no_room_is_packed():
    nodes, lines = sizes()
    assert not {room for room in nodes if nodes[room] > NODES_A_LINE * lines[room]}


def has_number(value):
    return any(type(getattr(node, "value", None)) in (int, float) for node in ast.walk(value))


def constants_of(path):
    for node in nodes_of(path):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            for target in getattr(node, "targets", None) or [node.target]:
                if isinstance(target, ast.Name) and target.id.isupper() and len(target.id) > 1:
                    is_plain = not any(
                        isinstance(part, ast.Call | ast.Lambda) for part in ast.walk(node.value)
                    )
                    if is_plain and has_number(node.value):
                        yield target.id


def test_named_constants_are_few():
    assert sum(1 for path in [*FILES, *TOOLS] for _ in constants_of(path)) <= ALL_CONSTANTS
