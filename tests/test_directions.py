"""Nothing points backwards: which room may import which, read from the source."""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

import mavdem
import sitl_scenarios

ROOT = Path(mavdem.__file__).parent
FILES = sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
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
    "pandas": {"export"},
    "xarray": {"export"},
    "control": {"export"},
    "click": {"cli"},
    "rich": {"cli"},
    "matplotlib": {"page", "paper", "plot"},
    "jinja2": {"page"},
}
"""The only rooms that may import a library."""


@cache
def imported(path: Path, root: Path = ROOT) -> frozenset[str]:
    """Full names of the modules that a file imports, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse((root / path).read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


@pytest.mark.parametrize("path", FILES, ids=str)
def test_a_library_is_imported_in_its_room_only(path):
    for name in imported(path):
        library = name.split(".")[0]
        assert path.parts[0] in ROOMS_OF_LIBRARIES.get(library, {path.parts[0]}), f"{path} imports {name}"


@pytest.mark.parametrize("path", [path for path in FILES if path.parts[0] == "dem"], ids=str)
def test_dem_imports_array_libraries_and_itself_only(path):
    # What is downstream is imported by name, when a method is called that needs it.
    # threadpoolctl limits the threads of numpy's linear algebra; pydantic checks settings and documents.
    allowed = sys.stdlib_module_names | {"numpy", "scipy", "threadpoolctl", "pydantic"}
    for name in imported(path):
        own = within(name, "mavdem.dem") or within(name, "mavdem.downstream")
        assert own or name.split(".")[0] in allowed, f"{path} imports {name}"


@pytest.mark.parametrize("path", [path for path in FILES if path.parts[0] == "health"], ids=str)
def test_health_judges_figures_and_reads_no_logs(path):
    # Rows of a table suffice, so that a fleet is judged without its logs, and a flight while it is flown.
    allowed = sys.stdlib_module_names | {"numpy", "scipy"}
    used = ("mavdem.health", "mavdem.alignment", "mavdem.dem", "mavdem.condition")
    for name in imported(path):
        assert any(within(name, room) for room in used) or name.split(".")[0] in allowed, f"{path} imports {name}"


FLOORS = (
    {"errors", "extras", "files", "forecaster"},
    {"downstream"},
    {"flight"},
    {"ingest"},
    {"alignment"},
    {"condition"},
    {"dem"},
    {"health"},
    {"baselines", "evaluate", "live"},
    {"analysis", "comparison"},
    {"report"},
    {"export", "fleet", "plot", "view"},
    {"page"},
    {"paper"},
    {"__init__"},
    {"cli"},
    {"__main__"},
)
"""The flow of the data, floor by floor: a room imports itself and floors below its own."""


def floor(room: str) -> int:
    """The floor of a folder or file of mavdem."""
    found = [number for number, rooms in enumerate(FLOORS) if room in rooms]
    assert len(found) == 1, f"{room} has no floor: say where in the flow it is"
    return found[0]


def room(name: str) -> str | None:
    """The room an imported module belongs to; None for what is not ours."""
    if not within(name, "mavdem"):
        return None
    inner = name.split(".")[1:2]
    # What is no folder or file is a public name of the package, and that is all of it.
    known = inner and ((ROOT / inner[0]).is_dir() or (ROOT / f"{inner[0]}.py").exists())
    return inner[0] if known else "__init__"


@pytest.mark.parametrize("path", FILES, ids=str)
def test_nothing_imports_what_is_downstream(path):
    here = path.parts[0].removesuffix(".py")
    for name in imported(path):
        there = room(name)
        if there is not None and there != here:
            assert floor(there) < floor(here), f"{path} imports {name}"
    assert floor(here) >= 0


def importers(package: str) -> set[str]:
    return {path.parts[0] for path in FILES if any(within(name, package) for name in imported(path))}


def test_nobody_imports_the_command_line():
    assert importers("mavdem.cli") == {"cli", "__main__.py"}


def test_only_the_command_line_and_the_paper_know_of_simulated_flights():
    assert importers("sitl_scenarios") == {"cli", "paper"}


SCENARIOS = Path(sitl_scenarios.__file__).parent
FILES_OF_MAVDEM = ("mavdem.errors", "mavdem.files")
FRAMES_OF_MAVDEM = tuple(
    f"mavdem.ingest.mavlink.{name}" for name in ("checksum", "compose", "definitions", "framing", "stream")
)
"""What a simulated flight may use of mavdem: how files appear whole and, where it speaks MAVLink, how frames are made.
It knows nothing of what is done with them."""


@pytest.mark.parametrize("path", sorted(path.relative_to(SCENARIOS) for path in SCENARIOS.rglob("*.py")), ids=str)
def test_simulated_flights_know_files_and_frames_and_nothing_else_of_mavdem(path):
    allowed = sys.stdlib_module_names | {"numpy", "scipy", "pydantic"}
    used = FILES_OF_MAVDEM + (FRAMES_OF_MAVDEM if path.parts[0] == "mavlink" else ())
    for name in imported(path, SCENARIOS):
        own = within(name, "sitl_scenarios") or any(within(name, module) for module in used)
        assert own or name.split(".")[0] in allowed, f"{path} imports {name}"
