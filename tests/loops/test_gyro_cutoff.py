"""A higher cut-off of the gyro's filter is advised where its phase lag takes the margin and the noise allows it."""

from dataclasses import replace

import numpy as np
from made_up_loop import made_up
from pytest import approx, mark

from mavdem.facts import Fact
from mavdem.facts.loops import GainFact, LoopFact
from mavdem.loops.advice import advise
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.demand_noise import DemandNoise, GyroNoise
from mavdem.loops.gyro_cutoff import MAX_DEMAND_NOISE, gyro_cutoff_advice
from mavdem.loops.gyro_filter_lag import gyro_filter_lag, phase_lags


def advised_with_noise(monkeypatch, loop, noise):
    """Returns the advice for a loop whose demand has so much noise of the gyro."""
    measured = None if noise is None else DemandNoise(30.0, 80.0, noise, noise, 0.0, 1.0)
    monkeypatch.setattr("mavdem.loops.gyro_cutoff.demand_noise", lambda *_: measured)
    return gyro_cutoff_advice([loop], MARGIN_TARGETS["default"])


@mark.parametrize(
    "cutoff, noise, is_advised",
    [
        (15.0, 1e-4, True),
        # Twice the cut-off may pass four times the noise.
        (15.0, 0.3 * MAX_DEMAND_NOISE, False),
        (15.0, None, False),
        # The filter costs little phase.
        (80.0, 1e-4, False),
    ],
)
def test_the_cut_off_is_raised_if_it_takes_the_margin_and_noise_allows_it(
    monkeypatch, cutoff, noise, is_advised
):
    loop = made_up().with_parameters({"IMU_GYRO_CUTOFF": cutoff})
    loop = replace(loop, plant=loop.plant._replace(filtered=False))
    advice = advised_with_noise(monkeypatch, loop, noise)
    assert (advice is not None) == is_advised
    if advice is not None:
        assert advice.code is GainFact.GYRO_CUTOFF_LOW
        assert advice.figures["changes"] == (("IMU_GYRO_CUTOFF", 15.0, 30.0),)
        assert advice.figures["noise"] == approx(4e-4)
        assert advice.figures["new_phase_lag"] < 0.6 * advice.figures["phase_lag"]
        assert "IMU_GYRO_CUTOFF at 15 Hz costs" in advice.sentence
        assert advice.remedy.startswith("Fly the lower gains first:")
        assert "Then set the old gains with IMU_GYRO_CUTOFF 30," in advice.remedy


@mark.parametrize("cutoff, is_cause", [(8.0, True), (80.0, False)])
def test_the_filter_that_takes_most_of_the_phase_is_named_as_the_cause(cutoff, is_cause):
    loop = made_up().with_parameters({"IMU_GYRO_CUTOFF": cutoff})
    loop = replace(loop, plant=loop.plant._replace(filtered=False))
    crossover = loop.rate.crossover
    lags = phase_lags(loop, crossover)
    assert lags.motors == approx(np.degrees(np.arctan(2 * np.pi * crossover * 0.03)), rel=0.1)
    assert lags.delay == approx(360 * crossover * 0.006, rel=0.5)
    assert lags.is_mostly_of_low_pass is is_cause
    advice = advise(loop, doubts=[Fact(LoopFact.NOT_STEERED, share=0.3)])
    noise = GyroNoise(np.linspace(60.0, 120.0), np.full(50, 1e-6), is_measured=True)
    finding = gyro_filter_lag([advice], {"roll": noise})
    assert (finding is not None) == is_cause
    if finding is None:
        return
    figures = finding.figures
    assert figures["changes"] == (("IMU_GYRO_CUTOFF", 8.0, 16.0),)
    assert figures["expected"].figures["phase_margin"] > figures["rating"].figures["phase_margin"]
    # Well above both cut-offs twice the cut-off passes up to four times as much.
    assert 3.0 < figures["new_noise"] / figures["noise"] < 4.0
    assert "IMU_GYRO_CUTOFF 8 Hz takes" in finding.sentence
    assert "the new ones" not in finding.sentence
    unknown_noise = gyro_filter_lag([advice], {})
    assert "does not show how much" in unknown_noise.sentence
