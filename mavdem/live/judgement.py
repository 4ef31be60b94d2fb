"""What a live flight says: the findings of a log, from the latest samples that its model was learned from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from mavdem.alignment.align import Segment
from mavdem.alignment.drive import DEMAND_MESSAGE, Motors
from mavdem.alignment.signals import Attitude, Signals
from mavdem.analysis.findings import Findings, findings_of
from mavdem.condition import Condition
from mavdem.condition.condition import hover_figures
from mavdem.condition.oscillation import oscillation_of
from mavdem.dem import Learned, Physical
from mavdem.flight import Flight
from mavdem.health.in_flight import MotorAlarm
from mavdem.ingest.telemetry import Telemetry
from mavdem.live.decisions import Setup


def judged(learned: Learned, physical: Physical | None, setup: Setup, alarms: Sequence[MotorAlarm]) -> Findings:
    """Returns the findings on a model whose inputs are those of ``setup``.

    Its ``physical`` parameters are from now on those of the whole flight, where these are known already.
    """
    if physical is not None:
        vars(learned)["_gray_box"] = physical
    condition, flights = _condition(learned, setup)
    if condition.oscillation is not None and learned.wind is not None:
        vars(learned)["wind"] = replace(learned.wind, reason="The vehicle oscillates: that torque is its own.")
    watched = condition.hover is not None and not setup.layout.positions_assumed
    return findings_of(learned, None, condition, alarms, flights=flights, watched=watched)


def _condition(learned: Learned, setup: Setup) -> tuple[Condition, list[Flight]]:
    """What the samples show of the motors, and whether the vehicle oscillates; a second lies between segments."""
    record, start, flights, hover, found = learned.record, 0.0, [], None, None
    labels: dict[str, Any] = {"input_names": setup.layout.names, "output_names": record.output_names}
    for inputs, outputs in record.segments:
        time = start + record.dt * np.arange(len(inputs))
        flights.append(Flight(time, inputs, outputs, provenance={"scale": asdict(setup.scale)}, **labels))
        start = float(time[-1]) + 1.0
    if setup.motors != DEMAND_MESSAGE:
        hover, count, signals = hover_figures(flights), len(record), Signals(Telemetry(0, 0, "UNKNOWN", "", {}))
        stamps: Any = [np.concatenate([flight.time for flight in flights]), np.zeros(count, dtype=np.int64)]
        moved: Any = [record.inputs, setup.layout, setup.scale, count, 0]
        turned: Any = [record.outputs[:, 0], record.outputs[:, 1], record.outputs[:, 1], count, 0, 0]
        # They take the place of the cached properties: nothing is from messages here.
        tilt = Attitude(setup.attitude, *stamps, *turned)
        vars(signals).update(motors=Motors(setup.motors, *stamps, *moved), tilts=(tilt,))
        found = oscillation_of(signals, [Segment(0, float(one.time[0]), float(one.time[-1])) for one in flights])
        found = found and found._replace(axis=record.output_names[0])
    return Condition(duration=start, settled=start, hover=hover, oscillation=found), flights
