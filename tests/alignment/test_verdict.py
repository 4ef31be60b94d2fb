"""The verdict: what can be learnt from is let through with its doubts, what cannot is refused with its figures."""

import dataclasses
import json
import re

import numpy as np
import pytest
from hover import X_QUAD, Hover, changed, columns, only, pulses, with_pulses

from mavdem.alignment.align import align, settled_segments
from mavdem.alignment.drive import DEMAND_MESSAGE
from mavdem.alignment.signals import Signals
from mavdem.alignment.verdict import (
    DOUBTFUL_CONSISTENCY,
    DOUBTFUL_SNR,
    cautions_of,
    too_slow,
    verdict_of,
)
from mavdem.ingest import Component
from mavdem.ingest.telemetry import Telemetry

HOVER = Hover()


def test_a_hover_at_100_hz_is_learnable():
    verdict = verdict_of(Signals(HOVER.telemetry()))
    assert verdict.learnable and verdict.remedy == ""
    assert "100.0 Hz" in verdict.reason
    figures = verdict.figures
    assert figures.attitude_rate == pytest.approx(100) and figures.motor_rate == pytest.approx(100)
    assert figures.input_sd == pytest.approx(HOVER.command / np.sqrt(2), rel=0.02)
    assert figures.consistency == pytest.approx(1, abs=1e-3)
    assert figures.armed == pytest.approx(HOVER.landed + 1 - 5, abs=1.0)
    assert figures.airborne == pytest.approx(HOVER.landed - 6, abs=2.0)


def test_sentences_call_messages_by_their_names_in_the_log():
    hover = Hover().telemetry(4.0, 4.0)
    names = {"ATTITUDE": "ATT", "SERVO_OUTPUT_RAW": "RCOU", "ACTUATOR_CONTROL_TARGET": "RATE"}
    logged = dataclasses.replace(hover, translated_from="DataFlash", names=names)
    silent = dataclasses.replace(logged, messages={"HEARTBEAT": hover.messages["HEARTBEAT"]})
    for telemetry, inputs in ((logged, None), (silent, None), (logged, "demand")):
        said = verdict_of(Signals(telemetry, inputs=inputs))
        assert not any(name in f"{said.reason} {said.remedy}" for name in names), said


LONG = Hover(hovering=150.0)


def slow_then_fast(change: float, fast_from: float, fast_until: float = LONG.end) -> Telemetry:
    """Attitude and motors at 15 Hz before ``change``, at 100 Hz from ``fast_from``."""
    stamps = np.concatenate([np.arange(0, change, 1 / 15), np.arange(fast_from, fast_until, 0.01)])
    return LONG.telemetry(stamps, stamps)


@pytest.mark.parametrize("fast_from", [100.0, 100.5], ids=["at once", "after a gap"])
def test_the_fast_part_of_a_flight_is_learnt_from_and_the_slow_part_is_not(fast_from):
    verdict = verdict_of(Signals(slow_then_fast(100.0, fast_from)))
    assert verdict.learnable
    assert verdict.segment.start == pytest.approx(fast_from, abs=0.1)
    assert verdict.figures.attitude_rate == pytest.approx(100, rel=1e-3)
    assert verdict.figures.attitude_gap == pytest.approx(0.01)


def test_a_fast_part_too_short_to_learn_from_is_refused_for_the_rate_of_the_rest():
    stamps = np.concatenate(
        [np.arange(0, 100, 1 / 15), np.arange(100, 103, 0.01), np.arange(103, LONG.end, 1 / 15)]
    )
    reason = refused_for(LONG.telemetry(stamps, stamps))
    assert re.search(r"comes at 1\d\.\d Hz", reason)


