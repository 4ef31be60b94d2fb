#!/usr/bin/env python
"""Time of a whole fit of 20 iterations, and time of learning with default settings; prints a table.

A whole fit, on one core: embedding, sufficient statistics, the ascent and the predictor. With --jobs, instead: time of
so many fits of 700 samples, one after the other and as a batch on all cores.

Usage: tools/bench/learn.py [--jobs N]
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice, product
from statistics import median
from timeit import repeat, timeit
from typing import NamedTuple

import click
import numpy as np
from threadpoolctl import threadpool_limits

import mavdem
from mavdem.dem.engine import ascent
from mavdem.dem.fitting import fit
from mavdem.dem.record import Record
from mavdem.dem.settings import CompleteSettings

REPEATS = 20
ITERATIONS = 20
DT = 0.01


class FitSize(NamedTuple):
    samples: int
    order: int
    outputs: int
    inputs: int
    p: int
    d: int

    @property
    def settings(self) -> CompleteSettings:
        settings = CompleteSettings(
            order=self.order,
            p=self.p,
            d=self.d,
            window=self.p + 1 + self.p % 2,
            parameter_precision=1.0,
            iterations=ITERATIONS,
        )
        if self.outputs <= self.order:
            return settings
        # With more outputs than states C is free, and the paper's convention holds the scale of the states.
        free = {"prior": "uniform", "correlation": "continuous"}
        return CompleteSettings.from_dict({**settings.to_dict(), **free})


CASES = [
    FitSize(700, 2, 2, 4, 2, 1),
    FitSize(700, 3, 2, 4, 2, 2),
    FitSize(320, 2, 4, 1, 6, 2),
    FitSize(700, 6, 2, 4, 4, 2),
    FitSize(36_000, 2, 2, 4, 2, 1),
    FitSize(360_000, 2, 2, 4, 2, 1),
]


def flight(samples: int, inputs: int = 4, outputs: int = 2) -> mavdem.Flight:
    """A damped axis driven by motors and by noise; its content hardly matters to the time."""
    rng = np.random.default_rng(0)
    motors = rng.standard_normal((samples, inputs)).cumsum(axis=0)
    motors -= np.linspace(0, 1, samples)[:, None] * motors[-1]
    states = np.zeros((samples, 2))
    push = motors @ np.resize([1.0, -1.0, -1.0, 1.0], inputs) * 0.01 + rng.standard_normal(samples)
    for t in range(1, samples):
        roll, rate = states[t - 1]
        states[t] = roll + DT * rate, rate + DT * (push[t] - 9 * roll - 5 * rate)
    seen = states if outputs == 2 else states @ rng.standard_normal((2, outputs))
    return mavdem.Flight(DT * np.arange(samples), motors, seen)


def time_of(function: Callable[[], object]) -> float:
    return median(repeat(function, number=1, repeat=REPEATS))


def print_batch(count: int) -> None:
    """Fits of one flight by seed, prior precision and order, with complete settings: one candidate each."""
    train = flight(700)
    choices = product(range(-(-count // 8)), (1.0, 10.0, 100.0, 1000.0), (2, 3))
    jobs = [
        (train, mavdem.Settings(order=order, window=9, parameter_precision=precision, seed=seed))
        for seed, precision, order in islice(choices, count)
    ]
    serial = timeit(lambda: [mavdem.learn(*job) for job in jobs], number=1)
    batch = timeit(lambda: list(mavdem.learn_many(jobs)), number=1)
    print(f"{count} fits: {serial:.1f} s one after the other, {batch:.1f} s by learn_many, {serial / batch:.2f} times.")


def print_fits() -> None:
    # Nothing converges, so that all iterations are taken.
    ascent.CONVERGED_NATS = -np.inf
    print("| T | n | m | r | p, d | fit of 20 iterations, ms |")
    print("|---|---|---|---|---|---|")
    for case in CASES:
        record = Record.of(flight(case.samples, case.inputs, case.outputs))
        settings = case.settings

        def whole(record: Record = record, settings: CompleteSettings = settings) -> object:
            return fit(record, settings)

        assert len(fit(record, settings).ascent.theta) == ITERATIONS + 1
        print(
            f"| {case.samples} | {case.order} | {case.outputs} | {case.inputs} | {case.p}, {case.d} "
            f"| {1e3 * time_of(whole):.1f} |",
            flush=True,
        )
    ascent.CONVERGED_NATS = 0.1
    data = flight(700)
    print(f"\nLearning 700 samples with default settings: {time_of(lambda: mavdem.learn(data)):.2f} s.")


@click.command(help=__doc__)
@click.option("--jobs", "count", type=click.IntRange(min=1))
def main(count: int | None) -> None:
    if count is not None:
        return print_batch(count)
    with threadpool_limits(limits=1, user_api="blas"):
        print_fits()


if __name__ == "__main__":
    main()
