"""Control loops of a log: the plant identified in flight with its controller, or the fact (a coded finding) why not."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from mavdem.assessment.axis.figures import AxisEstimates, estimates_of_axis
from mavdem.assessment.axis.gains import (
    autotune_fact,
    changed_gains_at_end,
    margin_ratings,
    parts_with_one_gain_set,
)
from mavdem.assessment.axis.training import flights_after_start
from mavdem.dataset.axes import AXES
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import LoopFact
from mavdem.flight import Flights
from mavdem.ingest import Log
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identification import identify_plant_in_loop
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.motors.motor_changes import MotorAlarm
from mavdem.plant import Physical, physical


class LogLoops(NamedTuple):
    """The control loops of a log, and what the autopilot changed of them in flight."""

    loops: dict[str, Loop | Fact]
    """The loops of roll, pitch and yaw by axis, or why they are not known."""
    autotune: list[Fact]
    """A fact for each axis that AutoTune tuned, with the gains before and after as figures.

    It has a rating of both sets of gains by their margins, or none if the loop is not known.
    """


def loops_of_axes(
    log: Log,
    signals: Signals,
    start: float = 0.0,
    estimates: Mapping[str, AxisEstimates] = MappingProxyType({}),
    known_loops: Mapping[str, Loop | Fact] = MappingProxyType({}),
) -> LogLoops:
    """Identifies the control loops of roll, pitch and yaw.

    Args:
        log: the log.
        signals: signals of the vehicle, with the inputs to use.
        start: duration at the beginning of the settled flight that is left out, s.
        estimates: physical parameters by axis, if they were estimated before.
        known_loops: loops by axis, or why they are not known, if they were identified before.

    Returns:
        By axis the identified loop, or the fact that says why it was not identified; and the facts about AutoTune.
    """
    loops = dict[str, Loop | Fact]()
    autotune_facts = []
    for axis in AXES:
        axis_signals = signals.for_axis(axis, signals.inputs)
        if axis in known_loops:
            loop = known_loops[axis]
        else:
            loop = identified_loop_or_reason(axis_signals, log, start, estimates.get(axis))
        loops[axis] = loop
        if isinstance(loop, Loop):
            # The identification of a loop has added the fact about AutoTune to its cautions.
            for caution in loop.cautions:
                if caution.code is LoopFact.AUTOTUNED:
                    autotune_facts.append(caution)
        else:
            autotune_without_loop = autotune_fact(axis_signals, loop)
            if autotune_without_loop is not None:
                autotune_facts.append(autotune_without_loop)
    return LogLoops(loops, autotune_facts)


class AxisResults(NamedTuple):
    """What is estimated of one axis without a learned model."""

    estimates: AxisEstimates
    """Physical parameters and wind torque, or why there are none."""
    loop: Loop | Fact
    """The control loops, or why they are not known."""


def results_of_axis(
    axis: str, log: Log, signals: Signals, alarms: Sequence[MotorAlarm], start: float
) -> AxisResults:
    """Returns physical parameters, wind torque and control loops of one axis, as a second process computes them.

    Args:
        axis: "roll", "pitch" or "yaw".
        log: the log.
        signals: signals of the vehicle, with the inputs to use.
        alarms: changes of the motors in flight.
        start: duration at the beginning of the settled flight that is left out of the loops, s.

    Returns:
        The estimates, or why there are none, and the loops, or why they are not known.
    """
    axis_signals = signals.for_axis(axis, signals.inputs)
    estimates = estimates_of_axis(axis_signals, log.components, alarms)
    return AxisResults(estimates, identified_loop_or_reason(axis_signals, log, start, estimates))


def identified_loop_or_reason(
    signals: Signals, log: Log, start: float = 0.0, estimates: AxisEstimates | None = None
) -> Loop | Fact:
    """Identifies the control loops of the axis of ``signals``, as :func:`loop_of_axis` does, but without raising.

    Args:
        signals, log, start, estimates: as for :func:`loop_of_axis`.

    Returns:
        The loops, or why they are not known.
    """
    try:
        return loop_of_axis(signals, log, start, estimates)
    except NotLearnable as error:
        return error.fact


def loop_of_axis(
    signals: Signals, log: Log, start: float = 0.0, estimates: AxisEstimates | None = None
) -> Loop:
    """Identifies the control loops of the axis of ``signals``, with cautions on changes of the gains.

    Args:
        signals: signals of the vehicle, for the axis.
        log: the log.
        start: duration at the beginning of the settled flight that is left out, s.
        estimates: physical parameters of the axis, if they were estimated before.

    Returns:
        The loops. They are identified from the parts of the flight with the gains that were flown longest.

    Raises:
        NotLearnable: the loops cannot be identified; the error says why.
    """
    segments, learnability = usable_segments(signals, log.components)
    if not segments:
        # Streams that only show the slow motion may still identify the loops, with wider intervals.
        segments, learnability = usable_segments(signals, log.components, MIN_SLOW_MOTION_RATE)
    if not segments:
        raise NotLearnable(learnability.reason)
    flights, gains_changed = parts_with_one_gain_set(signals, flights_after_start(segments, start))
    # The estimates are of all flights: they are those of these parts only if no gains changed.
    fitted = None
    if estimates is not None and gains_changed is None:
        fitted = estimates.physical
    loop = loop_from_plant(_plant(signals, flights, fitted), Record.from_flights(flights))
    if gains_changed is not None:
        # The parts of the flight with other gains are rated as the identified plant would fly with those.
        other_gains = (dict(changes) for _, changes in gains_changed.figures["parts"])
        gains_changed = gains_changed.replace(ratings=margin_ratings(loop, other_gains))
    cautions_on_gains = (
        gains_changed,
        autotune_fact(signals, loop),
        changed_gains_at_end(signals, loop.controller),
    )
    known_cautions = [fact for fact in cautions_on_gains if fact is not None]
    return replace(loop, cautions=(*known_cautions, *loop.cautions))


MARGIN_REFUSALS = (LoopFact.MARGIN_UNCERTAIN,)
"""Refusals of a plant that was identified in its closed loop, but too poorly for margins.

