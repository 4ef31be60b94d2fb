"""The verdict: what can be learnt from is let through with its doubts, what cannot is refused with its figures."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hover import X_QUAD, Hover, changed

from mavdem.align import align, segments
from mavdem.cli.main import mavdem
from mavdem.errors import NotLearnable
from mavdem.read import choose_vehicle, read_flight
from mavdem.telemetry import Telemetry
from mavdem.verdict import judge

HOVER = Hover()
DATA = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[2] / "shared/data"))


def test_a_hover_at_100_hz_is_learnable():
    verdict = judge(HOVER.telemetry())
    assert verdict.learnable and verdict.remedy == ""
    assert "100.0 Hz" in verdict.reason
    figures = verdict.figures
    assert figures.attitude_rate == pytest.approx(100) and figures.motor_rate == pytest.approx(100)
    assert figures.input_sd == pytest.approx(HOVER.command / np.sqrt(2), rel=0.02)
    assert figures.consistency == pytest.approx(1, abs=1e-3)
    assert figures.armed == pytest.approx(HOVER.landed + 1 - 5, abs=1.0)
    assert figures.airborne == pytest.approx(HOVER.landed - 6, abs=2.0)


def test_a_verdict_is_plain_json():
    for telemetry in (HOVER.telemetry(), HOVER.telemetry(4.0, 4.0), HOVER.telemetry(vehicle="GROUND_ROVER")):
        verdict = judge(telemetry)
        assert json.loads(json.dumps(dataclasses.asdict(verdict), allow_nan=False))["reason"] == verdict.reason


@pytest.mark.parametrize(
    ("attitude", "motors", "named"),
    [(4.0, 4.0, "4.0 Hz"), (100.0, 10.0, "SERVO_OUTPUT_RAW"), (15.0, 100.0, "ATTITUDE")],
)
def test_slow_telemetry_is_refused_with_its_rate_and_the_command(attitude, motors, named):
    verdict = judge(HOVER.telemetry(attitude, motors))
    assert not verdict.learnable
    assert named in verdict.reason
    assert "EXTRA1" in verdict.remedy and "RC_CHAN" in verdict.remedy


@pytest.mark.parametrize(
    ("autopilot", "named"),
    [
        (
            "PX4",
            ("mavlink stream -d DEVICE -s ATTITUDE -r 100", "mavlink stream -d DEVICE -s SERVO_OUTPUT_RAW_0 -r 100"),
        ),
        ("ARDUPILOTMEGA", ("long SET_MESSAGE_INTERVAL 30 10000", "long SET_MESSAGE_INTERVAL 36 10000")),
        ("INVALID", ("30 (ATTITUDE)", "36 (SERVO_OUTPUT_RAW)", "10000 µs")),
    ],
)
def test_the_remedy_speaks_the_autopilots_language(autopilot, named):
    remedy = judge(HOVER.telemetry(4.0, 4.0, autopilot=autopilot)).remedy
    assert all(words in remedy for words in named)


def test_a_remedy_names_no_command_that_is_not_there():
    for autopilot in ("PX4", "ARDUPILOTMEGA", "INVALID"):
        remedy = judge(HOVER.telemetry(4.0, 4.0, autopilot=autopilot)).remedy
        assert remedy and set(re.findall(r"`mavdem (\w+)", remedy)) <= set(mavdem.commands)


def test_fifty_hz_with_a_tenth_lost_is_enough():
    lossy = np.sort(np.random.default_rng(1).permutation(HOVER.stamps(50.0))[: round(HOVER.end * 45)])
    assert judge(HOVER.telemetry(lossy, HOVER.stamps(50.0))).figures.attitude_rate == pytest.approx(45, abs=2)
    assert judge(HOVER.telemetry(lossy, HOVER.stamps(50.0))).learnable


def refused_for(telemetry: Telemetry) -> str:
    verdict = judge(telemetry)
    assert not verdict.learnable and verdict.remedy
    return verdict.reason


def test_a_disarmed_log_is_refused():
    telemetry = HOVER.telemetry()
    disarmed = changed(telemetry, "HEARTBEAT", base_mode=np.ones(len(HOVER.stamps(1.0))))
    assert "never armed" in refused_for(disarmed)


def test_a_vehicle_that_stays_on_the_ground_is_refused():
    telemetry = HOVER.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    idle = {f"servo{n}_raw": np.where(table[f"servo{n}_raw"] > 1000, 1100 + n, 1000) for n in (1, 2, 3, 4)}
    assert "never left the ground" in refused_for(changed(telemetry, "SERVO_OUTPUT_RAW", **idle))


@pytest.mark.parametrize("missing", ["ATTITUDE", "SERVO_OUTPUT_RAW"])
def test_a_missing_message_is_refused(missing):
    reason = refused_for(HOVER.telemetry(without=(missing,)))
    assert ("ATTITUDE" if missing == "ATTITUDE" else "motor outputs") in reason


def test_a_short_flight_is_refused():
    short = Hover(hovering=4.0)
    assert "of the 5 s needed" in refused_for(short.telemetry())
    assert judge(Hover(hovering=15.0).telemetry()).learnable


@pytest.mark.parametrize("vehicle", ["GROUND_ROVER", "SUBMARINE", "FIXED_WING"])
def test_other_vehicles_are_refused_by_name(vehicle):
    assert vehicle in refused_for(HOVER.telemetry(vehicle=vehicle))


def test_an_aliased_vibration_is_refused():
    """97 Hz sampled at 100 Hz looks like a slow oscillation of the rate that the angle does not follow."""
    telemetry = HOVER.telemetry()
    time = telemetry.messages["ATTITUDE"]["time"]
    shaking = telemetry.messages["ATTITUDE"]["rollspeed"] + 1.0 * np.sin(2 * np.pi * 97 * time)
    reason = refused_for(changed(telemetry, "ATTITUDE", rollspeed=shaking))
    assert "contradict" in reason


def rounded(hover: Hover) -> Telemetry:
    telemetry = hover.telemetry()
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    noise = np.random.default_rng(2).normal(0, 3, len(table["time"]))
    whole = {f"servo{n + 1}_raw": np.round(table[f"servo{n + 1}_raw"] + noise) for n in range(4)}
    return changed(telemetry, "SERVO_OUTPUT_RAW", **whole)


def test_a_command_near_the_floor_of_the_stream_is_doubted_and_at_the_floor_refused():
    doubted = judge(rounded(Hover(command=0.5)))
    assert doubted.learnable
    assert any("resolution of the stream" in caution for caution in doubted.cautions)
    truth = (0.5**2 / 2) / (1 / 12 * np.sum(X_QUAD**2) / 16)
    assert doubted.figures.input_snr == pytest.approx(truth, rel=0.3)
    assert "rounding" in refused_for(rounded(Hover(command=0.1)))
    assert not any("resolution" in caution for caution in judge(rounded(HOVER)).cautions)


def test_assumptions_and_limits_are_cautions():
    telemetry = HOVER.telemetry()
    assert any("assumed" in caution for caution in judge(telemetry).cautions)
    table = telemetry.messages["SERVO_OUTPUT_RAW"]
    full = {"servo1_raw": np.where(np.sin(table["time"]) > 0, 2000.0, table["servo1_raw"])}
    verdict = judge(changed(telemetry, "SERVO_OUTPUT_RAW", **full))
    assert verdict.figures.saturation == pytest.approx(0.5, abs=0.1)
    assert any("limit" in caution for caution in verdict.cautions)


@pytest.mark.parametrize("seed", range(40))
def test_mutilated_telemetry_is_judged_and_its_segments_align(seed):
    """Whatever is missing, shuffled, repeated or not a number, there is a verdict, and every segment makes a Flight."""
    random = np.random.default_rng(seed)
    telemetry = Hover(hovering=random.uniform(0, 20)).telemetry(*random.choice([1.0, 4.0, 50.0, 100.0], 2))
    for message, table in telemetry.messages.items():
        rows = len(table["time"])
        kept = random.permutation(rows)[: random.choice([0, 1, 2, rows // 3, rows, rows, rows])]
        columns = {name: column[kept].copy() for name, column in table.items()}
        if message != "HEARTBEAT" and len(kept):
            hit = random.choice([name for name in columns if name not in ("boot", "port")])
            columns[hit][: rows // 20] = random.choice([np.nan, np.inf, 0.0, -1e6])
            columns["boot"] = np.int64(np.nan_to_num(columns["time"]) > random.uniform(0, 60))
        telemetry = changed(telemetry, message, **columns)
    verdict = judge(telemetry)
    assert verdict.learnable == (verdict.remedy == "")
    for segment in segments(telemetry):
        assert len(align(telemetry, segment)) >= 1


def test_one_vehicle_is_chosen_and_several_are_listed():
    first, second = HOVER.telemetry(), dataclasses.replace(HOVER.telemetry(), system=7)
    silent = dataclasses.replace(first, system=9, messages={})
    assert choose_vehicle((first, silent)) is first
    assert choose_vehicle((first, second), "7") is second
    assert choose_vehicle((first, second), "1:1") is first
    with pytest.raises(NotLearnable, match="1:1 .*7:1 .*--vehicle"):
        choose_vehicle((first, second))
    with pytest.raises(NotLearnable, match="no vehicle 3"):
        choose_vehicle((first, second), "3")
    with pytest.raises(NotLearnable, match="no vehicle"):
        choose_vehicle(())


def shared(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"{name} is not on this machine")
    return DATA / name


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("samples/ardupilot_default_rates.tlog", "4.0 Hz"),
        ("sitl_ardupilot/ardupilot_wind5_defaultrate_mavproxy.tlog", "4.0 Hz"),
        ("logs/wlichon_baseline.tlog", "4.0 Hz"),
        ("logs/dronekit_flight.tlog", "Hz"),
        ("logs/lucagemma_crlf.tlog", "Hz"),
        ("logs/bluerobotics_00025.tlog", "SUBMARINE"),
        ("sitl_px4/px4_two_vehicles_gcslink.tlog", "several vehicles"),
    ],
)
def test_recorded_logs_that_must_be_refused(name, said):
    with pytest.raises(NotLearnable, match=said) as refusal:
        read_flight(shared(name))
    assert refusal.value.remedy


@pytest.mark.parametrize("system", ["2", "3"])
def test_either_of_two_vehicles_can_be_asked_for(system):
    flight = read_flight(shared("sitl_px4/px4_two_vehicles_gcslink.tlog"), vehicle=system)
    assert flight.provenance["system"] == int(system)
    assert flight.dt == 0.02


@pytest.mark.parametrize("axis", ["roll", "pitch"])
@pytest.mark.parametrize("name", ["ardupilot_wind5_steps", "px4_wind5_steps"])
def test_the_samples_are_learnable(name, axis):
    flight = read_flight(shared(f"samples/{name}.tlog"), axis=axis)
    assert flight.dt == 0.01 and flight.duration > 55
