"""Status light of vibration: acceleration and clipping of each IMU against the limits of its autopilot."""

from typing import Any

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flights import loss_onset, settled_flight
from mavdem.assessment.limits import LEVELS_BY_SEVERITY, Limits
from mavdem.dataset.segments import in_segments
from mavdem.facts import Fact
from mavdem.facts.vibration import VibrationLight
from mavdem.ingest.telemetry import Telemetry
from mavdem.vibration.vibration_message import (
    LEVEL_FIELDS,
    measures_acceleration,
    reported_vibration,
)

ARDUPILOT_LEVELS = Limits(15.0, 30.0)
"""Mean vibration, m/s², of ArduPilot's message VIBE.

Source: https://ardupilot.org/copter/docs/common-measuring-vibration.html.
"""

PX4_LEVELS = Limits(4.905, 9.81)
"""Mean vibration, m/s², of PX4's ``accel_vibration_metric``.

Source: https://github.com/PX4/flight_review, app/plot_app/configured_plots.py.
"""

CLIP_LIMITS = Limits(0, 100)
"""Number of clips of one IMU in a flight: ArduPilot's page on vibration calls fewer than 100 acceptable."""


def vibration_limits(telemetry: Telemetry) -> Limits:
    """Returns the limits, m/s², of the autopilot: ArduPilot and PX4 measure vibration in different ways."""
    return PX4_LEVELS if telemetry.autopilot == "PX4" else ARDUPILOT_LEVELS


def vibration_light(evidence: Evidence) -> Fact:
    """Judges the vibration that the autopilot itself measured; unknown if it was not recorded.

    Two figures are compared with limits, and the worse level is the level of the light. One is the largest mean level
    of all IMUs and axes, m/s², with the limits of the autopilot (:func:`vibration_limits`). The other is the largest
    number of clips of an IMU, which are samples outside its range. Both are of settled flight or, if there is none, of
    all free flight. A flight ends when the vehicle was lost, since an impact clips every accelerometer.

    If more clips than the limit are outside settled flight, for example by a loose propeller, the clips of all free
    flight are used instead, and the fact has the figure ``has_clipped_unsettled``. The vibration level is still
    measured in settled flight. If a figure is not of settled flight alone, the fact ends with the loss of the vehicle.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact whose level is the colour of the light: good, watch, bad or unknown. Of several IMUs its figure
        ``imu_levels`` has the mean level of each, along the axis that vibrates most, m/s².
    """
    signals = evidence.signals
    telemetry = signals.telemetry
    vibration = reported_vibration(signals)
    if vibration is None or not measures_acceleration(telemetry):
        return _unknown_vibration(telemetry)
    levels = vibration.levels
    settled_segments = settled_flight(signals)
    free_flight = evidence.flight_segments(levels.boot)
    is_in_segment = in_segments(levels, *(settled_segments or free_flight))
    if not is_in_segment.any():
        return _unknown_vibration(telemetry)
    mean_levels = levels.values[is_in_segment].mean(axis=0)
    largest_level = mean_levels.max()
    # The columns are the axes of IMU 1, then those of IMU 2: of three axes, column 4 from 0 is the second of IMU 2.
    imu_index, axis_index = divmod(mean_levels.argmax(), len(vibration.axes))
    clips = vibration.most_clips(is_in_segment)
    clips_in_free_flight = vibration.most_clips(in_segments(levels, *free_flight))
    # Landings and fast manoeuvres cause a few clips outside settled flight; so many show a fault.
    has_clipped_unsettled = clips_in_free_flight - clips > CLIP_LIMITS.bad
    if has_clipped_unsettled:
        clips = clips_in_free_flight
    limits = vibration_limits(telemetry)
    level_by_vibration = limits.level(largest_level)
    level_by_clips = CLIP_LIMITS.level(clips)
    optional_figures: dict[str, Any] = {}
    # One level per IMU: along the axis that vibrates most.
    levels_of_imus = vibration.largest_of_axes(mean_levels).tolist()
    if len(levels_of_imus) > 1:
        optional_figures["imu_levels"] = levels_of_imus
    if has_clipped_unsettled:
        optional_figures["has_clipped_unsettled"] = True
    # Settled flight is over before a loss, so only other figures end with it.
    is_of_settled_flight = settled_segments and not has_clipped_unsettled
    ending = None if is_of_settled_flight else evidence.ending
    return Fact(
        VibrationLight.VIBRATION_MEASURED,
        max(level_by_vibration, level_by_clips, key=LEVELS_BY_SEVERITY.index),
        end_time=None if ending is None else loss_onset(ending),
        subject=f"IMU {imu_index + 1}",
        axis=vibration.axes[axis_index],
        vibration=largest_level,
        acceptable_vibration=limits.bad if largest_level > limits.bad else limits.watch,
        clips=clips,
        is_settled=bool(settled_segments),
        **optional_figures,
    )


def _unknown_vibration(telemetry: Telemetry) -> Fact:
    """Returns the fact (coded finding) that the vibration is unknown, with the reason if the messages show one.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        The fact. It has the figure ``is_of_velocity`` if the autopilot is an old PX4, which reports increments of the
        velocity and no accelerations; or ``is_zero`` if all reported levels are 0, so that nothing was measured.
        Otherwise it has neither: no vibration was reported in flight.
    """
    fact = Fact(VibrationLight.VIBRATION_UNKNOWN, recorder=telemetry.translated_from)
    reports_velocity_increments = not measures_acceleration(telemetry)
    if reports_velocity_increments:
        return fact.replace(is_of_velocity=True)
    if _is_zero_throughout(telemetry):
        return fact.replace(is_zero=True)
    return fact


def _is_zero_throughout(telemetry: Telemetry) -> bool:
    """Returns whether the message VIBRATION was logged, but its levels are always 0: they were not measured.

    Args:
        telemetry: messages of the vehicle.
    """
    columns = telemetry.messages.get("VIBRATION", {})
    levels_of_axes = [columns[field] for field in LEVEL_FIELDS if field in columns]
    return bool(levels_of_axes) and not np.any(levels_of_axes)
