"""What the command line answers to good, poor and broken input: an exit code, one sentence, and never a traceback."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mavdem import read_flight
from mavdem.cli import commands as command_line
from mavdem.cli.commands import main
from mavdem.export.channels import write_channels

LOGS = Path(__file__).parents[2] / "logs"
FLIGHT = LOGS / "ardupilot_wind5_steps.tlog"


BROKEN = {
    "empty.tlog": b"",
    "text.tlog": b"This is a letter, not a flight.\n" * 100,
    "noise.tlog": bytes(range(256)) * 40,
    "renamed.ulg": b"ULog\x01\x12\x35" + bytes(1000),
    "cut_in_the_first_frame.tlog": FLIGHT.read_bytes()[:20],
    "missing.tlog": None,
}


@pytest.mark.parametrize("name", BROKEN)
@pytest.mark.parametrize("command", ["info", "learn", "compare"])
def test_unreadable_input_is_one_sentence_and_nothing_written(name, command, tmp_path, capsys):
    source, out = tmp_path / name, tmp_path / "out"
    if BROKEN[name] is not None:
        source.write_bytes(BROKEN[name])
    assert main([command, str(source), "--json", *(["--out", str(out)] if command == "learn" else [])]) == 2
    said = capsys.readouterr()
    assert json.loads(said.out)["error"]["reason"]
    assert said.err.startswith("mavdem: ")
    assert said.err.count("\n") == 1
    assert str(source) in said.err
    assert "should not have happened" not in said.err
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["learn", str(FLIGHT), "--out", "x", "--order", "10"], "--order: 10 is not in 2 to 4"),
        (["learn", str(FLIGHT), "--out", "x", "--vehicle", "foo"], "'foo' is no vehicle"),
        (["learn", str(FLIGHT), "--out", "x", "--train", "many"], "'many' is no length: give seconds, as in 7s"),
        (["learn", str(FLIGHT), "--train", "49"], "49 is not a whole number of at least 50 samples"),
        (["info", str(FLIGHT), "--axis", "heave"], "--axis"),
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


@pytest.mark.parametrize("fault", [MemoryError(), KeyboardInterrupt()])
def test_memory_that_does_not_suffice_and_an_interrupt_are_one_sentence(fault, monkeypatch, capsys):
    def fails(*_: object) -> None:
        raise fault

    monkeypatch.setattr(command_line.mavdem, "invoke", fails)
    code, beginning = (
        (130, "mavdem: Interrupted") if isinstance(fault, KeyboardInterrupt) else (2, "mavdem: There is not")
    )
    assert main(["info", str(FLIGHT)]) == code
    said = capsys.readouterr().err
    assert said.startswith(beginning) and "Traceback" not in said
