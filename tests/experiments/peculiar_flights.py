"""Flights that are hard to learn from, and what must hold of every method on them."""

from dataclasses import replace

import numpy as np
from numpy.random import default_rng
from simulated import simulated

from mavdem import Flight


def measured(flight):
    """As sensors and autopilots have it: outputs with noise of a thousandth of their size, motors in whole numbers."""
    noise = 1e-3 * flight.outputs.std(axis=0) * default_rng(0).standard_normal(flight.outputs.shape)
    return replace(flight, inputs=np.round(flight.inputs), outputs=flight.outputs + noise)


FLIGHT = measured(simulated(wind=2.0))
TRAIN = FLIGHT[:700]
TEST = FLIGHT[700:]


def with_inputs(flight, inputs):
    return Flight(flight.time, inputs, flight.outputs)


def in_other_units(flight):
    """Motors in units and from zeros of their own; outputs in degrees from another zero."""
    return Flight(flight.time, flight.inputs * [1, 10, 0.1, 3] - 7, np.degrees(flight.outputs) + 4)


def back_from_other_units(outputs):
    return np.radians(outputs - 4)


NOTHING_NEW = {
    "a constant": lambda u: np.hstack([u, np.full((len(u), 1), 1500.0)]),
    "a combination": lambda u: np.hstack([u, u[:, :2] @ [[1.0], [-2.0]]]),
    "a copy but for rounding": lambda u: np.hstack([u, u[:, :1] + 1e-9 * u[:, 1:2]]),
}
"""Inputs that tell nothing more than those there are."""


def growing():
    """Motion that doubles in a second, under noise."""
    rng = default_rng(0)
    y = np.zeros((700, 1))
    for t in range(1, 700):
        y[t] = 1.007 * y[t - 1] + 0.1 * rng.standard_normal()
    return Flight(0.01 * np.arange(700), rng.standard_normal((700, 1)), y)


def errors_of(forecast, flight):
    """Largest error in units of each output's standard deviation."""
    return float((abs(forecast - flight.outputs) / flight.outputs.std(axis=0)).max())
