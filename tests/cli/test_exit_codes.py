"""What the command line answers to good, poor and broken input: an exit code, one sentence, and never a traceback."""

import os
import shlex
import signal
import subprocess
from pathlib import Path
from unittest.mock import Mock

import click
import numpy as np
from command_line import MAVDEM, refused, run, strict_json
from patience import PATIENCE
from pytest import mark, raises
from recorded_flights import FLIGHT, LOGS, SLOW

from mavdem import read_flight
from mavdem.cli import commands as command_line
from mavdem.cli.commands import main, mavdem
from mavdem.cli.termination import raise_on_termination_signals
from mavdem.export.mcap_channels import write_channels
from mavdem.processes import TERMINATION_SIGNALS

BROKEN = {
    "empty.tlog": b"",
    "text.tlog": b"This is a letter, not a flight.\n" * 100,
    "noise.tlog": bytes(range(256)) * 40,
    "renamed.ulg": b"ULog\x01\x12\x35" + bytes(1000),
    "cut_in_the_first_frame.tlog": FLIGHT.read_bytes()[:20],
    "missing.tlog": None,
}


@mark.parametrize("name", BROKEN)
@mark.parametrize("command", ["info", "learn", "compare", "wind", "tune", "convert"])
def test_unreadable_input_is_one_sentence_and_nothing_written(name, command, tmp_path, capsys):
    source = tmp_path / name
    out = tmp_path / "out"
    if BROKEN[name] is not None:
        source.write_bytes(BROKEN[name])
    arguments = {"learn": ["--out", str(out)], "convert": [f"{out}.csv"]}.get(command, [])
    assert run(command, source, "--json", *arguments) == 2
    captured = capsys.readouterr()
    assert strict_json(captured.out)["error"]["reason"]
    assert captured.err.startswith("mavdem: ")
    assert captured.err.count("\n") == 1
    assert str(source) in captured.err
    assert "should not have happened" not in captured.err
    assert not list(tmp_path.glob("out*"))


@mark.parametrize(
    "line, named",
    {
        "learn {flight} --out x --order 10": "--order: 10 is not in 2 to 4",
        "learn {flight} --out x --preset paper --order 11": "--order: 11 is not in 1 to 10",
        "learn {flight} --out x --start 86401": "0<=x<=86400",
        "track {logs} --out f --jobs 1025": "from 1 to 1024",
        "learn {flight} --out x --axis up": "'up' is not one of 'roll', 'pitch', 'yaw', 'all'",
        "learn {flight} --out x --train many": "'many' is no length: give seconds, as in 7s",
        "learn {flight} --out x --vehicle --verbose": "--verbose is an option",
        "learn {flight} --out ''": "An argument is empty",
        "learn flight.mcap --out .": "--out . would replace flight.mcap. Name another folder.",
        "learn {flight} --out new/" + "x" * 300: "cannot be written (File name too long)",
        "review x/model.json --out x": "--out x would replace x/model.json",
        "tune {flight} --params ./gains.stage1.param --out .": "would replace gains.stage1.param",
        "fly hover_blower --params /dev/null": "/dev/null is not a plain file. Name another",
        "fly {flight} --out f.tlog": "ardupilot_wind5_steps.tlog is no scenario or vehicle file",
        "learn /dev/ttyACM0,115200 --out x": "`mavdem live /dev/ttyACM0,115200`",
        "info udpin:127.0.0.1:14550": "a MAVLink link, and only logs are read here. Attach to it with",
        "info -": "A log cannot be read from standard input (-). Save it as a file",
        "info {logs}": f"{LOGS} is a folder, with 5 logs in it. Name a file, such as {LOGS}/ardupilot_default",
        "info .": "is a folder, with no log in it. Name a file that ends in .tlog, ",
        "convert {flight} flight.txt": ".parquet",
        "convert {flight} " + "x" * 300 + ".csv": "cannot be written (File name too long)",
        "convert {flight} again.tlog": ".tlog already",
        "compare {flight} {flight}": "the same log as",
        "track {logs} --out f --time-limit 1000001": "1<=x<=1000000",
        "track {logs} --out f --memory-limit 1000001": "from 256 to 1000000",
        "fly hover_blower": "--out",
        "info --wrong": "No such option '--wrong'. Try ",
        "info --vehicel 1": "'--vehicle'",
        "fly nowhere --out f.tlog": "nowhere",
        "fly hover_blower --rrd f.png": ".rrd",
        "fly hover_blower --out f.tlog --duration 2": "Invalid value for --duration:",
        "fly hover_blower --out f.tlog --seed -1": "seed must be",
        "fly hover_blower --udp 127.0.0.1:" + "1" * 5000: "HOST:PORT",
        "fly hover_blower --udp a..b:12": "Nothing can be sent to a..b:12",
        "fly hover_blower --udp h\udcff:12": "Nothing can be sent to h",
        "fly hover_blower --udp 255.255.255.255:14550": "name one host",
        "fly hover_blower --udp 127.0.0.1:14550 --speed 1e-300": "--speed",
        "fly hover_blower --udp 127.0.0.1:14550 --out f.tlog": "choose one",
    }.items(),
)
def test_bad_usage_names_what_is_wrong(line, named, here, capsys):
    """Each command line is refused with exit code 2 and a sentence that names the argument, and no file is written."""
    arguments = shlex.split(line.format(flight=FLIGHT, logs=LOGS))
    assert named in refused(capsys, 2, *arguments)
    assert list(here.iterdir()) == []


