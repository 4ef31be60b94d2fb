#!/usr/bin/env python
"""Time of an iteration of D, E and M steps, and of learning with default settings; prints a table.

Usage: tools/bench/learn.py
"""

from __future__ import annotations

from statistics import median
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

import mavdem
from mavdem.dem.ascent import ascend
from mavdem.dem.fit import generalized, generative_model
from mavdem.dem.generative import Samples
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling

REPEATS = 20
ITERATIONS = 20
DT = 0.01
CASES = [(700, 2, 2, 1), (700, 3, 2, 2), (700, 2, 6, 2), (700, 6, 4, 2), (360_000, 2, 2, 1)]
"""Samples, order n, embedding orders p and d; four inputs and two outputs throughout."""


def flight(samples: int) -> mavdem.Flight:
    """A damped axis pushed by motors and by noise; what is in it hardly matters to the time."""
    rng = np.random.default_rng(0)
    motors = rng.standard_normal((samples, 4)).cumsum(axis=0)
    motors -= np.linspace(0, 1, samples)[:, None] * motors[-1]
    outputs = np.zeros((samples, 2))
    push = motors @ [1, -1, -1, 1] * 0.01 + rng.standard_normal(samples)
    for t in range(1, samples):
        roll, rate = outputs[t - 1]
        outputs[t] = roll + DT * rate, rate + DT * (push[t] - 9 * roll - 5 * rate)
    return mavdem.Flight(DT * np.arange(samples), motors, outputs)


def time_of(function) -> float:  # noqa: ANN001
    times = []
    for _ in range(REPEATS):
        began = perf_counter()
        function()
        times.append(perf_counter() - began)
    return median(times)


def main() -> None:
    print("| T | n | p, d | embedding and moments, ms | one iteration, ms |")
    print("|---|---|---|---|---|")
    for samples, order, p, d in CASES:
        data = flight(samples)
        settings = mavdem.Settings(order=order, p=p, d=d, window=p + 1 + p % 2, parameter_precision=1.0)
        record = Record.of(data)
        scaling = Scaling.of(data.inputs, data.outputs, settings)
        model = generative_model(settings, scaling, record)

        def moments(record=record, settings=settings, scaling=scaling) -> Samples:  # noqa: ANN001
            return Samples.of(*generalized(settings, scaling, record))

        gram = moments()
        taken = len(ascend(model, gram, ITERATIONS).theta) - 1
        seconds = time_of(lambda model=model, gram=gram: ascend(model, gram, ITERATIONS))
        print(f"| {samples} | {order} | {p}, {d} | {1e3 * time_of(moments):.2f} | {1e3 * seconds / taken:.2f} |")
    data = flight(700)
    print(f"\nLearning 700 samples with default settings: {time_of(lambda: mavdem.learn(data)):.2f} s.")


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):
        main()
