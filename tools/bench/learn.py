#!/usr/bin/env python
"""Time and memory of a whole fit of 20 iterations, and time of learning with default settings; prints a table.

A whole fit: from samples to a model with its predictor, embedding and moments included, on one core.

Usage: tools/bench/learn.py
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import NamedTuple

import click
import numpy as np
from threadpoolctl import threadpool_limits

import mavdem
from mavdem.dem import ascent
from mavdem.dem.fit import fit, generalized
from mavdem.dem.generative import Samples
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling

REPEATS = 20
ITERATIONS = 20
DT = 0.01


class Case(NamedTuple):
    samples: int
    order: int
    outputs: int
    inputs: int
    p: int
    d: int

    @property
    def settings(self) -> mavdem.Settings:
        settings = mavdem.Settings(
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
        free = {"prior": "uniform", "last_derivative_zero": True, "correlation": "continuous"}
        return mavdem.Settings.from_dict({**settings.to_dict(), **free})


CASES = [
    Case(700, 2, 2, 4, 2, 1),
    Case(700, 3, 2, 4, 2, 2),
    Case(320, 2, 4, 1, 6, 2),
    Case(700, 6, 2, 4, 4, 2),
    Case(36_000, 2, 2, 4, 2, 1),
    Case(360_000, 2, 2, 4, 2, 1),
]


def flight(samples: int, inputs: int = 4, outputs: int = 2) -> mavdem.Flight:
    """A damped axis pushed by motors and by noise; what is in it hardly matters to the time."""
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


def time_of(function: Callable[[], object], repeats: int = REPEATS) -> float:
    times = []
    for _ in range(repeats):
        began = perf_counter()
        function()
        times.append(perf_counter() - began)
    return median(times)


def memory_of(function: Callable[[], object]) -> float:
    """Peak of what is allocated meanwhile, MB."""
    tracemalloc.start()
    function()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak / 1e6


@click.command(help=__doc__)
def main() -> None:
    # Nothing settles, so that all iterations are taken.
    ascent.SETTLED = -np.inf
    print("| T | n | m | r | p, d | fit of 20 iterations, ms | of which embedding and moments | peak memory, MB |")
    print("|---|---|---|---|---|---|---|---|")
    for case in CASES:
        record = Record.of(flight(case.samples, case.inputs, case.outputs))
        settings = case.settings
        scaling = Scaling.of(*record.spread, settings)

        def whole(record: Record = record, settings: mavdem.Settings = settings) -> object:
            return fit(record, settings)

        def moments(
            record: Record = record, settings: mavdem.Settings = settings, scaling: Scaling = scaling
        ) -> Samples:
            return Samples.of(*generalized(settings, scaling, record))

        assert len(fit(record, settings).ascent.theta) == ITERATIONS + 1
        print(
            f"| {case.samples} | {case.order} | {case.outputs} | {case.inputs} | {case.p}, {case.d} "
            f"| {1e3 * time_of(whole):.1f} | {1e3 * time_of(moments):.1f} | {memory_of(whole):.0f} |",
            flush=True,
        )
    ascent.SETTLED = 0.1
    data = flight(700)
    print(f"\nLearning 700 samples with default settings: {time_of(lambda: mavdem.learn(data)):.2f} s.")


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):
        main()
