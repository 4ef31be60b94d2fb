"""Status light of the wind, a fact (a coded finding): its speed, and the share of the largest lean that it needs."""

from math import hypot, inf, radians
from typing import Any

from mavdem.assessment.condition import Condition
from mavdem.assessment.evidence import Evidence
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.sources import Repair
from mavdem.facts.wind import WindLight
from mavdem.ingest.telemetry import Parameters, Telemetry

LEAN_LIMIT_PARAMETERS = {"ANGLE_MAX": 0.01, "ATC_ANGLE_MAX": 1.0, "MPC_TILTMAX_AIR": 1.0}
"""Parameters with the largest lean, and the factor that converts them to degrees."""

MAX_LEAN_SHARE = 0.5
"""Share of the largest lean that the mean wind may take: as much again is left for gusts and for motion against it."""


def wind_light(evidence: Evidence, estimator: Fact) -> Fact:
    """Returns the mean wind with its interval; unknown if the flight does not identify its speed.

    A wind that carried the vehicle away is the light, whatever its speed.

    The wind is estimated from how far the vehicle leans to hold its position. The level is "watch" if that takes more
    than ``MAX_LEAN_SHARE`` of the largest allowed lean, or if the estimator is bad, whose velocity the estimate needs.
    It is "unknown", with the figures of the estimate, if part of the lean may have another cause than wind.

    Args:
        evidence: signals, events and measurements of the vehicle.
        estimator: the fact of the light "estimator", which judges the state estimator.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown. That of a known wind has ``speed``,
        its interval ``low`` to ``high`` (m/s), ``direction``, None if that is not identified, and the ``share`` of the
        lean.
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
    lowest_speed, highest_speed = wind.speed_interval
    lean_share = _lean_share(evidence.condition, evidence.signals.telemetry)
    takes_much_lean = lean_share > MAX_LEAN_SHARE and not wind.calm
    if estimator.is_bad or takes_much_lean:
        level: Level | None = Level.WATCH
    elif wind.may_be_lean:
        # A load, or an autopilot that is mounted askew, may cause part of the lean.
        level = Level.UNKNOWN
    else:
        # The fact then has the usual level of its code, good.
        level = None
    return Fact(
        WindLight.WIND_BLEW,
        level,
        calm=wind.calm,
        speed=wind.speed,
        low=lowest_speed,
        high=highest_speed,
        direction=wind.direction if wind.direction_identifiable else None,
        share=lean_share,
        reason=estimator if estimator.is_bad else None,
        **_other_core(evidence.signals.telemetry),
    )


def _other_core(telemetry: Telemetry) -> dict[str, Any]:
    """Returns a further figure of the wind if the velocity for it is not that of the estimator's primary core.

    ArduPilot runs several instances ("cores") of its estimator. If the log lacks the primary one, the velocity of
    another core was read, which the light then states.

    Args:
        telemetry: messages of the vehicle, and the repairs that were made as they were read.

    Returns:
        The name of the velocity's message in the log as ``name``; empty if the primary core was read.
    """
    name = telemetry.name_in_source("LOCAL_POSITION_NED")
    is_other_core = any(
        name in repair.figures["names"]
        for repair in telemetry.repairs
        if repair.code is Repair.OTHER_CORE_READ
    )
    return {"name": name} if is_other_core else {}


def _lean_share(condition: Condition, telemetry: Telemetry) -> float:
    """Returns the share of its largest lean that the vehicle needs to hold against the wind.

    The lean is the length of the vector of mean roll and pitch in settled flight, rad.

    Args:
        condition: condition of the vehicle, with its mean lean.
        telemetry: parameters of the autopilot, of which one limits the lean.

    Returns:
        Mean lean over the limit; 0 if lean or limit is not known.
    """
    limit = lean_limit(telemetry.parameters)
    if limit is None:
        return 0.0
    return hypot(*(lean.mean for lean in condition.lean.values())) / limit


def lean_limit(parameters: Parameters) -> float | None:
    """Returns the largest lean that the autopilot allows, rad; None if no parameter limits it.

    Args:
        parameters: parameters of the autopilot that are known, of which one of ``LEAN_LIMIT_PARAMETERS`` limits it.
    """
    for name, degrees_per_unit in LEAN_LIMIT_PARAMETERS.items():
        limit = parameters.get(name, 0.0) * degrees_per_unit
        if 0 < limit < inf:
            return radians(limit)
    return None
