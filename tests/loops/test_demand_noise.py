"""Noise of the gyro in the demand: what is assumed of it where the log is too slow to show it."""

from dataclasses import replace

import numpy as np
from made_up_loop import made_up
from pytest import mark

from mavdem.loops.demand_noise import demand_deviation, gyro_noise

pytestmark = mark.slow


def of_slow_log(loop):
    """The loop of a log of 50 samples a second, with a controller that runs 50 times a second."""
    controller = replace(loop.controller, loop_period=0.02)
    return replace(loop, controller=controller, record=replace(loop.record, dt=0.02))


@mark.parametrize("factor", [1.0, 2.0, 4.0])
def test_a_loop_with_a_high_crossover_has_a_bound_of_its_noise(factor):
    loop = of_slow_log(made_up(factor))
    noise = gyro_noise(loop)
    assert not noise.is_measured
    assert np.all(np.diff(noise.frequency) > 0)
    assert demand_deviation(loop.controller, noise) > 0


def test_a_loop_without_a_crossover_has_a_bound_of_its_noise():
    loop = made_up(1e-5)
    assert np.isnan(loop.rate.crossover)
    assert demand_deviation(loop.controller, gyro_noise(loop)) > 0
