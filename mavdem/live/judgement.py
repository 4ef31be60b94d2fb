"""What a live flight says: the findings of a log, from the latest samples that its model was learned from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from mavdem.alignment.align import Segment
from mavdem.alignment.drive import DEMAND_MESSAGE, Motors
from mavdem.alignment.signals import Attitude, Signals
from mavdem.analysis.findings import Findings, disown_torque, findings_of
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
    inputs, outputs = max(learned.record.segments, key=lambda part: len(part[1]))
    time: Any = learned.dt * np.arange(len(inputs))
    scale, names = {"scale": asdict(setup.scale)}, (setup.layout.names, learned.record.output_names)
    flight = Flight(time, inputs, outputs, input_names=names[0], output_names=names[1], provenance=scale)
    condition = Condition(duration=flight.duration, settled=flight.duration)
    if setup.motors != DEMAND_MESSAGE:
        signals, boot = Signals(Telemetry(0, 0, "UNKNOWN", "", {})), np.zeros(len(time), dtype=np.int64)
        angle, rate = flight.outputs.T
        tilt = Attitude(setup.attitude, time, boot, angle, rate, rate, len(time), 0, 0)
        motors = Motors(setup.motors, time, boot, flight.inputs, setup.layout, setup.scale, len(time), 0)
        # They take the place of the cached properties: nothing is from messages here.
        vars(signals).update(motors=motors, tilts=(tilt,))
        swing = oscillation_of(signals, [Segment(0, 0.0, flight.duration)])
        swing = swing and swing._replace(axis=names[1][0])
        condition = replace(condition, hover=hover_figures([flight]), oscillation=swing)
    disown_torque(learned, condition)
    watched = condition.hover is not None and not setup.layout.positions_assumed
    return findings_of(learned, None, condition, alarms, flights=[flight], watched=watched)
