"""Rotor noise and a frame's resonance: at known frequencies, found in the log, and taken by the notch advised."""

import numpy as np
from pytest import approx, mark
from scipy.signal import periodogram, welch

from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.experiments.paper.flights import write_log
from mavdem.facts.noise import NotchAdvice
from mavdem.ingest import read_log
from mavdem.loops.controllers import controller_from_parameters
from mavdem.vibration.notch_filters import notch_advice
from mavdem.vibration.spectra import vibration_spectra
from mavdem.vibration.spectral_lines import LineCause, find_spectral_lines
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.sensors import GyroVibration
from sitl_scenarios.simulation import simulation_of
from sitl_scenarios.truth import truth
from sitl_scenarios.vehicles import airframe

MOVES = [{"up": 3.0, "speed": 3.0}, {"up": -3.0, "speed": 3.0}]
LOOP_RATE = 600.0
"""Of the controller and of the logged gyro, Hz: more than twice that at which blades pass in hover."""
FLOWN_SECONDS = 16.0
"""What is flown of the scenario, s from boot: the landing is of no use here."""
SHAKING = {"gyro": 0.05, "frame": 75.0, "frame_gyro": 0.02}


def flight(shaking, **parameters):
    return scenario_from_table(
        {
            "seed": 3,
            "duration": 24.5,
            "height": 4.0,
            "vehicle": {
                "parameters": {"SCHED_LOOP_RATE": LOOP_RATE, "INS_GYRO_FILTER": 80.0, **parameters}
            },
            "shaking": shaking,
            "excitation": {"kind": "course", "moves": MOVES},
            "stream": {
                "autopilot": "ardupilot",
                "rate": 100.0,
                "rates": {"HIGHRES_IMU": LOOP_RATE},
            },
        }
    )


def beginning(scenario):
    """The motion of a scenario until ``FLOWN_SECONDS``."""
    return simulation_of(scenario).advance(round(FLOWN_SECONDS * LOOP_RATE))


def test_rotors_shake_once_a_turn_and_once_a_blade_and_the_frame_at_its_frequency():
    scenario = flight(SHAKING)
    noise = GyroVibration(scenario, 1e-3)
    speed = airframe(scenario.vehicle).hover_speed
    felt = np.array([noise.sample((speed,) * 4) for _ in range(8000)])
    first, second = felt[:, :2].T
    apart = first - second
    hertz, (power, of_frame) = periodogram([first, apart], 1e3, "hann")
    for multiple in (1, 2):
        near = abs(hertz - multiple * speed / (2 * np.pi)) < 3
        assert power[near].max() > 400 * np.median(power)
    # What the axes have apart is the frame's.
    assert np.std(apart) == approx(2**0.5 * 0.02, rel=0.2)
    assert hertz[np.argmax(of_frame)] == approx(75.0, rel=0.05)
    assert GyroVibration(flight({}), 1e-3).sample((speed,) * 4) == (0.0, 0.0, 0.0)


@mark.slow
def test_the_notch_that_is_advised_takes_the_motors_line_when_flown_again(tmp_path):
    scenario = flight(SHAKING)
    motion = beginning(scenario)
    write_log(tmp_path / "flight.tlog", scenario, motion)
    signals = Signals(read_log(tmp_path / "flight.tlog").vehicles[0])
    spectra = vibration_spectra(signals, (Segment(0, 8.0, FLOWN_SECONDS),))
    lines = find_spectral_lines(spectra["gyro_before"])
    flown = motion.time > 8
    turns = float(np.median(motion.rotor_speeds[flown].mean(axis=1))) / (2 * np.pi)
    by_cause = {line.cause: line for line in lines}
    assert by_cause[LineCause.MOTOR].frequency == approx(turns, rel=0.02)
    assert by_cause[LineCause.MOTOR].harmonics == (1, 2)
    assert by_cause[LineCause.FRAME].frequency == approx(75.0, rel=0.02)
    controller = controller_from_parameters(signals.telemetry.parameters, "roll", (1.0,))
    known = truth(scenario, motion)
    crossover = float(known["roll_rate_margins"][0])
    fact = notch_advice(controller, lines, spectra["gyro_before"], spectra.get("gyro"), crossover)
    assert fact.code is NotchAdvice.SET_NOTCH
    again = flight(SHAKING, **dict(fact.figures["settings"]))
    other = beginning(again)
    rates = np.array([one.known_rates[flown, 0] for one in (motion, other)])
    hertz, power = welch(rates, LOOP_RATE, nperseg=1024)
    left = power[:, abs(hertz - turns) < 10].sum(axis=1)
    assert left[1] < 0.2 * left[0]
    assert 0.8 < fact.figures["share"] < 1 - left[1] / left[0]
    # The margin of the true loop falls by the cost, at the crossover of before.
    after = truth(again, other)
    here = int(np.argmin(abs(known["loop_frequency"] - crossover)))
    lost = np.angle(known["roll_rate_loop"][here] / after["roll_rate_loop"][here], deg=True)
    assert fact.figures["phase_cost"] == approx(lost, abs=2.0)
    assert after["roll_rate_margins"][1] < known["roll_rate_margins"][1]
