"""The layout: rooms on floors, libraries in their rooms, and no circle of imports."""

import ast
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = sorted(
    path.relative_to(ROOT)
    for room in ("mavdem", "sitl_scenarios")
    for path in (ROOT / room).rglob("*.py")
)
MODULES = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in FILES}

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
    {"dataset"},
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
        "mavdem.dataset",
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
