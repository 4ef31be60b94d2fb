#!/usr/bin/env python
"""How well the smoothness of the noise is recovered, by window and by what S is taken to be; prints a Markdown table.

Twenty simulated flights of 6000 samples a row, in wind of 1 rad/s². "Scatter" is that of ln s, "claimed" the standard
deviation that the curvature of F̄ᵒ gives it.

Usage: tools/engine/smoothness.py
"""

from __future__ import annotations

import numpy as np
from calibration import VEHICLE, flight, theta_of
from threadpoolctl import threadpool_limits

from mavdem import Settings
from mavdem.dem.colour import estimate_colour
from mavdem.dem.record import Record

FLIGHTS, SAMPLES, DT = 20, 6000, 0.01
RATIOS = (0.5, 1.0, 2.0, 5.0, 10.0)
WINDOWS = (3, 9)


def main() -> None:
    print("| s/dt | S | window | s over the true one: mean, worst | scatter | claimed |")
    print("|---|---|---|---|---|---|")
    theta = theta_of(VEHICLE)
    for ratio in RATIOS:
        records = []
        for seed in range(FLIGHTS):
            outputs, inputs = flight(theta, 1.0, ratio * DT, SAMPLES, DT, np.random.default_rng(seed))
            records.append(Record(inputs, outputs, DT, (SAMPLES,)))
        for correlation in ("sampled", "continuous"):
            for window in WINDOWS:
                settings = Settings.from_dict(
                    {"order": 2, "d": 2, "window": window, "parameter_precision": 1.0, "correlation": correlation}
                )
                colours = [estimate_colour(record, settings) for record in records]
                relative = np.log([colour.smoothness / (ratio * DT) for colour in colours])
                worst = relative[np.argmax(np.abs(relative))]
                print(
                    f"| {ratio:g} | {correlation} | {window} | {np.exp(relative.mean()):.3f}, {np.exp(worst):.3f} "
                    f"| {relative.std():.3f} | {np.mean([colour.log_sd for colour in colours]):.3f} |",
                    flush=True,
                )


if __name__ == "__main__":
    with threadpool_limits(limits=1, user_api="blas"):
        main()
