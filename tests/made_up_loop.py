"""A roll loop of made-up flight and plant, whose gains are those of PX4 times a factor."""

from functools import cache

import numpy as np
from known_gains import PX4, X_ROLL
from numpy.random import default_rng

from mavdem.dem.record import Record
from mavdem.facts.identifiability import Status
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.plant import Physical
from mavdem.plant.sampled_plant import WindComponent, gaussian_kernel_noise

WIND = WindComponent(gaussian_kernel_noise(3), 1.0, 0.2)
"""A wind torque of smooth gusts."""


@cache
def made_up(factor=1.0):
    """Returns a loop of a made-up flight and plant, with ``factor`` times the usual gains of the rate controller.

    Loops cannot be changed, so that all tests of a process share each of them, and the margins that it has computed.
    """
    rng = default_rng(3)
    status = dict.fromkeys(("effect", "damping", "lag"), Status.REPORTED)
    rate = rng.normal(0, 0.01, 2000)
    inputs = 1500 + rng.normal(0, 5, (2000, 1)) * X_ROLL
    outputs = np.column_stack([rate.cumsum() * 0.005, rate])
    names = ("roll", "roll rate")
    options = {"parameters": PX4 | {"MC_ROLLRATE_K": factor}, "input_range": (1000.0, 2000.0)}
    record = Record(inputs, outputs, 0.005, (2000,), output_names=names, **options)
    covariance = np.diag([*4 * [9e-5], 0.09, 4e-6, 4e-6])
    sizes = 0.18 * np.array(X_ROLL), 1.5, 0.03, 0.006, covariance
    results = status, dict.fromkeys(status, ""), 0, 0.1, (WIND,), 0.01, {}, ()
    return loop_from_plant(Physical(*sizes, *results), record)
