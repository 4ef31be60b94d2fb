"""The layout: rooms on floors, libraries in their rooms, and no circle of imports."""

import ast
import re
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
    {"arrays", "containers", "facts"},
    {
        "confidence",
        "errors",
        "extras",
        "forecaster",
        "document_heading",
        "immutable",
        "lazy_names",
        "machine",
        "physical_constants",
        "processes",
        "unit_errors",
        "units",
    },
    {"files", "flight", "log_formats"},
    {"ingest"},
    {"dataset"},
    {"dem"},
    {"plant", "wind_velocity"},
    {"loops"},
    {"vibration", "motors"},
    {"witnesses"},
    {"experiments"},
    {"baselines", "evaluate"},
    {"assessment"},
    {"fleet", "live"},
    {"report"},
    {"documents", "export", "view"},
    {"fleet_pages", "results"},
    {"experiments.paper"},
    {"__init__"},
    {"serve"},
    {"cli"},
    {"__main__"},
)
"""The way of the data: a room imports itself and rooms on floors below its own.

The paper's experiments draw with ``report``, and stand above it; the errors of held-out windows, which every assessment
has, stand below.
"""

UPWARD_IMPORTS = {
    ("facts.fact", "report.templates"),  # Fact.sentence
    ("flight", "export.tables"),  # Flight.to_pandas(), to_xarray()
    ("flight", "report.pages.page"),  # Flight in a notebook
    ("dem.learned", "plant"),  # Learned.physical
    ("dem.learned", "plant.wind_torque"),  # Learned.wind_torque
    ("dem.learned", "plant.simulation"),  # Learned.simulate()
    ("dem.learned", "loops.axis_loops"),  # Learned.loop(), its type
    ("dem.learned", "loops.controllers"),
    ("dem.learned", "loops.loop_construction"),
    ("dem.learned", "export.control_systems"),  # Learned.to_control()
    ("dem.learned", "report.figures"),  # Learned.plot
    ("dem.learned", "report.pages.page"),  # Learned in a notebook
    ("dem.learned", "report.screen"),  # Learned.summary()
    ("dem.online.learner", "plant.online_wind_torque"),  # OnlineLearner.update()
    ("dem.online.learner", "plant.parameters"),
    ("dem.online.estimate", "plant.parameters"),  # Estimate.physical, its type
    ("loops.axis_loops", "loops.advice"),  # Loop.advice
    ("loops.twin_flight", "report.vehicle_files"),  # For ``fly_twin()``.
    ("loops.twin_flight", "sitl_scenarios.files"),
    ("loops.twin_flight", "sitl_scenarios.replay"),
    ("assessment.record", "assessment.axis.tuning"),  # Assessment.advised_gains
    ("assessment.record", "documents"),  # Assessment.as_dict()
    ("assessment.record", "documents.review"),
    ("assessment.record", "report.pages.flight_page"),  # Assessment.page()
    ("assessment.record", "report.review"),  # For ``str(Assessment)``.
}
"""Modules of mavdem with a module above them that a method of a public result imports when it is called."""

ROOMS_OF_LIBRARIES = {
    "rerun": {"view"},
    "pymavlink": set(),
    "mcap": {"ingest"},
    "rosbags": {"ingest"},
    "zstandard": {"ingest"},
    "lz4": {"ingest"},
    "pyulog": set(),
    "pyarrow": {"export", "fleet"},
    "fsspec": {"fleet"},
    "distributed": {"fleet"},
    "pandas": {"export", "flight"},
    "xarray": {"export", "flight"},
    "control": {"export"},
    "click": {"cli"},
    "rich": {"cli"},
    "matplotlib": {"experiments.paper", "report"},
    "jinja2": {"report"},
    "sitl_scenarios": {"loops", "cli", "experiments.paper"},
    "starlette": {"serve"},
    "uvicorn": {"serve"},
    "python_multipart": {"serve"},
    "segno": {"cli"},
}
"""The only rooms of mavdem that may import a library."""

