#!/usr/bin/env python
"""How often a parameter lies in its 90 % interval, over 200 simulated roll axes; prints a Markdown table.

In the first rows everything is as DEM assumes it: every sample's derivatives are drawn anew, independent of all others,
from the generative model, with parameters drawn from their prior. In the others, sampled flights: motors that turn to
and fro, wind as Gaussian-kernel noise, derivatives read from the samples; parameters are drawn about a vehicle's.
"Own" is DEM's posterior, "corrected" the sandwich estimate of ``mavdem.dem.scatter``.

Usage: tools/engine/calibration.py
"""

from __future__ import annotations

from typing import NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from mavdem.dem.ascent import ascend
from mavdem.dem.coordinates import embed
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.model import discretize, pack, unpack
from mavdem.dem.priors import KNOWN, Prior
from mavdem.dem.recursion import recursion
from mavdem.dem.scatter import certainty_of
from mavdem.dem.smoothness import (
    sampled_output_precision,
    sampled_state_precision,
    temporal_covariance,
    temporal_precision,
)

Array = NDArray[np.float64]

SYSTEMS = 200
LEVEL = 0.9
ITERATIONS = 200
P, Q = 2, 1
"""Embedding orders; the highest derivative's equation is left out, since its left side is not modelled."""

FREE = np.array([2, 3, 5])
"""Places in θ of what is to be learnt: stiffness, damping and gain of the rate's equation."""

VEHICLE, SPREAD = np.array([-9.0, -4.0, 12.0]), np.array([3.0, 1.5, 4.0])
"""Their prior means and standard deviations."""


class Coverage(NamedTuple):
    """Share of parameters inside their interval."""

    own: float
    corrected: float


def theta_of(free: Array) -> Array:
    """θ of a roll axis, φ̇ = rate, with C = I."""
    A, B = np.array([[0.0, 1.0], free[:2]]), np.array([[0.0], free[2:]])
    return pack(A, B, np.eye(2))


def generative_model(
    lambda_z: float, lambda_w: float, output_correlation: Array, state_correlation: Array
) -> GenerativeModel:
    """Everything known but the free parameters; λ to within a standard deviation of 1."""
    precision = KNOWN * np.eye(10)
    precision[FREE, FREE] = SPREAD**-2.0
    # The kinematic relation has no noise to speak of; the rate's equation has the wind.
    lambda_mean = np.array([lambda_z, KINEMATIC, lambda_w])
    lambda_precision = np.diag([KNOWN, KNOWN, 1.0])
    return GenerativeModel(
        n=2,
        r=1,
        m=2,
        p=P,
        d=P,
        q=Q,
        output_correlation=output_correlation,
        state_correlation=state_correlation,
        output_groups=np.array([0, 0]),
        state_groups=np.array([1, 2]),
        input_precision=KNOWN * np.eye(P + 1),
        prior=Prior(theta_of(VEHICLE), precision, lambda_mean, lambda_precision),
    )


KINEMATIC = 16.0
"""ln precision of φ̇ = rate."""


def covered(model: GenerativeModel, data: Array, truth: Array) -> tuple[Array, Array]:
    """Which free parameters lie in DEM's own interval, and in the corrected one."""
    ascent = ascend(model, Samples.of(data), ITERATIONS)
    error = np.abs(ascent.belief.theta - truth)[FREE]
    own = norm.ppf(0.5 + LEVEL / 2) * np.sqrt(ascent.belief.theta_covariance.diagonal())
    scatter = certainty_of(model, [data], ascent).scatter
    corrected = scatter.half_width(LEVEL) if scatter else np.full(len(truth), np.nan)
    return error <= own[FREE], error <= corrected[FREE]


def as_assumed(lambda_z: float, lambda_w: float, samples: int, smoothness: float) -> Coverage:
    """Coverage where every sample is drawn from the generative model by itself."""
    model = generative_model(lambda_z, lambda_w, temporal_precision(P, smoothness), temporal_precision(Q, smoothness))
    inside = []
    for seed in range(SYSTEMS):
        rng = np.random.default_rng(seed)
        truth = theta_of(VEHICLE + SPREAD * rng.standard_normal(3))
        inside.append(covered(model, independent_samples(model, truth, samples, smoothness, rng), truth))
    return Coverage(*np.mean(inside, axis=(0, 2)))