def test_both_messages_are_blamed_where_both_are_slow_whichever_is_slower():
    for attitude, motors in ((9.76983, 9.76985), (9.76985, 9.76983)):
        reason = too_slow({"ATTITUDE": attitude, "SERVO_OUTPUT_RAW": motors}, "roll")
        assert reason.startswith(
            "ATTITUDE comes at 9.8 Hz and SERVO_OUTPUT_RAW at 9.8 Hz; roll motion has"
        )
    assert too_slow({"ATTITUDE": 100.0, "SERVO_OUTPUT_RAW": 39.99}, "roll").startswith(
        "SERVO_OUTPUT_RAW comes at 39.99 Hz;"
    )
    assert too_slow({"ATTITUDE": 40.0, "SERVO_OUTPUT_RAW": 40.0}, "roll") is None


def slowed(change: float, rate: float = 4.0) -> Telemetry:
    """100 Hz until ``change``, ``rate`` Hz from then on."""
    stamps = np.concatenate([np.arange(0, change, 0.01), np.arange(change, LONG.end, 1 / rate)])
    return LONG.telemetry(stamps, stamps)


STATION = Component(255, 190, "GCS", "INVALID", {"HEARTBEAT": 60, "REQUEST_DATA_STREAM": 4}, 0)


@pytest.mark.parametrize("change", [8.0, 15.0])
def test_rates_that_drop_in_the_air_are_no_link_that_drops_out(change):
    verdict = verdict_of(Signals(slowed(change)), components=(STATION,))
    assert not verdict.learnable
    assert re.search(
        rf"In the air ATTITUDE comes at [34]\.\d Hz from {change:.0f}\.\d s after boot on",
        verdict.reason,
    )
    assert "need 40 Hz" in verdict.reason and "drop out" not in verdict.remedy
    assert verdict.remedy.startswith(
        "A ground station (255:190) sets rates with REQUEST_DATA_STREAM: "
    )
    assert verdict.remedy.count("streamrate -1") == 1 and "SRn_EXTRA1" in verdict.remedy


def test_who_asks_for_rates_is_named_only_where_somebody_does():
    telemetry = slowed(15.0)
    own = Component(1, 1, "QUADROTOR", "ARDUPILOTMEGA", {"REQUEST_DATA_STREAM": 1}, 0)
    unasked = verdict_of(Signals(telemetry), components=(own,)).remedy
    assert unasked.startswith("Set the telemetry port's") and unasked.count("streamrate -1") == 1
    answered = changed(
        telemetry, "COMMAND_ACK", **columns(np.array([14.0]), command=np.array([511]))
    )
    assert (
        "SET_MESSAGE_INTERVAL, which the vehicle acknowledged"
        in verdict_of(Signals(answered)).remedy
    )


def with_contradiction(telemetry: Telemetry, start: float, end: float) -> Telemetry:
    """The rate has nothing to do with the angle from ``start`` to ``end``, after which 0.5 s are missing."""
    telemetry = only(
        telemetry, lambda time: (time <= end) | (time > end + 0.5), "ATTITUDE", "SERVO_OUTPUT_RAW"
    )
    time, rate = (telemetry.messages["ATTITUDE"][name] for name in ("time", "rollspeed"))
    wrong = np.where((time >= start) & (time <= end), np.sin(2 * np.pi * 0.7 * time), rate)
    return changed(telemetry, "ATTITUDE", rollspeed=wrong)


def test_the_longest_segment_that_can_be_learnt_from_is_taken_or_the_longest_explains():
    telemetry = with_contradiction(LONG.telemetry(), 0.0, 100.0)
    longest, second = settled_segments(Signals(telemetry))
    verdict = verdict_of(Signals(telemetry))
    assert verdict.learnable and verdict.segment == second
    assert verdict.figures.duration == pytest.approx(second.duration, abs=0.1)
    refused = verdict_of(Signals(with_contradiction(telemetry, 0.0, LONG.end)))
    assert not refused.learnable and refused.segment == longest
    assert "contradict" in refused.reason


def refused_for(telemetry: Telemetry) -> str:
    verdict = verdict_of(Signals(telemetry))
    assert not verdict.learnable and verdict.remedy
    return verdict.reason


