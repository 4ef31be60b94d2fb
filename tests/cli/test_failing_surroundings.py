"""A full disk, closed streams, signals and odd names: an exit code, at most a sentence, and nothing half written."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import click
import pytest

from mavdem.cli.commands import main, mavdem
from mavdem.cli.output_files import RESULT_FILES

FLIGHT = Path(__file__).parents[2] / "logs/ardupilot_wind5_steps.tlog"
MAVDEM = [sys.executable, "-c", "import sys; from mavdem.__main__ import run; sys.exit(run())"]
FULL = Path("/dev/full")
FEW = ["--preset", "paper", "--train", "100", "--test", "20"]  # samples: what is written matters here
PATIENCE = 300.0  # Seconds that a slow, busy machine may take for anything; on others nothing waits for them

pytestmark = pytest.mark.slow  # each starts the program anew
needs_full = pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")


def no_file_beyond(size: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_a_recording_that_does_not_fit_is_reported_and_leaves_nothing(tmp_path):
    out = tmp_path / "made" / "here"
    words = [*MAVDEM, "learn", FLIGHT, "--out", out, *FEW]
    limited = {"preexec_fn": lambda: no_file_beyond(100_000), "timeout": PATIENCE}
    done = subprocess.run(words, capture_output=True, text=True, **limited)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("mavdem: --out ") and done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@needs_full
@pytest.mark.parametrize("words", [["info", "none", "--json"], ["--help"]])
def test_a_standard_output_that_fails_is_reported(words):
    with FULL.open("w") as full:
        done = subprocess.run([*MAVDEM, *words], stdout=full, stderr=subprocess.PIPE, text=True, timeout=PATIENCE)
    assert done.returncode == 2
    *_, last = done.stderr.splitlines()
    assert last.startswith("mavdem: Standard output cannot be written to (")
    assert "Traceback" not in done.stderr and "should not have happened" not in done.stderr


def test_names_need_not_be_utf_8_nor_terminals_and_settings_of_matplotlib_spoil_nothing(tmp_path):
    log = Path(os.fsdecode(os.fsencode(tmp_path) + b"/r\xff\xfe.tlog"))
    out = Path(os.fsdecode(os.fsencode(tmp_path) + b"/o\xff\xfe"))
    try:
        log.write_bytes(FLIGHT.read_bytes())
    except OSError:
        pytest.skip("this file system takes UTF-8 only")
    settings = tmp_path / "matplotlibrc"
    settings.write_text("text.usetex: True\nfont.family: none\nno such line\n")
    surroundings = {"MPLBACKEND": "none", "MATPLOTLIBRC": str(settings), "MPLCONFIGDIR": str(settings)}
    environment = {**os.environ, **surroundings, "PYTHONIOENCODING": "ascii"}
    words = [*MAVDEM, "learn", log, "--out", out, "--train", "200", "--test", "20"]
    done = subprocess.run(words, capture_output=True, timeout=PATIENCE, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith(b"Took ") and done.stderr.count(b"\n") == 3
    assert {path.name for path in out.iterdir()} == set(RESULT_FILES)
    assert done.stdout.isascii() and b"?" not in done.stdout
    assert b" +- " in done.stdout and b"roll rate, deg/s" in done.stdout


def test_an_interrupt_while_starting_is_one_sentence(tmp_path):
    """Ctrl-C comes as numpy begins to be imported."""
    (tmp_path / "numpy.py").write_text("import signal; signal.raise_signal(signal.SIGINT)\n")
    path = os.pathsep.join([str(tmp_path), str(FLIGHT.parents[1])])
    done = subprocess.run(
        [*MAVDEM, "info", FLIGHT],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        timeout=PATIENCE,
    )
    assert done.returncode == 130
    assert done.stderr.startswith("mavdem: Interrupted") and done.stderr.count("\n") == 1


def test_the_help_says_of_each_command_what_it_says_itself():
    context = click.Context(mavdem)
    for name, told in mavdem.commands.items():
        _, command, _ = mavdem.resolve_command(context, [name])
        assert command is not told
        assert command.get_short_help_str(limit=200) == told.get_short_help_str(limit=200)


@pytest.mark.parametrize("name", RESULT_FILES)
def test_a_folder_where_a_result_must_go_is_refused_before_the_work(name, tmp_path, capsys):
    (tmp_path / name).mkdir()
    assert main(["learn", "missing.tlog", "--out", str(tmp_path)]) == 2
    assert f"{name} is a folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("option", ["--out", "--vehicle"])
def test_an_option_is_no_value_of_another(option, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["learn", str(FLIGHT), "--out", "x", option, "--json"]) == 2
    said = capsys.readouterr().err
    assert option in said and "--json is an option" in said
    assert list(tmp_path.iterdir()) == []


def test_a_file_named_like_a_link_is_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("COM3").write_bytes(FLIGHT.read_bytes())
    assert main(["info", "COM3"]) == 0
    assert main(["info", "COM4"]) == 2
    assert "link" in capsys.readouterr().err


@pytest.mark.parametrize("closed", [1, 2])
def test_a_closed_stream_or_pipe_is_as_one_that_nobody_reads(closed):
    timed = {"stderr": subprocess.PIPE, "timeout": PATIENCE}
    done = subprocess.run([*MAVDEM, "--help"], preexec_fn=lambda: os.close(closed), stdout=subprocess.PIPE, **timed)
    assert (done.returncode, done.stderr) == (0, b"")
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([*MAVDEM, "--help"], stdout=writer, **timed)
    os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, b"")
