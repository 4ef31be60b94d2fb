"""Models of the JSON documents of ``mavdem diff`` and ``mavdem track``: what changed of a vehicle, and a fleet."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mavdem.containers import JsonValues
from mavdem.documents.document import Document, SentenceAndFact, SentenceText
from mavdem.fleet.difference import BaselineDifferences
from mavdem.fleet.tracking import TrackedLogs
from mavdem.units import (
    Acceleration,
    AngularAcceleration,
    Number,
    ParameterValue,
    PerSecondOrSeconds,
    Radians,
    UtcText,
    Volts,
)


class Quantity(Document):
    """Which quantity is compared."""

    kind: str
    """share, effect, mean effect, damping, lag, phase margin, gain margin, maximum sensitivity, overshoot or rise"""
    motor: int
    """number of the motor, from 1; 0 for none"""
    axis: str
    """roll, pitch or yaw; empty for none"""


class Change(Document):
    """One quantity that is known before and after, A and B."""

    quantity: Quantity
    """which quantity"""
    before: PerSecondOrSeconds
    """mean of A; of shares and effects of motors relative to the median motor, 0 if equal"""
    after: PerSecondOrSeconds
    """mean of B, likewise"""
    difference: PerSecondOrSeconds
    """B less A; relative for shares, effects, maximum sensitivity and rise"""
    half_width: PerSecondOrSeconds
    """half width of its 90 % interval; linearized where the difference is relative"""
    interval: list[PerSecondOrSeconds]
    """ends of its 90 % interval, by the statistic of p"""
    p: Number
    """probability of a difference as large if nothing changed"""
    allowance: PerSecondOrSeconds
    """standard deviation of what other conditions may do to it"""
    outcome: str
    """changed, same or uncertain"""
    difference_without_lean: Number
    """of a trim, the difference without the part that lean makes; null where that is not known"""
    is_explained_by_lean: bool
    """whether lean makes most of a changed or doubtful trim, so that it is no change of the vehicle"""


class Incomparable(Document):
    """One quantity that is not known in both A and B."""

    quantity: SentenceText
    """name of the quantity"""
    reason: SentenceAndFact
    """why it cannot be compared"""


class FlightConditions(Document):
    """Mean conditions of the flights of A or of B."""

    voltage: Volts
    """mean voltage"""
    collective: Number
    """mean output of all motors, as a share of their range"""
    lean_roll: Radians
    """mean roll"""
    lean_pitch: Radians
    """mean pitch"""
    tilt_sd: Radians
    """standard deviation of the angle from level"""
    vibration: Acceleration
    """mean vibration of the first IMU along its worst axis"""
    wind_torque: dict[str, AngularAcceleration]
    """standard deviation of the wind torque, by axis"""
    step_sources: dict[str, list[str]]
    """where overshoot and the time from 10 to 90 % come from, by axis: measured, identified_loop, or both"""


class Difference(Document):
    """What differs between the flights of A, such as a baseline, and those of B."""

    vehicles: list[list[str]]
    """names in A and in B"""
    shared: list[str]
    """names that several vehicles may have"""
    motors: list[str]
    """names of the motors"""
    flights: list[int]
    """number of logs of A and of B"""
    false_discovery_rate: float
    """bound of the expected share of false ones among a family's tested changes, averaged over families with any"""
    axes_with_other_gains: list[str]
    """axes whose rate loop has other gains or filters in B: its figures are not tested"""
    axes_with_other_attitude_gains: list[str]
    """axes whose gain from attitude to rate differs in B: figures of the attitude loop are not tested"""
    level: float
    """level of the intervals"""
    changes: list[Change]
    """quantities that are known in both"""
    incomparable: list[Incomparable]
    """quantities that are not known in both"""
    conditions: list[FlightConditions]
    """conditions of A and of B"""


