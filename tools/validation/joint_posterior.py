#!/usr/bin/env python
"""How far DEM departs from the exact posterior of short series in smooth noise; prints a Markdown table.

Every number is over 20 series of 90 samples. States are estimated with the parameters known, parameters with the noise
known and a weak prior. A departure is the root mean square of DEM's mean less the exact one, in exact posterior
standard deviations; an sd ratio is DEM's standard deviation over the exact one. One number for each state, or for each
free parameter: rate of decay (and gain), or stiffness, damping and gain.

The convention of the last derivative is q = p (its equation counts, with a zero on the left) or q = p − 1 (left out).
"As read" is the latter with the noise covariances of derivatives estimated from samples.

Usage: tools/validation/joint_posterior.py
"""

from __future__ import annotations

import click
import numpy as np
from dem_posterior import Embedding, parameters_of, states_of
from joint_gaussian import System, parameters_given
from numpy.typing import NDArray
from systems import decay, roll, weak_prior
from threadpoolctl import threadpool_limits

Array = NDArray[np.float64]

SERIES = 20
SMOOTHNESS = (1.0, 2.0, 4.0)  # s/dt
OUTPUT_NOISE = (0.03, 0.1)  # the states being of order one
ORDERS = (1, 2, 4)


def systems(smoothness: float, noise: float) -> dict[str, System]:
    return {
        "decay, driven by noise": decay(smoothness, noise),
        "decay, driven by input": decay(smoothness, noise, gain=1.0, process_noise=0.3),
        "roll and rate": roll(smoothness, noise),
        "roll, rate hidden": roll(smoothness, noise, outputs=1),
    }


def embeddings() -> dict[str, Embedding]:
    conventions = {}
    for p in ORDERS:
        conventions[f"{p} | q = p"] = Embedding(p, p)
        conventions[f"{p} | q = p − 1"] = Embedding(p, p - 1)
        conventions[f"{p} | as read"] = Embedding(p, p - 1, as_read=True)
    return conventions


def rows(system: System) -> dict[str, str]:
    """The last cells of the row, for each embedding."""
    prior = weak_prior(system)
    _, series = system.draw(np.random.default_rng(0), SERIES)
    states = [system.states_given(outputs) for outputs in series]
    parameters = [parameters_given(system, outputs, prior) for outputs in series]
    ends = {}
    for name, embedding in embeddings().items():
        found = [states_of(system, outputs, embedding, prior) for outputs in series]
        seen = slice(embedding.centre, embedding.centre + len(found[0][0]))
        of_states = against(found, [(mean[seen], sd[seen]) for mean, sd in states])
        estimates = [parameters_of(system, outputs, embedding, prior) for outputs in series]
        of_parameters = against(
            *([(mean, np.sqrt(np.diag(of))) for mean, of in own] for own in (estimates, parameters))
        )
        ends[name] = " | ".join(", ".join(f"{number:.2f}" for number in cell) for cell in (*of_states, *of_parameters))
    return ends


def against(found: list[tuple[Array, Array]], exact: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Departure and sd ratio of each state or parameter, of means and standard deviations by series."""
    squares, ratios = [], []
    for (own, own_sd), (mean, sd) in zip(found, exact, strict=True):
        squares.append(np.atleast_2d(((own - mean) / sd) ** 2).mean(axis=0))
        ratios.append(np.atleast_2d(own_sd / sd).mean(axis=0))
    return np.sqrt(np.mean(squares, axis=0)), np.mean(ratios, axis=0)


@click.command(help=__doc__)
def main() -> None:
    print("| system | s/dt | noise of y | p | last derivative | states off | their sd | parameters off | their sd |")
    print("|---|---|---|---|---|---|---|---|---|")
    for smoothness in SMOOTHNESS:
        for noise in OUTPUT_NOISE:
            for name, system in systems(smoothness, noise).items():
                for embedding, end in rows(system).items():
                    print(f"| {name} | {smoothness:g} | {noise:g} | {embedding} | {end} |", flush=True)


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):
        main()
