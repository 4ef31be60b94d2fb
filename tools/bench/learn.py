#!/usr/bin/env python
"""Time of a whole fit of 20 iterations on one core, and time of learning with default settings; prints a table.

A whole fit: embedding, sufficient statistics, the ascent and the predictor.

Usage: tools/bench/learn.py
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from statistics import median
from timeit import repeat

import click
import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

import mavdem
from mavdem.dem.engine import ascent
from mavdem.dem.fitting import fit
from mavdem.dem.record import Record
from mavdem.dem.settings import CompleteSettings

REPEATS, ITERATIONS, DT = 20, 20, 0.01
CASES = [(700, 2, 4, 2, 1), (700, 3, 4, 2, 2), (700, 6, 4, 4, 2), (36_000, 2, 4, 2, 1), (360_000, 2, 4, 2, 1)]
"""Samples, states, inputs, p and d; two outputs."""


def flight(samples: int, inputs: int = 4) -> mavdem.Flight:
    """A damped axis driven by motors and by noise; its content hardly matters to the time."""
    rng = np.random.default_rng(0)
    motors = rng.standard_normal((samples, inputs)).cumsum(axis=0)
    motors -= np.linspace(0, 1, samples)[:, None] * motors[-1]
    push = motors @ np.resize([1.0, -1.0, -1.0, 1.0], inputs) * 0.01 + rng.standard_normal(samples)
    roll = lfilter([DT**2], [1, 5 * DT - 2, 1 - 5 * DT + 9 * DT**2], push)
    return mavdem.Flight(DT * np.arange(samples), motors, np.column_stack([roll, np.gradient(roll, DT)]))


def time_of(function: Callable[[], object]) -> float:
    return median(repeat(function, number=1, repeat=REPEATS))


@click.command(help=__doc__)
def main() -> None:
    threadpool_limits(limits=1, user_api="blas")
    # Nothing converges, so that all iterations are taken.
    ascent.CONVERGED_NATS = -np.inf
    print("| T | n | r | p, d | fit of 20 iterations, ms |\n|---|---|---|---|---|")
    for samples, order, inputs, p, d in CASES:
        settings = CompleteSettings(
            order=order, p=p, d=d, window=p + 1 + p % 2, parameter_precision=1.0, iterations=ITERATIONS
        )
        whole = partial(fit, Record.of(flight(samples, inputs)), settings)
        assert len(whole().ascent.learning.theta) == ITERATIONS + 1
        print(f"| {samples} | {order} | {inputs} | {p}, {d} | {1e3 * time_of(whole):.1f} |", flush=True)
    ascent.CONVERGED_NATS = 0.1
    learn = partial(mavdem.learn, flight(700))
    print(f"\nLearning 700 samples with default settings: {time_of(learn):.2f} s.")


if __name__ == "__main__":
    main()
