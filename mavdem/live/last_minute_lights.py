"""Judgement of a live vehicle's estimator and vibration by the last minute, as the whole of a log is judged."""

from __future__ import annotations

from math import inf

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.innovations import INNOVATION_LIMIT, INNOVATIONS, latest_time_above
from mavdem.assessment.lights.estimator import estimator_light
from mavdem.assessment.lights.vibration import vibration_light
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.vibration import VibrationLight
from mavdem.facts.watch import WatchedQuantity
from mavdem.live.report_alarms import is_lasting_state
from mavdem.live.review import Review
from mavdem.vibration.vibration_message import reported_vibration


def judge_estimator(review: Review, evidence: Evidence) -> None:
    """Judges the state estimator by the last minute, as the estimator of a whole log is judged.

    The judgement is a fact: a coded finding with a level from good to bad. A fault may have been over for some seconds,
    so the time when it was last there is stored beside it; the alarm about the fault ends some time after that.

    Args:
        review: the review, whose ``facts`` get the judgement, and whose ``last_found_times`` get that time. If nothing
            was measured, neither is changed.
        evidence: signals of the last minute, and the autopilot's warnings in it, in the form by which a log is judged.
    """
    judgement = estimator_light(evidence)
    if judgement.code is EstimatorLight.ESTIMATOR_UNMEASURED:
        return
    review.facts[WatchedQuantity.ESTIMATOR] = judgement
    is_fault_with_time = judgement.is_watch_or_bad and judgement.time is not None
    # A fault without such a time is taken to be there now. So is a state that the autopilot reports until it ends.
    if is_fault_with_time and not is_lasting_state(judgement):
        fault_time = _latest_estimator_time(evidence.signals, judgement)
        review.last_found_times[WatchedQuantity.ESTIMATOR] = fault_time


def judge_vibration(review: Review, evidence: Evidence) -> None:
    """Judges the vibration in the settled flight of the last minute, that is without take-off and landing.

    Args:
        review: the review, whose ``facts`` get the judgement, a coded finding with a level. Its ``last_found_times``
            get the time when too strong a vibration was there last.
        evidence: signals of the last minute, with the intervals of settled flight, in the form by which a log is
            judged.
    """
    judgement = vibration_light(evidence)
    if judgement.code is VibrationLight.VIBRATION_MEASURED:
        # Its sentence then says that the flight goes on: the recording is judged by the mean of the whole flight.
        judgement = judgement.replace(is_in_flight=True)
    review.facts[WatchedQuantity.VIBRATION] = judgement
    if judgement.is_watch_or_bad:
        limit = judgement.figures["acceptable_vibration"]
        fault_time = _latest_vibration_time(evidence.signals, limit)
        review.last_found_times[WatchedQuantity.VIBRATION] = fault_time


def _latest_estimator_time(signals: Signals, fault: Fact) -> float:
    """Returns when a fault of the state estimator was there last.

    Args:
        signals: signals of the last minute, in which the estimator was judged.
        fault: the fault, with its time. If it is a large innovation (the difference between a measurement and its
            prediction, relative to what is plausible), its figure "name" is the name of the innovation.

    Returns:
        The time, s of the boot clock: when an innovation was last beyond its limit; the end of any other fault.
    """
    innovation_name = fault.figures.get("name")
    if innovation_name in INNOVATIONS:
        limit = fault.figures.get("failsafe_limit", INNOVATION_LIMIT)
        latest_time = latest_time_above(signals.telemetry, innovation_name, limit)
        if latest_time is not None:
            return latest_time
    duration = float(fault.figures.get("duration", 0.0))
    return fault.start_time + duration


def _latest_vibration_time(signals: Signals, limit: float) -> float:
    """Returns when the vibration was last above a limit, or an accelerometer out of its range (clipping).

    Args:
        signals: signals of the last minute, in which the vibration was judged.
        limit: vibration, m/s².

    Returns:
        The time, s of the boot clock; minus infinity if it was in no sample.
    """
    vibration = reported_vibration(signals)
    assert vibration is not None
    # Each sample has three axes of vibration, and the clipping of several accelerometers: one of them is enough.
    is_above_limit = (vibration.levels.values > limit).any(axis=1)
    is_clipping = (vibration.clips > 0).any(axis=1)
    times = vibration.levels.time[is_above_limit | is_clipping]
    return float(times.max(initial=-inf))
