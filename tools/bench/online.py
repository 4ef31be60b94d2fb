#!/usr/bin/env python
"""Time of an update of OnlineLearner, one core, over the whole settled flight of a log; prints a table.

Open settings are chosen beforehand, as `mavdem live` does in another process. Updates are counted from the first model
on. The flight is interpolated to 100 and 400 Hz.

Usage: tools/bench/online.py [LOG]
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter, process_time

import click
import numpy as np

import mavdem

LOG = Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog"


def at_rate(flight: mavdem.Flight, rate: float) -> mavdem.Flight:
    time = np.arange(flight.time[0], flight.time[-1], 1 / rate)
    inputs, outputs = (
        np.column_stack([np.interp(time, flight.time, column) for column in table.T])
        for table in (flight.inputs, flight.outputs)
    )
    return mavdem.Flight(time, inputs, outputs)


def row(flight: mavdem.Flight) -> str:
    settings = mavdem.learn(flight[: round(10 / flight.dt)]).settings
    online = mavdem.OnlineLearner(settings, flight.dt, flight.inputs.shape[1], flight.outputs.shape[1])
    took, used = [], 0.0
    for time, outputs, inputs in zip(flight.time, flight.outputs, flight.inputs, strict=True):
        began, before = perf_counter(), process_time()
        estimate = online.update(time, outputs, inputs)
        if estimate.model is not None:
            took.append(1e3 * (perf_counter() - began))
            used += process_time() - before
    middle, late, last = np.percentile(took, [50, 99, 100])
    share = used / (len(took) * flight.dt)
    return f"| {1 / flight.dt:.0f} | {len(took)} | {middle:.2f} | {late:.2f} | {last:.1f} | {share:.0%} |"


@click.command(help=__doc__)
@click.argument("log", default=LOG, type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(log: Path) -> None:
    flight = mavdem.read_flight(log)
    print("| Hz | updates | median, ms | 99th percentile, ms | longest, ms | share of a core, at that rate |")
    print("|---|---|---|---|---|---|")
    for rate in (100.0, 400.0):
        print(row(at_rate(flight, rate)), flush=True)


if __name__ == "__main__":
    main()
