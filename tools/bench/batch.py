#!/usr/bin/env python
"""Time of many fits of 700 samples, one after the other and as a batch on all cores, in one run; prints a table.

Usage: tools/bench/batch.py [--jobs N]
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import product
from time import perf_counter

import click
from learn import flight

import mavdem
from mavdem.dem.workers import spare_cores

Job = tuple[mavdem.Flight, mavdem.Settings]


def varied(count: int) -> list[Job]:
    """Fits of one flight by seed, prior precision and order: nothing is left open, so that each is one candidate."""
    train = flight(700)
    seeds = range(-(-count // 8))
    choices = product(seeds, (1.0, 10.0, 100.0, 1000.0), (2, 3))
    return [
        (train, mavdem.Settings(order=order, window=9, parameter_precision=precision, seed=seed))
        for seed, precision, order in choices
    ][:count]


def seconds(answers: Callable[[], Iterable[object]]) -> float:
    began = perf_counter()
    for answer in answers():
        assert isinstance(answer, mavdem.Learned), answer
    return perf_counter() - began


@click.command(help=__doc__)
@click.option("--jobs", "count", default=1000, show_default=True, type=click.IntRange(min=1))
def main(count: int) -> None:
    jobs = varied(count)
    mavdem.learn(*jobs[0])
    serial = seconds(lambda: (mavdem.learn(*job) for job in jobs))
    batch = seconds(lambda: mavdem.learn_many(jobs))
    print("| fits of T = 700 | seconds | a second | speed-up |")
    print("|---|---|---|---|")
    for name, taken in (("one after the other", serial), (f"`learn_many` on {spare_cores()} cores", batch)):
        print(f"| {count} {name} | {taken:.1f} | {count / taken:.1f} | {serial / taken:.2f} |")


if __name__ == "__main__":
    main()
