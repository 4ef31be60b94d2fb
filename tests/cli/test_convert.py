"""``mavdem convert``: what comes out is what went in, and nothing is overwritten that should not be."""

import csv

import numpy as np
from command_line import refused, run, strict_json
from mcap.reader import make_reader
from pytest import mark
from recorded_flights import FLIGHT, SLOW, short_flight

from mavdem import read_flight
from mavdem.results import convert_to_recording


def convert(capsys, *words):
    assert run("convert", *words, "--json") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return strict_json(captured.out)


@mark.slow
def test_through_mcap_a_telemetry_log_comes_back_byte_by_byte(tmp_path, capsys):
    mcap = tmp_path / "flight.mcap"
    back = tmp_path / "back.tlog"
    document = convert(capsys, SLOW, mcap)
    assert document["frames"] > 1000
    assert document["repairs"] == []
    counts = "left_out", "unread", "stamps_filled", "bytes_skipped"
    assert {document[count] for count in counts} == {0}
    assert convert(capsys, mcap, back)["frames"] == document["frames"]
    assert back.read_bytes() == SLOW.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"flight.mcap", "back.tlog"}


@mark.slow
@mark.parametrize("axis", ["roll", "yaw"])
def test_a_table_is_the_flight(axis, tmp_path, capsys):
    """A CSV file has the samples of the flight, rounded to a fixed step for each column."""
    out = tmp_path / "flight.csv"
    document = convert(capsys, FLIGHT, out, "--axis", axis, "--vehicle", "1")
    flight = read_flight(FLIGHT, axis)
    with out.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    values = np.array(rows, dtype=np.float64)
    assert header == document["columns"]
    steps = {"time_s": 1e-6, **{f"motor_{number}_us": 0.01 for number in range(1, 5)}}
    steps |= {"roll_rad": 1e-6} if axis == "roll" else {}
    steps[f"{axis}_rate_rad_s"] = 1e-5
    assert header == [*steps] and document["samples"] == len(values)
    exact = np.column_stack([flight.time, flight.inputs, flight.outputs])
    assert (abs(values - exact) <= 0.5 * np.array([*steps.values()]) * (1 + 1e-6)).all()


@mark.slow
@mark.usefixtures("logs_read_once")
def test_recordings_hold_the_flight_of_the_model(tmp_path, capsys):
    log = short_flight(tmp_path)
    dashboard = tmp_path / "flight.rrd"
    document = convert(capsys, log, dashboard)
    assert document["learnable"] and document["samples"] > 1000
    assert dashboard.read_bytes().startswith(b"RRF2")
    channels = tmp_path / "channels.mcap"
    values = convert_to_recording(log, channels, "roll", None, None)
    assert values | {"out": str(dashboard)} == {name: document[name] for name in values}
    with channels.open("rb") as file:
        counts = make_reader(file).get_summary().statistics.channel_message_counts
    assert document["samples"] in counts.values()


@mark.slow
def test_a_log_without_a_model_has_a_recording_of_its_flight(tmp_path, capsys):
    out = tmp_path / "flight.rrd"
    assert run("convert", SLOW, out, "--json") == 0
    document = strict_json(capsys.readouterr().out)
    assert document["learnable"] is False and document["samples"] > 2 and out.stat().st_size > 1000
    [caution] = document["cautions"]
    assert caution.startswith("No model was learned: ")
    # A log without a vehicle has nothing to show.
    empty = tmp_path / "empty.log"
    empty.write_text("FMT, 9, 23, PARM, Nf, Name,Value\nPARM, SYSID_THISMAV, 1\n")
    assert run("convert", empty, tmp_path / "none.rrd") != 0
    assert not (tmp_path / "none.rrd").exists()


@mark.parametrize("how", ["itself", "by a link", "by a hard link"])
def test_the_input_is_never_overwritten(how, tmp_path, capsys):
    source = tmp_path / "flight.tlog"
    out = tmp_path / "other.csv"
    source.write_bytes(FLIGHT.read_bytes())
    if how == "itself":
        out = tmp_path / "." / "flight.tlog"
    elif how == "by a link":
        out.symlink_to(source)
    else:
        out.hardlink_to(source)
    assert "is the input" in refused(capsys, 2, "convert", source, out)
    assert source.read_bytes() == FLIGHT.read_bytes()