ARRAYS = sys.stdlib_module_names | {"numpy", "scipy", "threadpoolctl", "pydantic"}
USED_BY = {
    "mavdem.dem": {
        "mavdem.dem",
        "mavdem.arrays",
        "mavdem.confidence",
        "mavdem.containers",
        "mavdem.document_heading",
        "mavdem.immutable",
        "mavdem.lazy_names",
        "mavdem.errors",
        "mavdem.extras",
        "mavdem.facts",
        "mavdem.processes",
        "mavdem.unit_errors",
    },
    "mavdem.motors": {
        "mavdem.motors",
        "mavdem.arrays",
        "mavdem.confidence",
        "mavdem.facts",
        "mavdem.containers",
        "mavdem.immutable",
        "mavdem.lazy_names",
        "mavdem.errors",
        "mavdem.files",
        "mavdem.ingest",
        "mavdem.dataset",
        "mavdem.dem",
    },
    "sitl_scenarios": {
        "sitl_scenarios",
        "mavdem.facts",
        "mavdem.errors",
        "mavdem.files",
        "mavdem.ingest.mavlink",
        "mavdem.ingest.vocabulary",
        "mavdem.loops.autopilot_parameters",
        "mavdem.loops.controllers",
        "mavdem.loops.filters",
        "mavdem.loops.margins",
    },
}
"""Rooms that know arrays only, and what of ours they may use: no file, link or viewer."""


ROOMS = sorted(set().union(*FLOORS), key=len, reverse=True)
"""The rooms, those within others first."""


IMPORT = re.compile(r"^[ \t]*(from \S+ import (?:\([^)]*\)|.*)|import .*)", re.MULTILINE)
"""An import statement, which begins a line. To parse these alone takes an eighth of the time of whole files.

Lines of a text may look like one: no import is missed, but a text must not name what its file may not import.
"""


@cache
def imported(path):
    """Full names of what a file imports, also inside functions, for type checkers only, and named by a string."""
    text = (ROOT / path).read_text()
    names = set()
    for node in ast.parse("\n".join(IMPORT.findall(text))).body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        else:
            assert node.level == 0, f"{path} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    if "importlib.import_module" in names:
        package = ".".join(path.parent.parts)
        strings = {getattr(node, "value", None) for node in ast.walk(ast.parse(text))}
        names |= {f"{package}.{string}" for string in strings} & MODULES.keys()
    return names


@cache
def module_of(name):
    """The module of ours that an imported name is or stands in."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name or None


def within(module, packages):
    """The first of these packages that a module is or stands in."""
    return next((one for one in packages if f"{module}.".startswith(f"{one}.")), None)


@cache
def room_of(module):
    """The room of a module: the longest part of its name that ``FLOORS`` names."""
    inner = module.partition(".")[2] or "__init__"
    return within(inner, ROOMS)


def floor(room):
    """The number of the one floor of a room: ``FLOORS`` must say where in the flow it is."""
    (number,) = (number for number, rooms in enumerate(FLOORS) if room in rooms)
    return number


def is_listed_upward(module, source):
    """Whether ``UPWARD_IMPORTS`` has this import."""
    return (
        module.removeprefix("mavdem."),
        (source or "").removeprefix("mavdem."),
    ) in UPWARD_IMPORTS


def against_the_flow():
    """Yields imports that the architecture forbids: of upper rooms, or of libraries outside of their rooms."""
    for module, path in MODULES.items():
        is_ours = module.split(".")[0] == "mavdem"
        here = room_of(module) if is_ours else None
        package = within(module, USED_BY)
        for name in imported(path):
            library = name.split(".")[0]
            source = module_of(name)
            if is_listed_upward(module, source):
                continue
            if is_ours and here not in ROOMS_OF_LIBRARIES.get(library, {here}):
                yield f"{path} imports {name}: only {ROOMS_OF_LIBRARIES[library]} may"
            if package and not (within(source, USED_BY[package]) if source else library in ARRAYS):
                yield f"{path} imports {name}: {package} knows arrays and {USED_BY[package]} only"
            is_other = is_ours and library == "mavdem" and room_of(source) != here
            if is_other and floor(room_of(source)) >= floor(here):
                yield f"{path} imports {name}, which is downstream"


def test_nothing_imports_against_the_flow():
    assert not list(against_the_flow())


def test_listed_upward_imports_exist():
    made = {
        (module.removeprefix("mavdem."), (module_of(name) or "").removeprefix("mavdem."))
        for module, path in MODULES.items()
        for name in imported(path)
    }
    assert made >= UPWARD_IMPORTS


def test_imports_have_no_circle():
    graph = {
        module: {
            source
            for source in map(module_of, imported(path))
            if source not in {module, None} and not is_listed_upward(module, source)
        }
        for module, path in MODULES.items()
    }
    # It raises CycleError, with the circle, where there is one.
    assert len(list(TopologicalSorter(graph).static_order())) == len(FILES)
