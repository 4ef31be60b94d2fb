"""Nothing points backwards: which room may import which, read from the source."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

import mavdem
import sitl_scenarios

ROOT = Path(mavdem.__file__).parent
FILES = sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
HOME = {
    "rerun": "view",
    "pymavlink": "ingest",
    "mcap": "ingest",
    "mcap_ros2": "ingest",
    "zstandard": "ingest",
    "lz4": "ingest",
    "pyulog": "ingest",
    "pyarrow": "table.py",
    "click": "cli",
    "rich": "cli",
}
"""The only room that may import a library."""


def imported(path: Path, root: Path = ROOT) -> set[str]:
    """Full names of the modules that a file imports, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse((root / path).read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively: write the whole name"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


@pytest.mark.parametrize("path", FILES, ids=str)
def test_a_library_is_imported_in_its_room_only(path):
    for name in imported(path):
        library = name.split(".")[0]
        assert HOME.get(library, path.parts[0]) == path.parts[0], f"{path} imports {name}"


@pytest.mark.parametrize("path", [path for path in FILES if path.parts[0] == "dem"], ids=str)
def test_the_engine_knows_arrays_and_itself_only(path):
    # threadpoolctl is about numpy too: how many threads its linear algebra may wake.
    allowed = sys.stdlib_module_names | {"numpy", "scipy", "threadpoolctl"}
    for name in imported(path):
        assert name.split(".")[0] in allowed or within(name, "mavdem.dem"), f"{path} imports {name}"


LAYERS = (
    {"errors", "telemetry", "flight", "forecaster", "intervals", "euler", "whole_file"},
    {"ingest"},
    {"phases"},
    {"align"},
    {"figures", "faster"},
    {"verdict"},
    {"read"},
    {"live"},
    {"inventory", "table"},
    {"convert"},
    {"dem"},
    {"baselines", "windows"},
    {"evaluate", "naming", "attached", "learning_process"},
    {"account", "channels"},
    {"comparison"},
    {"view"},
    {"__init__"},
    {"cli"},
)
"""The flow of the data: every room and every file beside them. Each imports itself and layers before its own."""


def layer(room: str) -> int:
    """Which layer a folder or file of mavdem is in."""
    found = [number for number, rooms in enumerate(LAYERS) if room in rooms]
    assert len(found) == 1, f"{room} has no layer: say where in the flow it is"
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
            assert layer(there) < layer(here), f"{path} imports {name}"
    assert layer(here) >= 0


@pytest.mark.parametrize("path", FILES, ids=str)
def test_nobody_imports_the_command_line(path):
    if path.parts[0] != "cli":
        assert not any(within(name, "mavdem.cli") for name in imported(path))


@pytest.mark.parametrize("path", FILES, ids=str)
def test_only_the_command_line_knows_of_simulated_flights(path):
    if path.parts[0] != "cli":
        assert not any(within(name, "sitl_scenarios") for name in imported(path))


SCENARIOS = Path(sitl_scenarios.__file__).parent
FILES_OF_MAVDEM = ("mavdem.errors", "mavdem.whole_file")
FRAMES_OF_MAVDEM = tuple(f"mavdem.ingest.{name}" for name in ("checksum", "compose", "decode", "framing", "stream"))
"""What a simulated flight may use of mavdem: how files appear whole and, where it speaks MAVLink, how frames are made.
It knows nothing of what is done with them."""


@pytest.mark.parametrize("path", sorted(path.relative_to(SCENARIOS) for path in SCENARIOS.rglob("*.py")), ids=str)
def test_simulated_flights_know_files_and_frames_and_nothing_else_of_mavdem(path):
    allowed = sys.stdlib_module_names | {"numpy", "scipy", "pydantic"}
    used = FILES_OF_MAVDEM + (FRAMES_OF_MAVDEM if path.parts[0] == "mavlink" else ())
    for name in imported(path, SCENARIOS):
        own = within(name, "sitl_scenarios") or any(within(name, module) for module in used)
        assert own or name.split(".")[0] in allowed, f"{path} imports {name}"
