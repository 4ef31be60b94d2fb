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
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import truth
from sitl_scenarios.vehicles import airframe

pytestmark = mark.slow

MOVES = [{"up": 3.0, "speed": 3.0}, {"up": -3.0, "speed": 3.0}]
LOOP_RATE = 600.0
"""Of the controller and of the logged gyro, Hz: more than twice that at which blades pass in hover."""
FLOWN_SECONDS = 16.0
"""What is flown of the scenario, s from boot: the landing is of no use here."""
SHAKING = {"gyro": 0.05, "frame": 75.0, "frame_gyro": 0.02}


def flight(shaking, **parameters):
    """Returns a scenario whose vehicle is shaken and steered, with fast IMU messages and the given parameters."""
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
    """The motion of a scenario until ``FLOWN_SECONDS``, of the whole flight, which is stored."""
    return fly(scenario)[: round(FLOWN_SECONDS * LOOP_RATE)]


def test_rotors_shake_once_a_turn_and_once_a_blade_and_the_frame_at_its_frequency():
    """The simulated gyro has lines at the rotor speed, at twice that, and at the frequency of the frame, 75 Hz."""
    scenario = flight(SHAKING)
    noise = GyroVibration(scenario, 1e-3)
    speed = airframe(scenario.vehicle).hover_speed
    vibration = np.array([noise.sample((speed,) * 4) for _ in range(8000)])
    first, second = vibration[:, :2].T
    difference = first - second
    hertz, (power, frame_power) = periodogram([first, difference], 1e3, "hann")
    for multiple in (1, 2):
        near = abs(hertz - multiple * speed / (2 * np.pi)) < 3
        assert power[near].max() > 400 * np.median(power)
    # What the axes have apart is the frame's.
    assert np.std(difference) == approx(2**0.5 * 0.02, rel=0.2)
    assert hertz[np.argmax(frame_power)] == approx(75.0, rel=0.05)
    assert GyroVibration(flight({}), 1e-3).sample((speed,) * 4) == (0.0, 0.0, 0.0)


@mark.in_full
def test_the_notch_that_is_advised_takes_the_motors_line_when_flown_again(tmp_path):
    """The same flight is simulated with and without the advised notch filter.

    Its line and its phase cost are compared.
    """
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
    truth_before = truth(scenario, motion)
    crossover = float(truth_before["roll_rate_margins"][0])
    fact = notch_advice(controller, lines, spectra["gyro_before"], spectra.get("gyro"), crossover)
    assert fact.code is NotchAdvice.SET_NOTCH
    scenario_with_notch = flight(SHAKING, **dict(fact.figures["settings"]))
    motion_with_notch = beginning(scenario_with_notch)
    rates = np.array([one.known_rates[flown, 0] for one in (motion, motion_with_notch)])
    hertz, power = welch(rates, LOOP_RATE, nperseg=1024)
    power_near_line = power[:, abs(hertz - turns) < 10].sum(axis=1)
    assert power_near_line[1] < 0.2 * power_near_line[0]
    assert 0.8 < fact.figures["share"] < 1 - power_near_line[1] / power_near_line[0]
    # The margin of the true loop falls by the cost, at the crossover of before.
    truth_after = truth(scenario_with_notch, motion_with_notch)
    crossover_index = int(np.argmin(abs(truth_before["loop_frequency"] - crossover)))
    phase_loss = np.angle(
        truth_before["roll_rate_loop"][crossover_index]
        / truth_after["roll_rate_loop"][crossover_index],
        deg=True,
    )
    assert fact.figures["phase_cost"] == approx(phase_loss, abs=2.0)
    assert truth_after["roll_rate_margins"][1] < truth_before["roll_rate_margins"][1]
