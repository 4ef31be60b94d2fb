"""Small systems in smooth noise that test the engine: one state that decays, and a stabilised roll angle."""

from __future__ import annotations

import numpy as np
from joint_gaussian import ParameterPrior, System
from numpy.typing import NDArray

Array = NDArray[np.float64]

DT = 0.1  # seconds; both systems respond within about one second
KINEMATIC_NOISE = 0.03  # of the relation that makes the rate the derivative of the roll angle, rad/s


def decay(
    smoothness: float, output_noise: float, *, gain: float = 0.0, process_noise: float = 1.0, samples: int = 90
) -> System:
    """ẋ = −x + gain·u + w, y = x + z, with the rate of decay free, and the gain too where there is one."""
    return System(
        A=np.array([[-1.0]]),
        B=np.array([[gain]]),
        C=np.eye(1),
        state_noise=np.array([process_noise]),
        output_noise=np.array([output_noise]),
        smoothness=smoothness * DT,
        dt=DT,
        samples=samples,
        lead=40,
        start_sd=np.array([1.0]),
        inputs=doublets,
        free=np.arange(2 if gain else 1),
    )


def roll(smoothness: float, output_noise: float, *, outputs: int = 2, process_noise: float = 3.0) -> System:
    """φ̇ = rate; the rate has stiffness, damping and gain, which are free, and noise; one output is the angle alone."""
    return System(
        A=np.array([[0.0, 1.0], [-4.0, -1.2]]),
        B=np.array([[0.0], [4.0]]),
        C=np.eye(outputs, 2),
        state_noise=np.array([KINEMATIC_NOISE, process_noise]),
        output_noise=np.full(outputs, output_noise),
        smoothness=smoothness * DT,
        dt=DT,
        samples=90,
        lead=40,
        start_sd=np.array([1.0, 2.0]),
        inputs=doublets,
        free=np.array([2, 3, 5]),
    )


def doublets(times: Array) -> Array:
    """A smooth input that varies within seconds, (k, 1)."""
    return (np.sin(1.3 * times) + np.sin(0.5 * times + 1))[:, None]


def weak_prior(system: System) -> ParameterPrior:
    """About half the true parameters, and far wider than the posterior of a series."""
    truth = system.theta[system.free]
    return ParameterPrior(truth / 2, np.eye(len(truth)) / 9)
