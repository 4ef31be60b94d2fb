"""Nothing points backwards: which room may import which, read from the source."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

import mavdem

ROOT = Path(mavdem.__file__).parent
FILES = sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
HOME = {"rerun": "view", "pymavlink": "ingest", "mcap": "ingest", "pyulog": "ingest", "click": "cli", "rich": "cli"}
"""The only room that may import a library."""


def imported(path: Path) -> set[str]:
    """Full names of the modules that a file imports, also inside functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
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


ORDER = ("ingest", "align", "dem", "evaluate", "view", "cli")
"""The flow of the data. A room imports rooms before it; ``dem`` and ``ingest`` none at all."""


@pytest.mark.parametrize("path", FILES, ids=str)
def test_no_room_imports_one_downstream(path):
    room = path.parts[0].removesuffix(".py")
    if room not in ORDER:
        pytest.skip(f"{path} is no room of the flow")
    for name in imported(path):
        for later in ORDER[ORDER.index(room) + 1 :]:
            assert not within(name, f"mavdem.{later}"), f"{path} imports {name}"


@pytest.mark.parametrize("path", FILES, ids=str)
def test_nobody_imports_the_command_line(path):
    if path.parts[0] != "cli":
        assert not any(within(name, "mavdem.cli") for name in imported(path))