def independent_samples(
    model: GenerativeModel, truth: Array, number: int, smoothness: float, rng: np.random.Generator
) -> Array:
    """[ỹ; η̃] (T, ·): x and ṽ at random, its derivatives by the model with w̃, and z̃ on all of it."""
    A, B, _ = unpack(truth, 2, 1, 2)
    lambda_z, *of_w = model.prior.lambda_mean

    def noise(order: int, sd: Array) -> Array:
        factor = np.linalg.cholesky(temporal_covariance(order, smoothness))
        return np.einsum("ij,tja->tia", factor, rng.standard_normal((number, order + 1, 2))) * sd

    v = rng.standard_normal((number, P + 1))
    w = noise(Q, np.exp(-np.array(of_w) / 2))
    x = [rng.standard_normal((number, 2))]
    for order in range(Q + 1):
        x.append(x[-1] @ A.T + v[:, order, None] * B[:, 0] + w[:, order])
    y = np.stack(x, axis=1) + noise(P, np.full(2, np.exp(-lambda_z / 2)))
    return np.hstack([y.reshape(number, -1), v])


def sampled(ratio: float, wind: float, samples: int = 700, dt: float = 0.01) -> Coverage:
    """Coverage on flights sampled at ``dt``, in wind (rad/s²) of smoothness ``ratio`` steps."""
    smoothness, window = ratio * dt, P + 1
    model = generative_model(
        18.0,
        -2 * float(np.log(wind)),
        sampled_output_precision(P, smoothness, dt, window),
        sampled_state_precision(Q, smoothness, dt, window),
    )
    inside = []
    for seed in range(SYSTEMS):
        rng = np.random.default_rng(seed)
        truth = theta_of(VEHICLE + SPREAD / 3 * rng.standard_normal(3))
        y, u = flight(truth, wind, smoothness, samples, dt, rng)
        data = np.hstack([embed(signal, P, dt, window, window // 2) for signal in (y, u)])
        inside.append(covered(model, data, truth))
    return Coverage(*np.mean(inside, axis=(0, 2)))


def flight(
    truth: Array, wind: float, smoothness: float, samples: int, dt: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Roll and rate (T, 2) and motors (T, 1), simulated at ten times the sampling rate."""
    A, B, _ = unpack(truth, 2, 1, 2)
    fine, before = 10, 300
    step, number = dt / 10, (samples + before) * 10
    motors = coloured(0.15, step, number, rng)
    moment = wind * coloured(smoothness, step, number, rng)
    transition = discretize(A, np.hstack([B, [[0.0], [1.0]]]), step)
    drive = np.stack([motors, moment], axis=1)
    pushes = drive[:-1] @ transition.input_now.T + drive[1:] @ transition.input_next.T
    states = np.vstack([np.zeros(2), recursion(transition.state, pushes, np.zeros(2))])
    kept = slice(before * fine, None, fine)
    return states[kept], motors[kept, None]


def coloured(smoothness: float, step: float, number: int, rng: np.random.Generator) -> Array:
    """Unit-variance Gaussian-kernel noise (number,), made in the frequency domain; it is periodic, over twice that."""
    total = 2 * number
    omega = 2 * np.pi * np.fft.rfftfreq(total, step)
    power = np.exp(-((omega * smoothness) ** 2))
    phases = rng.standard_normal((2, len(omega)))
    harmonics = np.sqrt(power / power.sum()) * (phases[0] + 1j * phases[1]) / 2
    return np.asarray(np.fft.irfft(harmonics, total, norm="forward")[:number])


@click.command(help=__doc__)
def main() -> None:
    print("| samples | noise | own | corrected |")
    print("|---|---|---|---|")
    for lambda_z in (18.0, 8.0, 4.0):
        coverage = as_assumed(lambda_z, 2.0, 150, 0.1)
        print(
            f"| independent, as assumed | λᶻ = {lambda_z:g} | {coverage.own:.2f} | {coverage.corrected:.2f} |",
            flush=True,
        )
    for wind in (0.3, 1.0, 3.0):
        for ratio in (1, 3, 10):
            coverage = sampled(ratio, wind)
            print(
                f"| 700 of a flight | wind {wind:g} rad/s², s = {ratio} dt | {coverage.own:.2f} "
                f"| {coverage.corrected:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):
        main()
