"""The twin of an assessed vehicle, and what it foretells of gains to set."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.loops import Gains
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.axis_loops import LoopsByAxis, identified_loops
from mavdem.loops.twin import (
    SETTLING_SECONDS,
    ReplaySegment,
    Twin,
    build_twin,
    fly_twin,
    replay_segments,
)
from mavdem.motors.hover import hover_of
from mavdem.wind_velocity.airflow import Drag

FORETOLD_SECONDS = 40.0  # of a flight, by gains to set: who has just landed waits for it


class AssessedTwin(NamedTuple):
    """The twin of a vehicle."""

    twin: Twin
    loops: LoopsByAxis  # which it was made of
    missing: NamedFacts  # by axis, why others are not known


def assessed_twin(evidence: Evidence, mass: float | None = None) -> AssessedTwin:
    """Returns the twin of the vehicle, of this ``mass``, kg, where somebody knows it.

    Raises NotLearnable: the loops of roll, or the hover, are not known.
    """
    missing = {axis: loop for axis, loop in evidence.loops.items() if isinstance(loop, Fact)}
    if evidence.grounds:
        missing = {axis: fact.grounded for axis, fact in missing.items()}
    if "roll" in missing:
        raise NotLearnable((*evidence.grounds, missing["roll"])[0])
    loops = identified_loops(evidence.loops)
    signals = evidence.signals
    hover = hover_of(signals.for_axis("roll", "motors"), evidence.log.components)
    share = float(np.mean(hover.trim_of_range))
    telemetry = signals.telemetry
    air, *_ = evidence.air
    drag = (
        Drag.of_parameters(telemetry.autopilot, telemetry.parameters) if air is None else air.drag
    )
    twin = build_twin(loops, telemetry.autopilot == "PX4", share, air, drag, mass)
    return AssessedTwin(twin, loops, missing)


def foretold(evidence: Evidence, gains: Parameters) -> Facts:
    """Returns by axis how far from its setpoints the vehicle's twin flies, now and with the ``gains`` to set.

    Why not, where the twin cannot fly; nothing where the log has no setpoints of roll.
    """
    loops = identified_loops(evidence.loops)
    again = replay_segments(loops) if "roll" in loops else {}
    if not again:
        return ()
    dt = loops["roll"].record.dt
    shown = slice(round(FORETOLD_SECONDS / dt))
    short = {axis: ReplaySegment(*(part[shown] for part in whole)) for axis, whole in again.items()}
    settled = slice(round(SETTLING_SECONDS / dt), None)
    try:
        twin = assessed_twin(evidence).twin
        changed = replace(twin, parameters={**twin.parameters, **gains})
        flights = [fly_twin(each, loops, short) for each in (twin, changed)]
    except NotLearnable as error:
        return (error.fact,)
    facts = []
    for axis in filter(short.get, TILT_AXES):
        asked = short[axis].setpoints[settled, 0]
        missed = [motion[settled, AXES.index(axis), 0] - asked for motion in flights]
        before, after = np.degrees(np.std(missed, axis=1)).tolist()
        facts.append(
            Fact(Gains.TWIN_FLIES, subject=axis, present_error=before, expected_error=after)
        )
    return tuple(facts)
