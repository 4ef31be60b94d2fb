#!/usr/bin/env python
"""How well the smoothness of the noise is estimated, by embedding window and kind of S; prints a Markdown table.

Twenty simulated flights of 6000 samples a row, in wind of 1 rad/s². "Scatter" is the standard deviation of
ln s, "claimed" the one from the curvature of F̄ᵒ. The last rows have white sensor noise, which no S of s describes.

Usage: tools/validation/smoothness.py
"""

from __future__ import annotations

import click
import numpy as np
from calibration import VEHICLE, flight, theta_of
from threadpoolctl import threadpool_limits

from mavdem.dem.record import Record
from mavdem.dem.settings import CompleteSettings
from mavdem.dem.smoothness import estimate_smoothness

FLIGHTS, SAMPLES, DT = 20, 6000, 0.01
RATIOS = (0.5, 1.0, 2.0, 5.0, 10.0)
WINDOWS = (3, 9)
SENSOR_NOISE = 1e-3  # rad, and rad/s


def records(ratio: float, sensor_noise: float = 0.0) -> list[Record]:
    """The flights, in wind whose smoothness is ``ratio`` sampling steps."""
    theta, made = theta_of(VEHICLE), []
    for seed in range(FLIGHTS):
        rng = np.random.default_rng(seed)
        outputs, inputs = flight(theta, 1.0, ratio * DT, SAMPLES, DT, rng)
        outputs = outputs + sensor_noise * rng.standard_normal(outputs.shape)
        made.append(Record(inputs, outputs, DT, (SAMPLES,)))
    return made


def row(name: str, ratio: float, flights: list[Record], correlation: str, window: int) -> str:
    settings = CompleteSettings.from_dict(
        {"order": 2, "d": 2, "window": window, "parameter_precision": 1.0, "correlation": correlation}
    )
    colours = [estimate_smoothness(record, settings) for record in flights]
    relative = np.log([colour.smoothness / (ratio * DT) for colour in colours])
    worst = relative[np.argmax(np.abs(relative))]
    return (
        f"| {name} | {correlation} | {window} | {np.exp(relative.mean()):.3f}, {np.exp(worst):.3f} "
        f"| {relative.std():.3f} | {np.mean([colour.log_sd for colour in colours]):.3f} |"
    )


@click.command(help=__doc__)
def main() -> None:
    print("| s/dt | S | window | s over the true one: mean, worst | scatter | claimed |")
    print("|---|---|---|---|---|---|")
    for ratio in RATIOS:
        flights = records(ratio)
        for correlation in ("sampled", "continuous"):
            for window in WINDOWS:
                print(row(f"{ratio:g}", ratio, flights, correlation, window), flush=True)
    for ratio in (1.0, 10.0):
        print(row(f"{ratio:g}, sensor noise", ratio, records(ratio, SENSOR_NOISE), "sampled", 3), flush=True)


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):
        main()
