#!/usr/bin/env python
"""Replays a log into an OnlineLearner and a LiveView, as a live link would: the dashboard of a flight under way.

Usage: tools/demonstrations/live_dashboard.py LOG OUT.rrd [--seconds S] [--speed X] [--connect URL]

At full speed unless --speed is given (1 is that of the flight); what is recorded is the same, as long as nothing has to
be dropped.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from math import isfinite, nan
from pathlib import Path

import mavdem
from mavdem.view.live import Channels, LiveView, RecordingFile, Sink, Status, Viewer

HORIZONS = (1, 5, 10, 25, 50)
"""Steps ahead of the predictions."""


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("log", type=Path)
    arguments.add_argument("recording", type=Path)
    arguments.add_argument("--seconds", type=float, default=float("inf"), help="of the flight, from its beginning")
    arguments.add_argument("--speed", type=float, default=float("inf"), help="in times that of the flight")
    arguments.add_argument("--connect", help="a viewer to show it in too")
    chosen = arguments.parse_args()
    flight = mavdem.read_flight(chosen.log)
    sinks: list[Sink] = [RecordingFile(chosen.recording)]
    if chosen.connect:
        sinks.append(Viewer(chosen.connect))
    with LiveView(channels_of(flight, chosen.log.name), sinks) as view:
        replay(flight[: max(1, round(min(chosen.seconds, flight.duration) / flight.dt))], view, chosen.speed)
    for trouble in view.troubles:
        print(trouble, file=sys.stderr)
    return 1 if view.troubles else 0


def channels_of(flight: mavdem.Flight, title: str) -> Channels:
    return Channels(
        title,
        flight.dt,
        HORIZONS,
        flight.input_names,
        flight.output_names,
        flight.input_units,
        flight.output_units,
    )


def replay(flight: mavdem.Flight, view: LiveView, speed: float) -> None:
    learner = mavdem.OnlineLearner(
        dt=flight.dt, n_inputs=flight.inputs.shape[1], n_outputs=flight.outputs.shape[1], horizons=HORIZONS
    )
    began, learned = time.monotonic(), None
    view.log(f"replaying {flight.duration:.0f} s at {1 / flight.dt:.4g} Hz", time=float(flight.time[0]))
    for i, (now, outputs, inputs) in enumerate(zip(flight.time, flight.outputs, flight.inputs, strict=True)):
        late = time.monotonic() - began - (now - flight.time[0]) / speed
        if late < 0:
            time.sleep(-late)
        estimate = learner.update(float(now), outputs, inputs)
        view.put(float(now), 0, outputs, inputs, estimate, learner.learned)
        if learner.learned is not learned:
            learned = learner.learned
            assert learned is not None
            view.log(f"learnt anew from {len(learned.record.outputs) * flight.dt:.0f} s")
        if i % round(1 / flight.dt) == 0:
            view.status(
                Status(samples=i + 1, latency=max(0.0, late) if isfinite(speed) else nan, obstacle=learner.obstacle)
            )


if __name__ == "__main__":
    # Ended politely, it still closes its file.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    sys.exit(main())
