"""The light of the estimator: innovations in flight against what the filter accepts, and the quality of GPS."""

from collections.abc import Iterator

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.limits import worst
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dataset.intervals import longest_true_duration
from mavdem.dataset.time_series import (
    TimeSeries,
    clean_series,
    float_column,
    float_columns,
    recorded_series,
)
from mavdem.facts import Fact, Level
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.events import Reported
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import mavlink_constant

FIX_3D = mavlink_constant("GPS_FIX_TYPE_3D_FIX")
"""The least GPS fix type with a position in three dimensions."""

MEASURED = ("velocity", "position", "height", "compass")
REPORTS = {
    "EKF_STATUS_REPORT": (
        "velocity_variance",
        "pos_horiz_variance",
        "pos_vert_variance",
        "compass_variance",
    ),
    "ESTIMATOR_STATUS": ("vel_ratio", "pos_horiz_ratio", "pos_vert_ratio", "mag_ratio"),
}
"""Messages with the innovations of ``MEASURED``, as shares of what the filter accepts."""
GLITCH = {
    "EKF_STATUS_REPORT": mavlink_constant("EKF_GPS_GLITCHING"),
    "ESTIMATOR_STATUS": mavlink_constant("ESTIMATOR_GPS_GLITCH"),
}
"""Bits of their flags that say that GPS jumped."""
EKF_THRESHOLD = 0.8
"""Innovation from which ArduCopter's ``ekf_check.cpp`` doubts the filter, the default of FS_EKF_THRESH; PX4 at 1."""
DOUBT_SECONDS = 1.0  # as long it lasts there until the failsafe
POOR_DILUTION = 2.5
FEW_SATELLITES = 6
"""HDOP above, satellites below which PX4's filter does not start with GPS: EKF2_REQ_HDOP, EKF2_REQ_NSATS."""
FIELD_CHANGE = 0.3  # of the compass's field, by motors and currents, up to which ArduPilot's pages take it for good
OF_ESTIMATOR = {
    Reported.ESTIMATOR_DIVERGED,
    Reported.ESTIMATOR_SWITCHED,
    Reported.ESTIMATOR_RESET,
    Reported.GPS_JUMPED,
    Reported.GPS_LOST,
    Reported.SENSOR_FAILED,
}


def estimator_light(evidence: Evidence) -> Fact:
    """Returns the worst of filter and GPS in flight; unknown where the log has neither."""
    innovations = sorted(_filter(evidence), key=lambda fact: -fact.figures["duration"])
    doubts = [
        *innovations,
        *_fixes(evidence),
        *_compass(evidence),
        *evidence.reported(OF_ESTIMATOR),
    ]
    airborne = evidence.learnability.figures.airborne
    return worst(doubts) if doubts else Fact(EstimatorLight.ESTIMATOR_UNMEASURED, airborne=airborne)


def _filter(evidence: Evidence) -> Iterator[Fact]:
    """By ArduCopter's rule: two of velocity, which counts twice from twice the limit, position and compass."""
    telemetry = evidence.signals.telemetry
    limit = 1.0
    if telemetry.autopilot != "PX4":
        limit = telemetry.parameters.get("FS_EKF_THRESH", 0.0) or EKF_THRESHOLD
    for part in evidence.flown(_innovations(telemetry)):
        ratios = part.values[:, : len(MEASURED)]
        beyond = ratios >= limit
        velocity, position, _, compass = beyond.T
        doubts = 1.0 * velocity + (ratios[:, 0] >= 2 * limit) + position + compass
        failed = longest_true_duration(part.time, doubts >= 2)
        lasting = [longest_true_duration(part.time, column) for column in beyond.T]
        most = np.argmax(lasting) if max(lasting) else ratios.max(axis=0).argmax()
        is_doubted = max(lasting) >= DOUBT_SECONDS
        yield Fact(
            EstimatorLight.FILTER_DOUBTED if is_doubted else EstimatorLight.FILTER_AGREED,
            Level.BAD if is_doubted and failed >= DOUBT_SECONDS else None,
            time=part.time[ratios[:, most].argmax()],
            name=MEASURED[most],
            ratio=ratios[:, most].max() / limit,
            duration=lasting[most],
        )
        if np.any(glitches := part.values[:, -1]):
            yield Fact(
                EstimatorLight.GPS_GLITCHED,
                time=part.time[glitches.argmax()],
                duration=longest_true_duration(part.time, glitches > 0),
            )


def _innovations(telemetry: Telemetry) -> TimeSeries | None:
    """Those of ``MEASURED``, 0 where there is none, and whether GPS jumped, (N, 5)."""
    for name, fields in REPORTS.items():
        report = telemetry.messages.get(name, {})
        if all(field in report for field in fields):
            flags = (
                float_column(report, "flags")
                if "flags" in report
                else np.zeros(len(report["time"]))
            )
            jumped = np.nan_to_num(flags).astype(np.int64) & GLITCH[name] > 0
            ratios = np.nan_to_num(float_columns(report, fields))
            if ratios.any():  # else the filter does not run
                return clean_series(report, np.column_stack([ratios, jumped]))
    return None


def _fixes(evidence: Evidence) -> Iterator[Fact]:
    """Of GPS, where it ever had a fix in flight."""
    telemetry = evidence.signals.telemetry
    report = recorded_series(telemetry, "GPS_RAW_INT", "fix_type", "satellites_visible", "eph")
    for part in evidence.flown(report):
        fixed = part.values[part.values[:, 0] >= FIX_3D]
        if not len(fixed):
            continue
        _, satellites, dilution = np.median(fixed, axis=0).tolist()
        if satellites < FEW_SATELLITES or dilution > 100 * POOR_DILUTION:
            yield Fact(
                EstimatorLight.FIX_POOR,
                satellites=int(satellites),
                dilution=dilution / 100,
            )


def _compass(evidence: Evidence) -> Iterator[Fact]:
    """Of its field, where it is another in the first flight than on the ground before."""
    for message in ("SCALED_IMU", "RAW_IMU"):
        field = recorded_series(evidence.signals.telemetry, message, "xmag", "ymag", "zmag")
        for flight in evidence.flown(field):
            assert field is not None
            before = (field.boot == flight.boot[0]) & (field.time < flight.time[0])
            usual = _size(field.values[before])
            if len(usual) < MIN_SAMPLES_FOR_STATISTICS:
                return
            change = np.median(_size(flight.values)) / np.median(usual) - 1
            if abs(change) > FIELD_CHANGE:
                yield Fact(EstimatorLight.COMPASS_DISTURBED, change=change)
            return


def _size(field: Array) -> Array:
    """(N,) of a field (N, 3), where it was measured."""
    size = np.linalg.norm(field, axis=1)
    return size[size > 0]
