"""Flights to learn no model from: limit cycles, a landing nobody noticed, motors at a stop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavdem.export.conversion import STREAMS
from mavdem.ingest import read_log
from sitl_scenarios.dynamics import IDLE_COMMAND, pulse
from sitl_scenarios.files import load, scenario_of
from sitl_scenarios.mavlink.transmitter import recorded
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation, fly


def brief(name: str, duration: float, **vehicle: object) -> Scenario:
    values = load(name).model_dump(mode="json")
    return scenario_of(values | {"duration": duration, "vehicle": values["vehicle"] | vehicle})


def share_of_line(motion: Motion) -> tuple[float, float]:
    """Of the roll rate's variance in the hover, within a tenth of the frequency of its highest peak; and that, Hz."""
    hover = (motion.landed_state == 2) & (motion.time > 12)
    power = np.abs(np.fft.rfft(motion.rates[hover, 0] - motion.rates[hover, 0].mean())) ** 2
    frequency = np.fft.rfftfreq(hover.sum(), motion.time[1] - motion.time[0])
    peak = frequency[power.argmax()]
    return power[np.abs(frequency - peak) < peak / 10].sum() / power.sum(), peak


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "hertz", "sound"),
    [("oscillating_frame", 6.6, {"mixer": "x"}), ("oscillating_gains", 17.1, {"rate_gain": 1.0})],
)
def test_a_wrong_frame_and_high_gains_make_a_limit_cycle_in_the_air(name, hertz, sound):
    scenario = brief(name, 30.0)
    motion, flown_well = fly(scenario), fly(brief(name, 30.0, **sound))
    share, peak = share_of_line(motion)
    assert share > 0.6 and peak == pytest.approx(hertz, rel=0.05)
    assert share_of_line(flown_well)[1] < 2
    hover = (motion.landed_state == 2) & (motion.time > 12)
    at_a_stop = (motion.outputs >= 2000) | (motion.outputs <= pulse(IDLE_COMMAND))
    assert at_a_stop[hover].any(axis=1).mean() > 0.3
    assert np.abs(motion.position[hover, 2] + scenario.height).max() < 3
    assert not np.any((flown_well.outputs >= 2000) & (flown_well.landed_state == 2)[:, None])


def logged(scenario: Scenario, folder: Path) -> tuple[Motion, dict[str, dict[str, np.ndarray]], dict[str, float]]:
    motion = fly(scenario)
    with (folder / "flight.tlog").open("wb") as file:
        STREAMS[".tlog"](file, recorded(scenario, motion, Simulation(scenario).cycle, lambda _: None))
    vehicle = read_log(folder / "flight.tlog").vehicles[0]
    return motion, vehicle.messages, vehicle.parameters


@pytest.mark.slow
def test_a_landing_that_nobody_noticed_is_on_the_ground_and_in_no_message(tmp_path):
    scenario = brief("landing_unnoticed", 60.0)
    motion, messages, _ = logged(scenario, tmp_path)
    idles = motion.armed & (motion.landed_state == 1) & (motion.time > 10)
    assert motion.time[idles][-1] - motion.time[idles][0] == pytest.approx(scenario.idle + 2, abs=1)
    assert (motion.position[idles, 2] == 0).all() and (motion.outputs[idles] == pulse(scenario.idle_share)).all()
    beat = messages["HEARTBEAT"]
    flown = (beat["time"] > motion.time[motion.armed][0] + 2) & (beat["time"] < motion.time[motion.armed][-1] - 1)
    assert len(set(zip(beat["custom_mode"][flown], beat["system_status"][flown], strict=True))) == 1
    assert not {"EXTENDED_SYS_STATE", "LOCAL_POSITION_NED"} & set(messages)
    landing = fly(scenario.model_copy(update={"landing_mode": True}))
    np.testing.assert_array_equal(landing.position, motion.position)


@pytest.mark.slow
def test_motors_stop_below_the_pulse_range_as_the_parameter_says(tmp_path):
    motion, messages, parameters = logged(brief("motor_at_its_stop", 30.0), tmp_path)
    assert parameters["MOT_SPIN_MAX"] == pytest.approx(0.64) and parameters["MOT_PWM_MAX"] == 2000
    hover = motion.landed_state == 2
    at_stop = (motion.outputs[hover] == pulse(0.64)).mean(axis=0)
    assert at_stop[0] > 0.3 and at_stop[1:].max() < 0.1
    assert motion.outputs.max() == pulse(0.64) == messages["SERVO_OUTPUT_RAW"]["servo1_raw"].max()


@pytest.mark.slow
def test_parameters_say_what_the_autopilot_takes_the_frame_for(tmp_path):
    _, _, parameters = logged(brief("oscillating_frame", 20.0), tmp_path)
    assert parameters["FRAME_TYPE"] == 0
