"""The verdict on streams that are there yet not what they seem: held, rounded, in another unit, partly impossible."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hover import Hover, changed

from mavdem.alignment.align import align
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import verdict_of
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover()


def refused_for(telemetry: Telemetry) -> str:
    verdict = verdict_of(Signals(telemetry))
    assert not verdict.learnable and verdict.remedy
    return verdict.reason


def rounded(telemetry: Telemetry) -> Telemetry:
    """The motors in whole µs."""
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    fields = {f"servo{n}_raw": np.round(table[f"servo{n}_raw"]) for n in (1, 2, 3, 4)}
    return changed(telemetry, "SERVO_OUTPUT_RAW", **fields)


def held(telemetry: Telemetry, message: str, rows: int, only: tuple[str, ...] = ("",)) -> Telemetry:
    """Each ``rows``th message's values again and again, under the stamps as they were; only fields beginning so."""
    table = telemetry.messages[message]
    source = np.arange(len(table["time"])) // rows * rows
    fields = {name: column[source] for name, column in table.items() if name not in ("time", "boot")}
    return changed(telemetry, message, **{name: values for name, values in fields.items() if name.startswith(only)})


@pytest.mark.parametrize(("rows", "told"), [(10, 10.0), (5, 20.0), (25, 4.0)])
@pytest.mark.parametrize(("message", "only"), [("ATTITUDE", ""), ("ATTITUDE", "roll"), ("SERVO_OUTPUT_RAW", "servo")])
def test_values_sent_again_and_again_are_refused_for_the_rate_of_new_ones(message, only, rows, told):
    reason = refused_for(held(rounded(HOVER.telemetry()), message, rows, (only,)))
    found = re.search(message + r" changes only at ([\d.]+) Hz, though it is sent at 100 Hz", reason)
    # At its turning points a rounded command may be the same twice running.
    assert found and 0.9 * told <= float(found[1]) <= told


def test_held_values_are_seen_through_losses_and_a_rate_that_does_not_divide():
    telemetry, random = HOVER.telemetry(), np.random.default_rng(4)
    table = telemetry.messages["ATTITUDE"]
    source = np.floor(np.arange(len(table["time"])) / 6.7).astype(int) * 67 // 10
    kept = np.sort(random.permutation(len(source))[: round(0.9 * len(source))])
    fields = {name: (column if name == "time" else column[source])[kept] for name, column in table.items()}
    assert re.search(r"ATTITUDE changes only at 1\d\.\d Hz", refused_for(changed(telemetry, "ATTITUDE", **fields)))


def test_motors_that_stand_still_because_they_are_rounded_are_not_held():
    """A command that moves by less than a step from message to message repeats whole rows, and then goes on by one."""
    whole = rounded(Hover(command=2.0).telemetry())
    rows = np.column_stack([whole.messages["SERVO_OUTPUT_RAW"][f"servo{n}_raw"] for n in (1, 2, 3, 4)])
    assert np.mean((np.diff(rows, axis=0) == 0).all(axis=1)) > 0.8
    verdict = verdict_of(Signals(whole))
    assert verdict.learnable and verdict.figures.motor_fresh == pytest.approx(100)


def with_steps(step: float, telemetry: Telemetry) -> Telemetry:
    table = telemetry.messages["ATTITUDE"]
    return changed(
        telemetry, "ATTITUDE", **{name: np.round(table[name] / step) * step for name in ("roll", "rollspeed")}
    )


def test_an_attitude_near_its_resolution_is_doubted_and_at_it_refused():
    doubted = verdict_of(Signals(with_steps(0.05, HOVER.telemetry())))
    assert doubted.learnable
    assert any("angle or rate is near the resolution" in caution for caution in doubted.cautions)
    assert doubted.figures.angle_step == pytest.approx(0.05) and doubted.figures.rate_step == pytest.approx(0.05)
    time = np.arange(0, 40, 0.01)
    change = HOVER.roll(time + 0.2) - HOVER.roll(time)
    assert doubted.figures.output_snr == pytest.approx(change.var() / (0.05**2 / 6), rel=0.3)
    time = HOVER.stamps(100.0)
    slow = changed(HOVER.telemetry(), "ATTITUDE", roll=0.3 * np.sin(0.3 * time), rollspeed=0.09 * np.cos(0.3 * time))
    assert verdict_of(Signals(slow)).learnable
    assert "rounding to steps of 0.05 rad" in refused_for(with_steps(0.05, slow))
    assert not any(
        "angle or rate" in caution for caution in verdict_of(Signals(with_steps(0.001, HOVER.telemetry()))).cautions
    )


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("fields", [("yawspeed",), ("roll", "pitch", "rollspeed", "pitchspeed", "yawspeed")])
def test_an_attitude_that_is_no_number_is_refused_as_that(wrong, fields):
    telemetry = HOVER.telemetry()
    nowhere = np.full(len(telemetry.messages["ATTITUDE"]["time"]), wrong)
    reason = refused_for(changed(telemetry, "ATTITUDE", **dict.fromkeys(fields, nowhere)))
    assert "ATTITUDE holds no finite roll angle and rate" in reason


@pytest.mark.parametrize(("field", "wrong"), [("rollspeed", 100.0), ("roll", 1e30), ("pitch", -50.0)])
def test_a_message_that_cannot_be_is_left_out_and_reported(field, wrong):
    telemetry = HOVER.telemetry()
    values = telemetry.messages["ATTITUDE"][field].copy()
    values[3000] = wrong
    verdict = verdict_of(Signals(changed(telemetry, "ATTITUDE", **{field: values})))
    assert verdict.learnable
    assert any(f"1 of {len(values)} ATTITUDE messages were left out, for" in caution for caution in verdict.cautions)
    flight = align(Signals(changed(telemetry, "ATTITUDE", **{field: values})), verdict.segment)
    assert np.abs(flight.outputs).max() < 1


def test_one_wild_rate_does_not_speak_for_the_whole():
    telemetry = Hover(sway=0.01).telemetry()
    rate = telemetry.messages["ATTITUDE"]["rollspeed"].copy()
    rate[3000] = 30.0
    assert verdict_of(Signals(changed(telemetry, "ATTITUDE", rollspeed=rate))).figures.consistency > 0.99


def test_degrees_are_reported_as_such():
    telemetry = Hover(sway=0.15).telemetry()
    degrees = {name: np.degrees(telemetry.messages["ATTITUDE"][name]) for name in ("roll", "rollspeed")}
    assert "not in radians" in refused_for(changed(telemetry, "ATTITUDE", **degrees))