Inputs and outputs alone show the plant worse, so that the fit by these does not replace it.
"""


def _plant(signals: Signals, flights: Flights, gray_box_fit: Physical | None) -> Physical:
    """Identifies the plant of an axis, in its closed loop if possible.

    Identification in the closed loop uses the logged controller and setpoints. If these are not known, the plant is
    that of the gray-box fit, which uses inputs and outputs alone. Its ``refusal`` then says why the closed loop could
    not be used. If the closed loop was identified, but too poorly for margins, there is no result: margins by the
    gray-box fit would be even worse.

    Args:
        signals: signals of the vehicle, for the axis.
        flights: flights to identify the plant from.
        gray_box_fit: result of the gray-box fit; None if it must still be computed.

    Returns:
        The plant: angular acceleration of the axis per command of the motors.

    Raises:
        NotLearnable: the plant is not identifiable in either way.
    """
    try:
        return identify_plant_in_loop(signals, flights)
    except NotLearnable as error:
        if error.fact.code in MARGIN_REFUSALS:
            raise
        plant = (gray_box_fit or physical(flights))._replace(refusal=error.fact)
    if isinstance(plant, Physical) and plant.identifiable:
        return plant
    assert plant.refusal is not None
    unidentified = plant.caution if isinstance(plant, Physical) else plant.reason
    if plant.refusal.code is LoopFact.NO_RATE_SETPOINT and unidentified is not None:
        # Both reasons are reported. The missing setpoint alone would mislead: on other axes of the same log, without it
        # too, inputs and outputs may suffice.
        raise NotLearnable(LoopFact.NO_LOOP, reasons=(plant.refusal, unidentified))
    raise NotLearnable(plant.refusal)


def loop_of_parameters_or_reason(estimates: AxisEstimates, record: Record | None) -> Loop | Fact:
    """Returns the control loops of an axis that follow from its physical parameters, or why they are not known.

    It serves live sessions: there the closed loop is not identified, since that needs a whole log.

    Args:
        estimates: estimates of the axis, with its physical parameters or the reason why there are none.
        record: the data from which these parameters were learned; None if there are no parameters.

    Returns:
        The loops of rate and attitude; or the fact that says why they are not known.
    """
    plant = estimates.physical
    if plant is None or record is None:
        assert estimates.reason is not None
        return estimates.reason
    try:
        return loop_from_plant(plant, record)
    except NotLearnable as error:
        return error.fact
