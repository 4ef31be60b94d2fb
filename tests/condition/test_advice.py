"""Advice: gains with which plants that fit the flight have the margins, by steps that are bounded; and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from mavdem.condition.loop import TARGETS, advise, loop_of
from mavdem.condition.loop.loop import transfer
from mavdem.dem.graybox import Physical
from mavdem.dem.record import Record

GAINS = {
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLLRATE_I": 0.2,
    "MC_ROLLRATE_D": 0.003,
    "MC_ROLL_P": 6.5,
    "IMU_DGYRO_CUTOFF": 30.0,
}
OTHERS = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 4, "THR_MDL_FAC": 0, "IMU_GYRO_RATEMAX": 400}
for n, place in enumerate(((0.1, 0.1, 0.05), (-0.1, -0.1, 0.05), (0.1, -0.1, -0.05), (-0.1, 0.1, -0.05))):
    OTHERS |= dict(zip((f"CA_ROTOR{n}_PX", f"CA_ROTOR{n}_PY", f"CA_ROTOR{n}_KM"), place, strict=True))
UP, REPORTED = np.array([-1.0, 1.0, 1.0, -1.0]), dict.fromkeys(("effect", "damping", "lag"), "reported")


def loop(factor=1.0):
    """Of made-up flight and plant, with a rate controller of ``factor`` times the usual gains."""
    rng = np.random.default_rng(3)
    rate, inputs = rng.normal(0, 0.01, 2000), 1500 + rng.normal(0, 5, (2000, 1)) * UP
    known = {name: value * (factor if "RATE_" in name else 1.0) for name, value in GAINS.items()} | OTHERS
    outputs, names = np.column_stack([rate.cumsum() * 0.005, rate]), ("roll", "roll rate")
    record = Record(inputs, outputs, 0.005, (2000,), output_names=names, parameters=known, input_range=(1000.0, 2000.0))
    theta, covariance = (0.12 * UP, 1.5, 0.03, 0.006), np.diag([*np.full(4, 4e-5), 0.09, 4e-6, 4e-6])
    return loop_of(
        Physical(*theta, covariance, REPORTED, dict.fromkeys(REPORTED, ""), 0, 1, 0.1, (), 0.01, {}, ()), record
    )


@pytest.mark.parametrize(("factor", "tune"), [(0.5, "soft"), (1.0, "sharp"), (1.4, "default"), (2.5, "default")])
def test_the_gains_have_the_margins_in_95_of_100_plants_that_fit_and_keep_their_proportions(factor, tune):
    found, (least_phase, least_gain, most) = advise(before := loop(factor), tune), TARGETS[tune]
    frequency, have = np.geomspace(0.05, 90, 2000), []
    s, (_, back) = 2j * np.pi * frequency, transfer(found.after.controller, frequency)
    for gain, (damping, lag, delay) in zip(before.gains[1:], before.draws[1:], strict=True):
        open_loop = back * gain * np.exp(-s * delay) / (s + damping) / (lag * s + 1)
        phase = np.degrees(np.unwrap(np.angle(open_loop))) + 180
        crossing, turning = (np.flatnonzero(np.diff(np.sign(one))) for one in (np.abs(open_loop) - 1, phase))
        bears = -20 * np.log10(np.abs(open_loop[turning]).max(initial=1e-3)) + 0.02
        have.append(phase[crossing].min() + 0.1 >= least_phase and bears >= least_gain)
        have[-1] &= np.abs(1 / (1 + open_loop)).max() * 0.999 <= most
    assert (found.sure >= 0.95) == (np.mean(have) >= 0.95) == (factor < 2)
    ratios = [new / old for name, (old, new) in found.gains.items() if "RATE_" in name]
    assert len(ratios) == 3 and np.ptp(ratios) < 2e-3
    assert all(1 / 1.5 <= new / old <= 1.5 for old, new in found.gains.values())
    # On a rate loop without margin nothing is added, and less than all is said to be a step.
    assert factor < 2 or (max(ratios) < 0.67 and found.gains["MC_ROLL_P"][1] <= 6.5 and "step" in found.sentence)
    heat = pytest.approx(ratios[0] ** 2, rel=2e-3)
    assert found.noise is None if factor > 2 else found.noise.heat == heat and 0 < found.noise.by_d < found.noise.before


def test_refusals_are_sentences():
    record = (sound := loop()).record
    inputs = np.where(np.arange(2000)[:, None] % 10 == 0, 2000.0, record.inputs)
    stuck = advise(replace(sound, record=replace(record, inputs=inputs)))
    cases = advise(sound, doubts=["Oscillates at 3 Hz."]), stuck, advise(loop(6.0))
    words = "Oscillates at 3 Hz", "A motor is at a limit 10 % of the time", "unstable, and yet it flew"
    for found, said in zip(cases, words, strict=True):
        assert found.sentence.startswith("No gains are advised. ") and said in found.sentence
        assert not found.gains and not found.parameters and found.as_dict()["expected"] is None
