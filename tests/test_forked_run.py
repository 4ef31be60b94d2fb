"""Tests that run in several processes: each runs once, and is reported as if one process ran them all."""

import subprocess
import sys
from pathlib import Path

from pytest import mark

TESTS = """
import os, sys, warnings
from pytest import fixture, mark, skip

@fixture(scope="session", autouse=True)
def session_fixture():
    yield
    open(f"ended.{os.getpid()}", "x").close()

def test_fails():
    print("printed before")
    assert [1, 2] == [1, 3]

@mark.parametrize("number", range(16))
def test_passes(number):
    open(f"{number}.run", "x").close()

def test_is_skipped():
    skip("no reason")

def test_warns():
    warnings.warn("look here")

def test_is_not_imported_by_processes_that_it_starts():
    assert not hasattr(sys.modules["__main__"], "__file__")
"""
CRASH = """
def test_ends_its_process():
    os._exit(3)
"""


def run(folder, content, *options):
    """Runs the tests of a file in two processes, which must fail, and returns what is printed."""
    (folder / "test_file.py").write_text(content)
    # Plugins that the file does not need would take most of the time.
    without_plugins = [f"-pno:{name}" for name in ("anyio", "cacheprovider", "hypothesispytest")]
    ended = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-pforked_run", "--processes=2"]
        + [*without_plugins, *options],
        cwd=folder,
        env={"PYTHONPATH": str(Path(__file__).parent)},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 1
    return ended.stdout


@mark.slow
def test_each_test_runs_once_and_is_reported_and_one_that_ends_its_process_fails(tmp_path):
    output = run(tmp_path, TESTS + CRASH)
    assert "2 failed, 18 passed, 1 skipped, 1 warning in" in output
    assert "printed before" in output and "At index 1 diff: 2 != 3" in output
    assert "UserWarning: look here" in output
    assert "The process of test_file.py::test_ends_its_process has ended with code 3" in output
    assert len(list(tmp_path.glob("*.run"))) == 16
    assert len(list(tmp_path.glob("ended.*"))) == 1, "the other process ends its fixtures"


@mark.slow
def test_after_a_failure_that_stops_the_run_the_fixtures_of_all_processes_end(tmp_path):
    output = run(tmp_path, TESTS, "--exitfirst")
    assert "stopping after 1 failures" in output
    assert len(list(tmp_path.glob("ended.*"))) == 2