@mark.slow
def test_a_result_is_distinguished_from_a_log(tmp_path, capsys):
    path = tmp_path / "flight.mcap"
    write_channels(path, [read_flight(FLIGHT)[:100]])
    error_text = refused(capsys, 2, "info", path)
    assert "was written by `mavdem learn`" in error_text and "Name the log" in error_text


FULL = Path("/dev/full")


@mark.slow
@mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@mark.parametrize("words", [["info", "none", "--json"], ["--help"]])
def test_a_standard_output_that_fails_is_reported(words):
    with FULL.open("w", encoding="utf-8") as full:
        done = subprocess.run(
            [*MAVDEM, *words], stdout=full, stderr=subprocess.PIPE, text=True, timeout=PATIENCE
        )
    assert done.returncode == 2
    *_, last = done.stderr.splitlines()
    assert last.startswith("mavdem: Standard output cannot be written to (")
    assert "Traceback" not in done.stderr and "should not have happened" not in done.stderr


@mark.slow
def test_an_interrupt_while_starting_ends_the_process(tmp_path):
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
    assert done.returncode == -signal.SIGINT and done.stderr == ""


def test_the_help_says_of_each_command_what_it_says_itself():
    context = click.Context(mavdem)
    for name, click_command in mavdem.commands.items():
        _, command, _ = mavdem.resolve_command(context, [name])
        assert command is not click_command
        assert command.get_short_help_str(limit=200) == click_command.get_short_help_str(limit=200)


@mark.slow
def test_a_file_named_like_a_link_is_a_file(here, capsys):
    Path("COM3").write_bytes(SLOW.read_bytes())
    # The option may stand before the command too. The file is read, and too slow for a model.
    assert run("--json", "info", "COM3") == 1
    assert "from COM3; 1:1: ATTITUDE comes at 4 Hz" in capsys.readouterr().err
    assert "link" in refused(capsys, 2, "info", "COM4")


@mark.slow
@mark.parametrize("closed", [1, 2])
def test_a_closed_stream_or_pipe_is_as_one_that_nobody_reads(closed):
    timed = {"stderr": subprocess.PIPE, "timeout": PATIENCE}
    without = ["sh", "-c", f'exec "$@" {closed}>&-', "sh"]
    done = subprocess.run([*without, *MAVDEM, "--help"], stdout=subprocess.PIPE, **timed)
    assert (done.returncode, done.stderr) == (0, b"")
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([*MAVDEM, "--help"], stdout=writer, **timed)
    os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, b"")


def completions(monkeypatch, capsys, *words):
    """Returns what a shell offers to complete after these words of a command line."""
    monkeypatch.setenv("COMP_WORDS", " ".join(("mavdem", *words)).rstrip())
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    monkeypatch.setenv("_MAVDEM_COMPLETE", "bash_complete")
    assert main([]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out.split()


def test_commands_options_and_values_are_offered(monkeypatch, capsys):
    assert completions(monkeypatch, capsys, "le") == ["plain,learn"]
    assert completions(monkeypatch, capsys, "learn", "x.tlog", "--o") == [
        "plain,--out",
        "plain,--order",
    ]
    assert completions(monkeypatch, capsys, "info", "--axis", "") == [
        "plain,roll",
        "plain,pitch",
        "plain,yaw",
    ]
    assert completions(monkeypatch, capsys, "info", "fli") == ["file,fli"]


@mark.parametrize(
    "fault, code, told",
    [
        (MemoryError(), 2, "There is not enough memory."),
        (KeyboardInterrupt(), 130, "Interrupted"),
        (RuntimeError("a\nfault"), 2, "MAVDEM_TRACEBACK=1"),
    ],
)
def test_a_fault_and_an_interrupt_are_one_sentence(fault, code, told, monkeypatch, capsys):
    """A command raises an exception.

    One line is printed; the traceback only on demand, and only for an unexpected fault.
    """
    monkeypatch.delenv("MAVDEM_TRACEBACK", raising=False)
    monkeypatch.setattr(command_line.mavdem, "invoke", Mock(side_effect=fault))
    assert run("info", FLIGHT) == code
    error_output = capsys.readouterr().err
    assert (
        told in error_output
        and error_output.startswith("mavdem: ")
        and error_output.count("\n") == 1
        and "Traceback" not in error_output
    )
    monkeypatch.setenv("MAVDEM_TRACEBACK", "1")
    assert run("info", FLIGHT) == code
    if isinstance(fault, RuntimeError):
        assert "Traceback" in capsys.readouterr().err
    else:
        assert "Traceback" not in capsys.readouterr().err


def test_no_warning_about_numbers_reaches_the_terminal(monkeypatch, capsys, recwarn):
    monkeypatch.setattr(command_line.mavdem, "invoke", lambda _: np.ones(1) / 0)
    assert run("info", FLIGHT) == 0
    assert capsys.readouterr().err == "" and not recwarn.list


@mark.parametrize(
    "number, exception, code",
    [(signal.SIGINT, KeyboardInterrupt, None), (signal.SIGTERM, SystemExit, 143)],
)
def test_the_first_signal_ends_a_command_and_later_ones_change_nothing(number, exception, code):
    """A termination signal is raised twice: the first raises an exception, the second is ignored."""
    handlers = {
        signal_number: signal.getsignal(signal_number) for signal_number in TERMINATION_SIGNALS
    }
    signal.signal(number, signal.SIG_DFL)
    try:
        raise_on_termination_signals()
        with raises(exception) as ended:
            signal.raise_signal(number)
        signal.raise_signal(number)
    finally:
        for signal_number, handler in handlers.items():
            signal.signal(signal_number, handler)
    assert getattr(ended.value, "code", None) == code