class ParameterChange(Document):
    """A parameter that somebody set to another value in B."""

    name: str
    """name of the parameter"""
    before: ParameterValue
    """value in A"""
    after: ParameterValue
    """value in B"""


class MotorHealthOfFlight(Document):
    """The motors of a flight, judged beside other flights of the vehicle."""

    health: str
    """ok, drift, fault or unknown"""
    code: str | None
    """code of the reason"""
    sentence: SentenceText
    """the reason"""
    fault_probability: Number
    """probability that a motor works 8 % harder or more; null where it was not judged"""
    suspect_motor: int | None
    """number of the suspected motor, from 1; null where none is named"""


class Diff(Difference):
    """`--json` of diff."""

    parameters: list[ParameterChange]
    """parameters that somebody set to other values in B, those of control first; of two logs"""

    headlines: dict[str, str | None]
    """headline of the latest flight of a and of b, its motors judged beside other flights; null where it has none"""
    motor_health: dict[str, MotorHealthOfFlight | None]
    """motors of the latest flight of a and of b, judged by the flights of both"""
    common_files: list[str]
    """files of the flights that A and B have in common; they count on one side alone"""
    a: str
    """A as on the command line"""
    b: str
    """B as on the command line"""


class FailedLog(Document):
    """A log without a flight."""

    file: str
    """name of the log"""
    status: SentenceText
    """why there is no flight"""
    status_code: str | None
    """the same as a code"""


class SinceBaseline(Document):
    """The latest flight of a vehicle, compared with its baseline."""

    file: str
    """log of the latest flight"""
    date: UtcText | None
    """date of the latest flight"""
    found: Difference | None
    """what differs from the baseline"""


class VehicleMotors(Document):
    """The motors of a vehicle, in its latest flight that was judged beside others."""

    health: str
    """ok, drift, fault or unknown"""
    sentence: str
    """what speaks for it; of motors without a drift or a fault, what is said of the latest flight"""
    next_step: str
    """what to do next about the vehicle; empty for nothing"""


class Track(Document):
    """`--json` of track."""

    fleet: str
    """folder of the fleet"""
    index: str
    """its page"""
    logs: int
    """number of logs that LOGS name"""
    read: int
    """number of these that were read now"""
    flights: int
    """number of flights in the fleet"""
    vehicles: int
    """number of vehicles with a name of their own"""
    tiers: dict[str, int]
    """number of logs by tier"""
    health: dict[str, int]
    """number of logs by health"""
    motor_health: dict[str, VehicleMotors]
    """motors of each vehicle"""
    failed: list[FailedLog]
    """logs without a flight"""
    vehicle_names: dict[str, str]
    """names that were given to vehicles, by what their logs call them"""
    since_baseline: dict[str, SinceBaseline]
    """latest flight of each vehicle beside the baseline"""


def track_document(
    fleet: Path,
    page: Path,
    tracked: TrackedLogs,
    counts: JsonValues,
    changes: BaselineDifferences,
    vehicle_names: Mapping[str, str],
) -> Track:
    """Makes the document of a run of ``mavdem track``.

    Args:
        fleet: folder of the fleet.
        page: page of the fleet.
        tracked: result of the run.
        counts: values of the further keys of ``Track``: numbers of flights and vehicles, logs by tier and by health,
            the judgement of the motors of each vehicle, and the logs without a flight.
        changes: first row of the latest flight, and its differences from the baseline, by vehicle.
        vehicle_names: names that were given to vehicles.

    Returns:
        The document.
    """
    since_baseline = {}
    for vehicle, (latest_row, difference) in changes.items():
        # The row as a dictionary has its date as text.
        date = latest_row.as_dict()["date"]
        since_baseline[vehicle] = SinceBaseline.from_results(
            latest_row, date=date, found=difference
        )
    return Track.from_results(
        tracked,
        **counts,
        fleet=str(fleet),
        index=str(page),
        vehicle_names=vehicle_names,
        since_baseline=since_baseline,
    )
