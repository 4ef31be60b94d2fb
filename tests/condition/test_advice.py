"""Advice: gains with which plants that fit the flight have the margins, by steps that are bounded; and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from mavdem.condition.loop import TARGETS, advise, loop_of
from mavdem.condition.loop.loop import transfer
from mavdem.dem.graybox import Physical
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable

GAINS = {
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLLRATE_I": 0.2,
    "MC_ROLLRATE_D": 0.003,
    "MC_ROLL_P": 6.5,
    "IMU_DGYRO_CUTOFF": 30.0,
}
OTHERS = {"CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 4, "THR_MDL_FAC": 0, "IMU_GYRO_RATEMAX": 400}
PLACES = zip((0.1, -0.1, 0.1, -0.1), (0.1, -0.1, -0.1, 0.1), (0.05, 0.05, -0.05, -0.05), strict=True)
OTHERS |= {
    f"CA_ROTOR{n}_{key}": one for n, at in enumerate(PLACES) for key, one in zip(("PX", "PY", "KM"), at, strict=True)
}
UP = np.array([-1.0, 1.0, 1.0, -1.0])


def loop(factor=1.0, effect=0.12, sd=0.05, **changed):
    """Of made-up flight and plant, with gains ``factor`` times the usual ones."""
    rng = np.random.default_rng(3)
    rate = rng.normal(0, 0.01, 2000)
    known = {name: value * (factor if "RATE_" in name else 1.0) for name, value in GAINS.items()} | OTHERS
    outputs, names = np.column_stack([rate.cumsum() * 0.005, rate]), ("roll", "roll rate")
    inputs = 1500 + rng.normal(0, 5, (2000, 1)) * UP
    record = Record(inputs, outputs, 0.005, (2000,), output_names=names, parameters=known, input_range=(1000.0, 2000.0))
    status = dict.fromkeys(("effect", "damping", "lag"), "reported")
    covariance = np.diag([*np.full(4, (sd * effect) ** 2), 0.3**2, 0.002**2, 0.002**2])
    plant = Physical(
        effect * UP, 1.5, 0.03, 0.006, covariance, status, dict.fromkeys(status, ""), 0.0, 1.0, 0.1, (), 0.01, {}, ()
    )
    return loop_of(plant._replace(**changed), record)


@pytest.mark.parametrize(("factor", "tune"), [(0.5, "soft"), (1.0, "sharp"), (1.4, "default"), (2.5, "default")])
def test_the_gains_have_the_margins_in_95_of_100_plants_that_fit_and_keep_their_proportions(factor, tune):
    found, target = advise(before := loop(factor), tune), TARGETS[tune]
    frequency = np.geomspace(0.05, 90, 2000)
    s, (_, back) = 2j * np.pi * frequency, transfer(found.after.controller, frequency)
    have = []
    for gain, (damping, lag, delay) in zip(before.gains[1:], before.draws[1:], strict=True):
        open_loop = back * gain * np.exp(-s * delay) / (s + damping) / (lag * s + 1)
        crossing = np.flatnonzero(np.diff(np.sign(np.abs(open_loop) - 1)))
        phase = np.degrees(np.unwrap(np.angle(open_loop)))
        turning = np.flatnonzero(np.diff(np.sign(phase + 180)))
        bears = -20 * np.log10(np.abs(open_loop[turning])).max(initial=-60)
        margins = (phase[crossing] + 180).min() + 0.1, bears + 0.02, np.abs(1 / (1 + open_loop)).max() * 0.999
        have.append(margins[0] >= target[0] and margins[1] >= target[1] and margins[2] <= target[2])
    assert (found.sure >= 0.95) == (np.mean(have) >= 0.95) == (factor < 2)
    ratios = [new / old for name, (old, new) in found.gains.items() if "RATE_" in name]
    assert len(ratios) == 3 and np.ptp(ratios) < 2e-3
    assert all(1 / 1.5 <= new / old <= 1.5 for old, new in found.gains.values())
    # On a rate loop without margin nothing is added, and less than all is said to be a step.
    assert factor < 2 or (max(ratios) < 0.67 and found.gains["MC_ROLL_P"][1] <= 6.5 and "step" in found.sentence)


def test_noise_grows_as_the_gains_do_and_sharper_tunes_are_faster():
    soft, sharp = (advise(loop(), tune) for tune in ("soft", "sharp"))
    assert soft.after.crossover < sharp.after.crossover and soft.after.ms < sharp.after.ms
    grown = sharp.gains["MC_ROLLRATE_P"][1] / GAINS["MC_ROLLRATE_P"]
    assert sharp.noise.heat == pytest.approx(grown**2, rel=1e-3) and 0 < sharp.noise.by_d < sharp.noise.before


def test_refusals_are_sentences():
    sound = loop()
    stuck = replace(sound.record, inputs=np.where(np.arange(2000)[:, None] % 10 == 0, 2000.0, sound.record.inputs))
    refused = {
        "Oscillates at 3 Hz.": (sound, ["Oscillates at 3 Hz."]),
        "A motor is at a limit 10 % of the time": (replace(sound, record=stuck), []),
        "unstable, and yet it flew": (loop(6.0), []),
    }
    for words, (one, doubts) in refused.items():
        found = advise(one, doubts=doubts)
        assert found.sentence.startswith("No gains are advised. ") and words in found.sentence
        assert not found.gains and not found.parameters and found.as_dict()["expected"] is None
    unknown = sound.plant._replace(status=dict.fromkeys(sound.plant.status, "not identifiable"))
    with pytest.raises(NotLearnable, match="There are no margins: the motors' effect is not"):
        loop_of(unknown, sound.record)