def test_where_nothing_shows_flight_nothing_is_claimed_about_it():
    time = HOVER.stamps(100.0)
    controls = np.full((len(time), 8), np.nan)
    controls[:, :3] = np.sin(time)[:, None]
    demand = {"time": time, "boot": np.zeros(len(time), dtype=np.int64), "controls": controls}
    telemetry = HOVER.telemetry(without=("SERVO_OUTPUT_RAW", "EXTENDED_SYS_STATE"))
    said = refused_for(changed(telemetry, "ACTUATOR_CONTROL_TARGET", **demand))
    assert (
        said
        == "Nothing shows when the vehicle flew: no EXTENDED_SYS_STATE, motor outputs or thrust."
    )


def test_a_hover_on_little_of_the_motors_range_is_a_flight_where_the_autopilot_idles_lower():
    telemetry = HOVER.telemetry()
    strong = with_pulses(telemetry, 1000 + (pulses(telemetry) - 1000) // 3)
    assert "flight takes 20 %" in refused_for(strong)
    strong = dataclasses.replace(strong, parameters={**strong.parameters, "MOT_SPIN_MIN": 0.06})
    assert verdict_of(Signals(strong)).learnable


@pytest.mark.parametrize(
    ("figure", "limit", "doubted_below", "words"),
    [
        # 1/(1 + 20): rounding can shrink what is learnt by 5 %.
        (
            "output_snr",
            DOUBTFUL_SNR,
            True,
            "rounding can shrink what is learnt of the dynamics by 5 %",
        ),
        (
            "consistency",
            DOUBTFUL_CONSISTENCY,
            True,
            "The rate explains only 0.80 of the angle's changes",
        ),
    ],
)
def test_a_figure_is_doubted_on_one_side_of_its_limit_only(figure, limit, doubted_below, words):
    signals = Signals(HOVER.telemetry())
    figures = verdict_of(signals).figures
    for value, doubted in ((limit - 1e-3, doubted_below), (limit + 1e-3, not doubted_below)):
        said = " ".join(cautions_of(signals, dataclasses.replace(figures, **{figure: value})))
        assert (words in said) == doubted


def with_outputs(outputs: float | None = None, **parameters: float) -> Telemetry:
    """A hover whose outputs stand still, if they are given, with these parameters."""
    telemetry = HOVER.telemetry(parameters=parameters)
    return (
        telemetry
        if outputs is None
        else with_pulses(telemetry, np.full((8, len(HOVER.stamps(100.0))), outputs))
    )


def disarmed(telemetry: Telemetry) -> Telemetry:
    return changed(telemetry, "HEARTBEAT", base_mode=np.ones(len(HOVER.stamps(1.0)), dtype=int))


def idling() -> Telemetry:
    running = pulses(HOVER.telemetry()) > 1000
    return with_pulses(HOVER.telemetry(), np.where(running, 1100 + np.arange(1, 5)[:, None], 1000))


def shaking(size: float = 1.0, share: float = 1.0) -> Telemetry:
    """97 Hz sampled at 100 Hz looks like a slow oscillation of the rate that the angle does not follow."""
    time, rate = (HOVER.telemetry().messages["ATTITUDE"][name] for name in ("time", "rollspeed"))
    return changed(
        HOVER.telemetry(), "ATTITUDE", rollspeed=share * rate + size * np.sin(2 * np.pi * 97 * time)
    )


GAPS = HOVER.stamps(100.0)[HOVER.stamps(100.0) % 3.0 < 2.5]
FOUR, SIX = (
    {f"SERVO{step * n + first}_FUNCTION": 32.0 + n for n in range(1, last)}
    for step, first, last in ((1, 4, 5), (2, 0, 7))
)
REFUSED = {
    "slow": (HOVER.telemetry(4.0, 4.0), "4.0 Hz; roll motion has", "EXTRA1 and SRn_RC_CHAN"),
    "slow motors": (HOVER.telemetry(100.0, 10.0), "SERVO_OUTPUT_RAW comes at 10.0 Hz", "RC_CHAN"),
    "slow attitude": (HOVER.telemetry(15.0, 100.0), "which need 40 Hz of attitude", "EXTRA1"),
    "slow PX4": (
        HOVER.telemetry(4.0, 4.0, autopilot="PX4"),
        "4.0 Hz",
        "`mavlink stream -d DEVICE -s ATTITUDE -r 100`",
    ),
    "slow other": (
        HOVER.telemetry(4.0, 4.0, autopilot="INVALID"),
        "4.0 Hz",
        "36 (SERVO_OUTPUT_RAW) every 10000 µs",
    ),
    "gaps": (
        HOVER.telemetry(GAPS, GAPS),
        "without gaps lasts 2.5 s",
        "with a link that does not drop out",
    ),
    "short": (Hover(hovering=4.0).telemetry(), "of the 5 s needed", "Hover for half a minute"),
    "no attitude": (
        HOVER.telemetry(without=("ATTITUDE",)),
        "There is no ATTITUDE",
        "SET_MESSAGE_INTERVAL 30 10000",
    ),
    "no motors": (
        HOVER.telemetry(without=("SERVO_OUTPUT_RAW",)),
        "no message with motor outputs",
        "INTERVAL 36 10000",
    ),
    "disarmed": (disarmed(HOVER.telemetry()), "The vehicle was never armed.", "Record a flight"),
    "disarmed and still": (
        disarmed(with_outputs(1000.0)),
        "The vehicle was never armed.",
        "Record a flight",
    ),
    "still": (
        with_outputs(1000.0),
        "The motors did not run: no output in SERVO_OUTPUT_RAW ever changes.",
        "Record",
    ),
    "other channels": (
        with_outputs(**FOUR),
        "are on channels 5, 6, 7, 8, which never change in SERVO_",
        "Record",
    ),
    "too few": (
        with_outputs(**SIX),
        "8, 10, 12, but SERVO_OUTPUT_RAW has no channel 10, 12.",
        "16",
    ),
    "idling": (
        idling(),
        "its motors ran at 10 % of their range at most, and flight takes 20 %",
        "Record a flight",
    ),
    "shaking": (shaking(), "contradict", "long SET_MESSAGE_INTERVAL 30 5000"),
    "noise of a gyroscope": (shaking(0.01, 0.0), "hardly moves", "excite roll with the stick"),
    "submarine": (
        HOVER.telemetry(vehicle="SUBMARINE"),
        "HEARTBEAT reports the type SUBMARINE; ",
        "multirotor's log.",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_learnt_from_is_refused_with_its_figures_and_a_remedy(name):
    telemetry, reason, remedy = REFUSED[name]
    verdict = verdict_of(Signals(telemetry))
    assert not verdict.learnable and reason in verdict.reason and remedy in verdict.remedy


def test_another_vehicle_is_named_only_where_there_is_one():
    signals = Signals(HOVER.telemetry(vehicle="SUBMARINE"))
    other = Component(4, 1, "QUADROTOR", "PX4", {}, 0)
    assert "--vehicle" not in verdict_of(signals, [STATION]).remedy
    assert (
        "name the QUADROTOR of this log: `--vehicle 4:1`"
        in verdict_of(signals, [STATION, other]).remedy
    )


def rounded(hover: Hover) -> Telemetry:
    telemetry = hover.telemetry()
    motors = pulses(telemetry)
    return with_pulses(
        telemetry, np.round(motors + np.random.default_rng(2).normal(0, 3, motors.shape[1]))
    )


def test_a_command_at_the_floor_of_the_stream_is_refused():
    near = verdict_of(Signals(rounded(Hover(command=0.5))))
    assert near.learnable
    truth = (0.5**2 / 2) / (1 / 12 * np.sum(X_QUAD**2) / 16)
    assert near.figures.input_snr == pytest.approx(truth, rel=0.3)
    assert "rounding" in refused_for(rounded(Hover(command=0.1)))


def random_stamps(random: np.random.Generator, end: float) -> np.ndarray:
    """A stream that changes its pace a few times, rounded or not."""
    paces = random.choice(
        [0.001, 0.0025, 0.01, 0.02, 0.066, 0.25, 1.0, 3.0], size=random.integers(1, 5)
    )
    steps = [random.exponential(pace, random.integers(1, 300)) for pace in paces]
    stamps = np.round(np.cumsum(np.concatenate(steps)), random.choice([3, 6]))
    return stamps[stamps < end]


@pytest.mark.parametrize("seed", range(40))
def test_mutilated_telemetry_is_judged_and_its_segments_align(seed):
    """Whatever is missing, shuffled, repeated or not a number, there is a verdict, and every segment makes a Flight."""
    random = np.random.default_rng(seed)
    hover = Hover(hovering=random.uniform(0, 20))
    streams = [random_stamps(random, hover.end) for _ in range(2)]
    telemetry = hover.telemetry(
        *(streams if seed % 2 else random.choice([1.0, 4.0, 50.0, 100.0], 2))
    )
    for message, table in telemetry.messages.items():
        rows = len(table["time"])
        kept = random.permutation(rows)[: random.choice([0, 1, 2, rows // 3, rows, rows, rows])]
        columns = {name: column[kept].copy() for name, column in table.items()}
        if message != "HEARTBEAT" and len(kept):
            hit = random.choice([name for name in columns if name not in ("boot", "port")])
            columns[hit][: rows // 20] = random.choice([np.nan, np.inf, 0.0, -1e6])
            columns["boot"] = np.int64(np.nan_to_num(columns["time"]) > random.uniform(0, 60))
        telemetry = changed(telemetry, message, **columns)
    verdict = verdict_of(Signals(telemetry))
    assert verdict.learnable == (verdict.remedy == "")
    assert json.loads(json.dumps(verdict.as_dict(), allow_nan=False))["reason"] == verdict.reason
    for segment in settled_segments(Signals(telemetry)):
        assert len(align(Signals(telemetry), segment)) >= 1


def in_whole_pulses(telemetry: Telemetry) -> Telemetry:
    """The motors in whole µs."""
    return with_pulses(telemetry, np.round(pulses(telemetry)))


def held(telemetry: Telemetry, message: str, rows: int, only: tuple[str, ...] = ("",)) -> Telemetry:
    """Each ``rows``th message's values again and again, under the stamps as they were; only fields beginning so."""
    table = telemetry.messages[message]
    source = np.arange(len(table["time"])) // rows * rows
    fields = {
        name: column[source] for name, column in table.items() if name not in ("time", "boot")
    }
    return changed(
        telemetry,
        message,
        **{name: values for name, values in fields.items() if name.startswith(only)},
    )


@pytest.mark.parametrize(("rows", "told"), [(10, 10.0), (5, 20.0), (25, 4.0)])
@pytest.mark.parametrize(
    ("message", "only"), [("ATTITUDE", ""), ("ATTITUDE", "roll"), ("SERVO_OUTPUT_RAW", "servo")]
)
def test_values_sent_again_and_again_are_refused_for_the_rate_of_new_ones(
    message, only, rows, told
):
    reason = refused_for(held(in_whole_pulses(HOVER.telemetry()), message, rows, (only,)))
    found = re.search(
        message + r" changes only at ([\d.]+) Hz, though it is sent at 100 Hz", reason
    )
    # At its turning points a rounded command may be the same twice running.
    assert found and 0.9 * told <= float(found[1]) <= told


def test_held_values_are_seen_through_losses_and_a_rate_that_does_not_divide():
    telemetry = HOVER.telemetry()
    random = np.random.default_rng(4)
    table = telemetry.messages["ATTITUDE"]
    source = np.floor(np.arange(len(table["time"])) / 6.7).astype(int) * 67 // 10
    kept = np.sort(random.permutation(len(source))[: round(0.9 * len(source))])
    fields = {
        name: (column if name == "time" else column[source])[kept] for name, column in table.items()
    }
    assert re.search(
        r"ATTITUDE changes only at 1\d\.\d Hz",
        refused_for(changed(telemetry, "ATTITUDE", **fields)),
    )


def test_motors_that_stand_still_because_they_are_rounded_are_not_held():
    """A command that moves by less than a step from message to message repeats whole rows, and then goes on by one."""
    whole = in_whole_pulses(Hover(command=2.0).telemetry())
    assert np.mean((np.diff(pulses(whole)) == 0).all(axis=0)) > 0.8
    verdict = verdict_of(Signals(whole))
    assert verdict.learnable and verdict.figures.motor_fresh == pytest.approx(100)


def with_steps(step: float, telemetry: Telemetry) -> Telemetry:
    table = telemetry.messages["ATTITUDE"]
    rounded = {name: np.round(table[name] / step) * step for name in ("roll", "rollspeed")}
    return changed(telemetry, "ATTITUDE", **rounded)


def test_an_attitude_near_its_resolution_is_doubted_and_at_it_refused():
    doubted = verdict_of(Signals(with_steps(0.05, HOVER.telemetry())))
    assert doubted.learnable
    assert any("angle or rate is near the resolution" in caution for caution in doubted.cautions)
    assert doubted.figures.angle_step == pytest.approx(
        0.05
    ) and doubted.figures.rate_step == pytest.approx(0.05)
    time = np.arange(0, 40, 0.01)
    change = HOVER.roll(time + 0.2) - HOVER.roll(time)
    assert doubted.figures.output_snr == pytest.approx(change.var() / (0.05**2 / 6), rel=0.3)
    time = HOVER.stamps(100.0)
    slow = changed(
        HOVER.telemetry(),
        "ATTITUDE",
        roll=0.3 * np.sin(0.3 * time),
        rollspeed=0.09 * np.cos(0.3 * time),
    )
    assert verdict_of(Signals(slow)).learnable
    assert "rounding to steps of 0.05 rad" in refused_for(with_steps(0.05, slow))
    assert not any(
        "angle or rate" in caution
        for caution in verdict_of(Signals(with_steps(0.001, HOVER.telemetry()))).cautions
    )


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    "fields", [("yawspeed",), ("roll", "pitch", "rollspeed", "pitchspeed", "yawspeed")]
)
def test_an_attitude_that_is_no_number_is_refused_as_that(wrong, fields):
    telemetry = HOVER.telemetry()
    nowhere = np.full(len(telemetry.messages["ATTITUDE"]["time"]), wrong)
    reason = refused_for(changed(telemetry, "ATTITUDE", **dict.fromkeys(fields, nowhere)))
    assert "ATTITUDE holds no finite roll angle and rate" in reason


@pytest.mark.parametrize(
    ("field", "wrong"), [("rollspeed", 100.0), ("roll", 1e30), ("pitch", -50.0)]
)
def test_a_message_that_cannot_be_is_left_out_and_reported(field, wrong):
    telemetry = HOVER.telemetry()
    values = telemetry.messages["ATTITUDE"][field].copy()
    values[3000] = wrong
    verdict = verdict_of(Signals(changed(telemetry, "ATTITUDE", **{field: values})))
    assert verdict.learnable
    assert any(
        f"1 of {len(values)} ATTITUDE messages were left out, for" in caution
        for caution in verdict.cautions
    )
    flight = align(Signals(changed(telemetry, "ATTITUDE", **{field: values})), verdict.segment)
    assert np.abs(flight.outputs).max() < 1


def test_one_wild_rate_does_not_speak_for_the_whole_and_degrees_are_reported_as_such():
    telemetry = Hover(sway=0.01).telemetry()
    rate = telemetry.messages["ATTITUDE"]["rollspeed"].copy()
    rate[3000] = 30.0
    assert (
        verdict_of(Signals(changed(telemetry, "ATTITUDE", rollspeed=rate))).figures.consistency
        > 0.99
    )
    telemetry = Hover(sway=0.15).telemetry()
    degrees = {
        name: np.degrees(telemetry.messages["ATTITUDE"][name]) for name in ("roll", "rollspeed")
    }
    assert "not in radians" in refused_for(changed(telemetry, "ATTITUDE", **degrees))


def remedy_for(translated_from: str, without_demand: bool = False, **fields: object) -> str:
    """What to do about a log at 4 Hz whose autopilot had these parameters, firmware and lost messages."""
    telemetry = Hover().telemetry(4.0, 4.0)
    if not without_demand:
        stamps = Hover().stamps(4.0)
        telemetry = changed(
            telemetry, DEMAND_MESSAGE, **columns(stamps, controls=np.zeros((len(stamps), 8)))
        )
    return verdict_of(
        Signals(dataclasses.replace(telemetry, translated_from=translated_from, **fields))
    ).remedy


def test_no_remedy_is_in_force_already_in_a_dataflash_log_a_ulog_and_a_stream():
    assert "is 176126 in this log: set it to 176127" in remedy_for(
        "DataFlash", parameters={"LOG_BITMASK": 176126.0}
    )
    assert remedy_for("DataFlash", parameters={"LOG_BITMASK": -6146.0}).startswith(
        "LOG_BITMASK is -6146 in this log"
    )
    assert remedy_for("DataFlash").startswith(
        "If it is not set (the log does not show it), set bit 0 of LOG_BITMASK"
    )
    in_force = {"LOG_BITMASK": 32767.0}
    for firmware, cure in (
        ("ArduCopter V3.3-dev (a5a72a84)", "install ArduCopter 3.3 or later"),
        ("", "give the log as the autopilot wrote it, or fly anew with a firmware that logs it"),
        ("ArduCopter V3.3.3 (acf3e3d)", "give the log as the autopilot wrote it"),
    ):
        remedy = remedy_for(
            "DataFlash", without_demand=True, parameters=in_force, firmware=firmware
        )
        assert firmware in remedy and cure in remedy and "already" in remedy
    old = remedy_for(
        "DataFlash",
        without_demand=True,
        parameters={"LOG_BITMASK": 830.0},
        firmware="ArduCopter V3.2.1",
    )
    assert "install ArduCopter 3.3 or later" in old and "already" not in old
    limits = {"LOG_FILE_RATEMAX": 10.0, "LOG_BLK_RATEMAX": 20.0, "LOG_MAV_RATEMAX": 100.0}
    limited = remedy_for("DataFlash", parameters={**in_force, **limits})
    assert "set LOG_FILE_RATEMAX, 10 Hz in this log, to 0, and LOG_BLK_RATEMAX, 20 Hz" in limited
    assert "LOG_MAV" not in limited and "et bit 0" not in limited
    assert "LOG_BLK" not in remedy_for("DataFlash", parameters={**limits, "LOG_BACKEND_TYPE": 1.0})
    assert "no room for 12 messages" in remedy_for("DataFlash", parameters=in_force, dropouts=12)
    assert "SDLOG_PROFILE is 131 in this log: set it to 147" in remedy_for(
        "ULog", parameters={"SDLOG_PROFILE": 131.0}
    )
    assert "this PX4 has no such parameter" in remedy_for("ULog", parameters={"SDLOG_MODE": 0.0})
    in_force = {"SDLOG_PROFILE": 17.0}
    assert "logger_topics.txt" in remedy_for("ULog", parameters=in_force)
    assert "dropped out 3 times" in remedy_for("ULog", parameters=in_force, dropouts=3)
    assert "SRn_EXTRA1 and SRn_RC_CHAN to 100" in remedy_for(
        "", parameters={"SR0_EXTRA1": 4.0, "SR0_RC_CHAN": 4.0}
    )
    assert "the telemetry port's MAVn_EXTRA1 and MAVn_RC_CHAN to 100" in remedy_for(
        "", parameters={"MAV1_EXTRA1": 4.0}
    )
    fast = {
        "SR0_EXTRA1": 4.0,
        "SR0_RC_CHAN": 4.0,
        "SR1_EXTRA1": 100.0,
        "SR1_RC_CHAN": 50.0,
        "SR2_EXTRA1": 100.0,
    }
    remedy = remedy_for("", parameters=fast)
    assert (
        remedy.startswith("SR1_EXTRA1 and SR1_RC_CHAN are 40 or more already")
        and "SR2" not in remedy
    )
