"""What the command line answers to good, poor and broken input: an exit code, one sentence, and never a traceback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mavdem import read_flight
from mavdem.cli import commands as command_line
from mavdem.cli.commands import main
from mavdem.export.channels import write_channels

LOGS = Path(__file__).parents[2] / "logs"
FLIGHT = LOGS / "ardupilot_wind5_steps.tlog"
MAVDEM = [sys.executable, "-c", "import sys; from mavdem.cli.commands import main; sys.exit(main())"]


def broken_inputs(folder: Path) -> dict[str, Path]:
    flight = FLIGHT.read_bytes()
    contents = {
        "empty.tlog": b"",
        "text.tlog": b"This is a letter, not a flight.\n" * 100,
        "noise.tlog": bytes(range(256)) * 40,
        "renamed.ulg": b"ULog\x01\x12\x35" + bytes(1000),
        "cut_in_the_first_frame.tlog": flight[:20],
    }
    paths = {name: folder / name for name in contents}
    for name, path in paths.items():
        path.write_bytes(contents[name])
    return {**paths, "missing": folder / "missing.tlog", "a folder": folder}


BROKEN = ("empty.tlog", "text.tlog", "noise.tlog", "renamed.ulg", "cut_in_the_first_frame.tlog", "missing", "a folder")


@pytest.mark.parametrize("name", BROKEN)
@pytest.mark.parametrize("command", ["info", "learn", "compare"])
def test_unreadable_input_is_one_sentence_and_nothing_written(name, command, tmp_path, capsys):
    source, out = broken_inputs(tmp_path)[name], tmp_path / "out"
    assert main([command, str(source), *(["--out", str(out)] if command == "learn" else [])]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("mavdem: ")
    assert said.err.count("\n") == 1
    assert str(source) in said.err
    assert "should not have happened" not in said.err
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["learn", str(FLIGHT), "--out", "x", "--order", "10"], "--order: 10 is not in 2 to 4"),
        (["learn", str(FLIGHT), "--out", "x", "--order", "11", "--preset", "paper"], "11 is not in 1 to 10"),
        (["learn", str(FLIGHT), "--out", ""], "--out"),
        (["learn", str(FLIGHT), "--out", "x", "--vehicle", "foo"], "'foo' is no vehicle"),
        (["info", str(FLIGHT), "--vehicle", "1:1:1"], "system and component as in 1:1"),
        (["learn", str(FLIGHT), "--out", "x", "--start", "nan"], "--start"),
        (["learn", str(FLIGHT), "--out", "x", "--train", "many"], "'many' is no length: give seconds, as in 7s"),
        (["learn", str(FLIGHT), "--train", "49"], "49 is not a whole number of at least 50 samples"),
        (["compare", str(FLIGHT), "--test", "0s"], "0s is not a length of flight"),
        (["info", str(FLIGHT), "--axis", "heave"], "--axis"),
        (["info"], "SOURCE"),
        (["--colour"], "--colour"),
        (
            ["info", "udpin:127.0.0.1:14550"],
            "a MAVLink link, and only logs are read here: attach to it with `mavdem live udpin:",
        ),
        (["learn", "/dev/ttyACM0,115200", "--out", "x"], "`mavdem live /dev/ttyACM0,115200`"),
        (["info", "-"], "A log cannot be read from standard input (-): save it as a file"),
        (["info", str(LOGS)], f"{LOGS} is a folder, with 3 logs in it: name a file, such as {LOGS}/ardupilot_default"),
        (["info", "."], "is a folder, with no log in it: name a file that ends in .tlog, "),
    ],
)
def test_bad_usage_names_what_is_wrong(words, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert named in said.err
    assert "should not have happened" not in said.err
    assert list(tmp_path.iterdir()) == []


def test_a_result_is_distinguished_from_a_log(tmp_path, capsys):
    flight = read_flight(FLIGHT)[:100]
    write_channels(tmp_path / "flight.mcap", [flight])
    assert main(["info", str(tmp_path / "flight.mcap")]) == 2
    said = capsys.readouterr().err
    assert "was written by `mavdem learn`" in said and "name the log" in said


@pytest.mark.parametrize("words", [["--help"], ["info", "-h"], ["learn", "--help"], ["compare", "--help"]])
def test_help_teaches_and_succeeds(words, capsys):
    assert main(words) == 0
    assert "mavdem" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["info", "missing.tlog", "--json"], ["learn", "missing.tlog", "--json"]])
def test_with_json_a_failure_is_a_document_too(words, capsys):
    assert main(words) == 2
    assert json.loads(capsys.readouterr().out)["error"]["reason"]


def test_a_fault_of_our_own_is_one_sentence_with_a_hint(monkeypatch, capsys):
    def fault(*_: object) -> None:
        raise RuntimeError("a\nfault")

    monkeypatch.delenv("MAVDEM_TRACEBACK", raising=False)
    monkeypatch.setattr(command_line.mavdem, "invoke", fault)
    assert main(["info", str(FLIGHT)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "MAVDEM_TRACEBACK=1" in said
    monkeypatch.setenv("MAVDEM_TRACEBACK", "1")
    assert main(["info", str(FLIGHT)]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_memory_that_does_not_suffice_is_one_sentence(monkeypatch, capsys):
    def allocate(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(command_line.mavdem, "invoke", allocate)
    assert main(["info", str(FLIGHT)]) == 2
    assert capsys.readouterr().err.startswith("mavdem: There is not enough memory.")


def test_an_interrupt_is_130(monkeypatch, capsys):
    def interrupted(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(command_line.mavdem, "invoke", interrupted)
    assert main(["info", str(FLIGHT)]) == 130
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_closed_pipe_is_no_error():
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([*MAVDEM, "--help"], stdout=writer, stderr=subprocess.PIPE, timeout=60)
    os.close(writer)
    assert done.returncode == 128 + signal.SIGPIPE
    assert done.stderr == b""
