"""Status light of the wind, a fact (a coded finding): its speed, and the fraction of the largest lean that it needs."""

from math import hypot, inf, radians

from mavdem.assessment.condition import Condition
from mavdem.assessment.evidence import Evidence
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.online import DragSource
from mavdem.facts.sources import Repair
from mavdem.facts.wind import WindLight
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.wind_velocity.beaufort import is_speed_known
from mavdem.wind_velocity.velocity import WindVelocity

LEAN_LIMIT_PARAMETERS = {"ANGLE_MAX": 0.01, "ATC_ANGLE_MAX": 1.0, "MPC_TILTMAX_AIR": 1.0}
"""Parameters with the largest lean, and the factor that converts them to degrees."""

MAX_LEAN_FRACTION = 0.5
"""Fraction of the largest lean that the mean wind may take: as much is left for gusts and motion against it."""


def wind_light(evidence: Evidence, estimator: Fact) -> Fact:
    """Judges the mean wind of a flight, which is estimated from how far the vehicle leans to hold its position.

    A wind that carried the vehicle away is the light, whatever its speed. Otherwise the first level that applies is:

    1. "unknown", without figures, if the flight does not identify the speed;
    2. "watch" if the estimator is bad, whose velocity the estimate needs, or if the vehicle needed more than
       ``MAX_LEAN_FRACTION`` of the largest lean that its parameters allow, in air that was not calm;
    3. "good" if it needed less of that lean, if the air was calm, or if no parameter limits the lean but the interval
       of the mean speed is narrow (:func:`mavdem.wind_velocity.beaufort.is_speed_known`);
    4. "unknown", with the figures of the estimate, if the speed is known only roughly.

    Args:
        evidence: signals, events and measurements of the vehicle.
        estimator: the fact of the light "estimator", which judges the state estimator.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown. Where the speed is identified, it
        has these figures:

        - ``speed``: the mean of the speeds, m/s.
        - ``low``, ``high``: its interval, m/s; in calm air that of the vector mean.
        - ``gust``: the speed of gusts, m/s.
        - ``direction``: degrees; None if it is not identified.
        - ``share``: the fraction of the largest lean that the vehicle needed; 0 if it is not known.
        - ``is_rough``: whether the speed is known only roughly.
        - ``by_usual_drag``: whether the drag is assumed to be that of typical multirotors.
        - ``reason``: the bad estimator, or why the speed is known only roughly.
        - ``turned_from``, ``turned_to``: the first and last direction, degrees, if the wind turned so far that its mean
          misleads; then also ``turned_past``, the direction between them that lies farthest from the first, or None if
          the last one does.
        - ``name``: the message with the vehicle's velocity, if that is of a spare core of the estimator.
    """
    if evidence.other_vehicle is not None:
        return evidence.other_vehicle
    drifts = [event for event in evidence.events if event.code is MotionEvent.CARRIED_AWAY]
    if drifts:
        return max(drifts, key=lambda drift: drift.figures["distance"])
    wind = evidence.wind.estimate
    if wind is None:
        return Fact(WindLight.WIND_NOT_KNOWN, reason=evidence.wind.reason)
    if not wind.speed_identifiable:
        return Fact(WindLight.WIND_NOT_KNOWN, reason=wind.reasons["speed"])
    # The velocity of calm air may be 0, and its speed may not.
    interval = wind.speed_interval if wind.calm else wind.mean_speed_interval
    lowest_speed, highest_speed = interval
    lean_fraction = _lean_fraction(evidence.condition, evidence.flown_parameters)
    is_rough = not is_speed_known(interval)
    level = _level_of_wind(wind, lean_fraction, estimator, is_rough=is_rough)
    reason: Fact | None = None
    if estimator.is_bad:
        reason = estimator
    elif level is Level.UNKNOWN:
        reason = wind.reasons.get("speed")
    fact = Fact(
        WindLight.WIND_BLEW,
        level,
        calm=wind.calm,
        speed=wind.mean_speed,
        low=lowest_speed,
        high=highest_speed,
        gust=wind.gust,
        direction=wind.direction if wind.direction_identifiable else None,
        share=lean_fraction,
        is_rough=is_rough,
        # The interval allows for the drag of typical multirotors, not for that of any vehicle.
        by_usual_drag=wind.drag.source is DragSource.POPULATION,
        reason=reason,
    )
    if wind.turn is not None:
        fact = fact.replace(
            turned_from=wind.turn.start_direction,
            turned_to=wind.turn.end_direction,
            turned_past=wind.turn.farthest_direction,
        )
    velocity_message = _velocity_message_of_spare_core(evidence.signals.telemetry)
    if velocity_message is not None:
        fact = fact.replace(name=velocity_message)
    return fact


def _level_of_wind(
    wind: WindVelocity, lean_fraction: float, estimator: Fact, *, is_rough: bool
) -> Level:
    """Returns the level of a wind whose speed is identified: whether the vehicle had enough lean in reserve.

    Args:
        wind: the mean wind.
        lean_fraction: fraction of the largest lean that the vehicle needed; 0 if that is not known.
        estimator: the fact of the light "estimator", whose velocity the estimate of the wind needs.
        is_rough: whether the speed is known only roughly.
    """
    if estimator.is_bad:
        return Level.WATCH
    if lean_fraction > MAX_LEAN_FRACTION and not wind.calm:
        return Level.WATCH
    # Either the vehicle had enough lean in reserve, or the speed says enough without it.
    if lean_fraction > 0 or not is_rough:
        return Level.GOOD
    return Level.UNKNOWN


def _velocity_message_of_spare_core(telemetry: Telemetry) -> str | None:
    """Returns the name of the message with the vehicle's velocity, if that is of a spare core of the estimator.

    ArduPilot runs several instances ("cores") of its estimator. The wind is estimated from the velocity of the primary
    one. If the log lacks that, the velocity of another core was read instead, which is among the repairs of the log.

    Args:
        telemetry: messages of the vehicle, and the repairs that were made as the log was read.

    Returns:
        Name of the message in the log; None if the velocity is of the primary core.
    """
    name = telemetry.name_in_source("LOCAL_POSITION_NED")
    for repair in telemetry.repairs:
        if repair.code is Repair.OTHER_CORE_READ and name in repair.figures["names"]:
            return name
    return None


def _lean_fraction(condition: Condition, parameters: Parameters) -> float:
    """Returns the fraction of its largest lean that the vehicle needs to hold against the wind.

    The lean is the length of the vector of mean roll and pitch in settled flight, rad.

    Args:
        condition: condition of the vehicle, with its mean lean.
        parameters: parameters of the autopilot in flight, one of which limits the lean, such as ANGLE_MAX.

    Returns:
        Mean lean over the limit; 0 if lean or limit is not known.
    """
    limit = lean_limit(parameters)
    if limit is None:
        return 0.0
    # Roll and pitch, rad; without settled flight there is none, and the length is 0.
    mean_angles = [angle.mean for angle in condition.lean.values()]
    return hypot(*mean_angles) / limit


def lean_limit(parameters: Parameters) -> float | None:
    """Returns the largest lean that the autopilot allows, rad; None if no parameter limits it.

    Args:
        parameters: known parameters of the autopilot; one of ``LEAN_LIMIT_PARAMETERS`` limits it.
    """
    for name, degrees_per_unit in LEAN_LIMIT_PARAMETERS.items():
        limit_degrees = parameters.get(name, 0.0) * degrees_per_unit
        if 0 < limit_degrees < inf:
            return radians(limit_degrees)
    return None
