"""Inventory of a log before learning: its components, rates and damage, and for each vehicle what the log holds."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from mavdem.assessment.autopilot_messages import reported_problems
from mavdem.assessment.condition import Condition, measure_condition
from mavdem.assessment.identity import Identity, identify_vehicle
from mavdem.assessment.repeated_reports import merge_repeats
from mavdem.assessment.status_texts import SEVERITIES
from mavdem.assessment.tier import log_tier
from mavdem.containers import JsonValues
from mavdem.dataset.learnability import learnability_of
from mavdem.dataset.segment_learnability import Learnability
from mavdem.dataset.signals import Signals
from mavdem.ingest import Component, Log
from mavdem.ingest.telemetry import Columns, Telemetry, rate_without_gaps, selected_rows

MIN_MESSAGES_FOR_STEP = 50
"""Number of messages of a stream from which on the usual step between them is known."""

STEP_JITTER = 0.25
"""Jitter of the time step between messages, as a fraction of it: a step up to 1.75 times as long lacks no message.

The ratio of a step to the usual one is reduced by this before it is rounded, so that 1.5 + 0.25 is the limit.
"""

MIN_STEP = 1e-9
"""Shortest step between two messages of a stream, s: a nanosecond, the resolution of the finest stamps (ROS 2)."""

MIN_MEAN_RATE_FRACTION = 1 / 4
"""Mean rate, as a fraction of the rate without gaps, below which a stream is in bursts and its rate is the mean."""


class VehicleContents(NamedTuple):
    """What a log holds of one vehicle before learning."""

    telemetry: Telemetry
    """Its messages and parameters."""
    learnability: Learnability
    """Whether a model can be learned, with the rates of the streams."""
    condition: Condition
    """Motor balance, lean, vibration and battery."""
    identity: Identity
    """Name, type, firmware and board."""


def inventory(log: Log, vehicles: Sequence[VehicleContents] | None = None) -> JsonValues:
    """Returns the contents of a log as the JSON object of ``mavdem info``: senders, vehicles, unread messages.

    Two figures, both between 0 and 1, show whether a link lost messages:

    - ``lost_share`` of each sender ("speaker"): the fraction of its MAVLink sequence numbers that are not in the log.
      It is also high if the log was written with some kinds of messages left out.
    - ``missing_share`` of a sender that is a vehicle: the fraction of messages that its periodic streams should contain
      by their usual time step, but do not; the median over the streams, None if there are none. It is also high if a
      stream changed its rate.

    A link loses messages of all kinds equally, which increases both. So a loss is certain only if both are high.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        vehicles: contents of the vehicles to report; None for all vehicles of the log.

    Returns:
        Values by the keys of the document; times in s, rates in Hz.
    """
    if vehicles is None:
        vehicles = [vehicle_contents(telemetry, log) for telemetry in log.vehicles]
    missing_fractions = {
        (telemetry.system, telemetry.component): _missing_fraction(telemetry)
        for telemetry in log.vehicles
    }
    vehicle_values = [_vehicle_values(vehicle) for vehicle in vehicles]
    unread = []
    for frames in log.unread:
        frame_values = asdict(frames)
        # The document calls the number of all frames "of".
        frame_values["of"] = frame_values.pop("total")
        frame_values["cause"] = frames.cause.replace("_", " ")
        unread.append(frame_values)
    return {
        "source": log.source,
        "frames": log.frames,
        "bytes_skipped": log.bytes_skipped,
        "receive_time": log.receive_time,
        "unread": unread,
        "speakers": [
            _component_values(
                component, missing_fractions.get((component.system, component.component))
            )
            for component in log.components
        ],
        "vehicles": vehicle_values,
        "learnable": any(vehicle.learnability.learnable for vehicle in vehicles),
    }


def vehicle_contents(telemetry: Telemetry, log: Log) -> VehicleContents:
    """Returns what a log contains of one vehicle, before anything is learned from it.

    Args:
        telemetry: messages and parameters of the vehicle.
        log: the log of the flight, with all components that sent messages and the times of reception.
    """
    signals = Signals(telemetry)
    learnability = learnability_of(signals, log.components)
    identity = identify_vehicle(signals, log.receive_time[0])
    return VehicleContents(telemetry, learnability, measure_condition(signals), identity)


def autopilot_alarms(telemetry: Telemetry) -> list[JsonValues]:
    """Lists the warnings of the autopilot: of its texts and, in DataFlash logs, of the messages ERR and EV.

    Args:
        telemetry: messages of the vehicle.

    Returns:
        A dictionary for each warning, the most severe first, then by time: name of its ``severity``, ``text``, ``time``
        in s since boot, number of the ``boot``, and ``count``, how often it was sent. A warning without a severity gets
        the least one.
    """
    alarms = []
    for fact in merge_repeats(reported_problems(telemetry)):
        if fact.is_good:
            continue
        alarms.append(
            {
                "severity": fact.figures.get("severity") or SEVERITIES[-1],
                "text": fact.figures.get("text") or fact.sentence,
                "time": fact.time,
                "boot": fact.figures["boot"],
                "count": fact.figures["count"],
            }
        )
    return sorted(alarms, key=lambda alarm: SEVERITIES.index(alarm["severity"]))


def _component_values(component: Component, missing_share: float | None) -> JsonValues:
    """Returns the counts of messages that a MAVLink component sent and that were lost, as values of a document.

    Args:
        component: counts of a component's messages.
        missing_share: fraction of the samples of its streams that are missing; None if it is not a vehicle.

    Returns:
        MAVLink ids of ``system`` and ``component``, its ``kind``, number of ``messages``, number ``lost`` by the
        sequence numbers, ``lost_share`` (lost of all that were sent), and ``missing_share``.
    """
    message_count = sum(component.messages.values())
    return {
        "system": component.system,
        "component": component.component,
        "kind": component.kind,
        "messages": message_count,
        "lost": component.lost,
        "lost_share": component.lost / max(component.lost + message_count, 1),
        "missing_share": missing_share,
    }


def _vehicle_values(vehicle: VehicleContents) -> JsonValues:
    """Returns what a log contains of one vehicle, as values of a JSON document.

    Args:
        vehicle: telemetry, learnability, condition and identity of the vehicle.

    Returns:
        Values by key:

        - ``system``, ``component``, ``vehicle``, ``autopilot``, ``identity``: MAVLink ids, types and names.
        - ``translated_from``: format of a log that is not MAVLink, such as DataFlash.
        - ``messages``: by name, their ``count`` and ``rate`` in Hz; ``names``: their names in the log's own format.
        - ``parameters``, ``boots``: number of parameters, and of starts of the autopilot.
        - ``segments``: segments of settled flight, on which a model can be trained.
        - ``repairs``: corrections that the reader made to the data.
        - ``verdict``: whether a model can be learned, and if not, why.
        - ``tier`` with its reason and further keys: which kind of model the rates of the log allow.
        - ``condition``: condition of the vehicle.
        - ``autopilot_alarms``: warnings of the autopilot.
    """
    telemetry, learnability, condition, identity = vehicle
    boots = set[int]()
    messages = {}
    names_in_log = {}
    for name, columns in sorted(telemetry.messages.items()):
        boots.update(np.unique(columns["boot"]).tolist())
        messages[name] = {"count": len(columns["time"]), "rate": _message_rate(columns)}
        if name in telemetry.source_names:
            names_in_log[name] = telemetry.source_names[name]
    return {
        "system": telemetry.system,
        "component": telemetry.component,
        "vehicle": telemetry.vehicle,
        "autopilot": telemetry.autopilot,
        "translated_from": telemetry.translated_from,
        "names": names_in_log,
        "parameters": len(telemetry.parameters),
        "messages": messages,
        "boots": len(boots),
        "segments": learnability.segments,
        "repairs": telemetry.repairs,
        "verdict": learnability,
        **log_tier(learnability, condition)._asdict(),
        "identity": identity,
        "condition": condition,
        "autopilot_alarms": autopilot_alarms(telemetry),
    }


def _message_rate(columns: Columns) -> float | None:
    """Returns the rate at which a message was recorded.

    It is the rate between gaps, since an outage of the link does not change how often a message is sent. If the mean
    rate is less than ``MIN_MEAN_RATE_FRACTION`` of the rate between gaps, the message comes in bursts, and the mean
    rate is returned. If several instances send the message, each on its port or in its group, only the most frequent
    one counts.

    Args:
        columns: the message, with (N,) times in s, boots and other fields.

    Returns:
        The rate, Hz; None if the message does not come twice in a boot.
    """
    for field in columns.keys() & {"port", "group_mlx"}:
        # The index of the instance of each row among all instances.
        instances, instance_of_row = np.unique(columns[field], return_inverse=True)
        if len(instances) > 1:
            most_frequent = np.bincount(instance_of_row).argmax()
            columns = selected_rows(columns, instance_of_row == most_frequent)
    is_within_boot = np.diff(columns["boot"]) == 0
    steps = np.diff(columns["time"])[is_within_boot]
    # Messages of several sensors of a kind have the same stamp: such steps of 0 are left out.
    steps = steps[steps > MIN_STEP]
    if not len(steps):
        return None
    rate_between_gaps = rate_without_gaps(steps)
    mean_rate = 1 / steps.mean()
    comes_in_bursts = mean_rate <= MIN_MEAN_RATE_FRACTION * rate_between_gaps
    return mean_rate if comes_in_bursts else rate_between_gaps


def _missing_fraction(telemetry: Telemetry) -> float | None:
    """Returns the fraction of the messages that are missing from the periodic streams of a vehicle.

    In a step of n times the usual one, n − 1 messages are missing. The usual step is the mean of the middle half of the
    steps, and not the median, since steps may alternate: an autopilot with a loop of 4 ms sends a message of 100 Hz in
    steps of 8 and 12 ms.

    Args:
        telemetry: messages of the vehicle; those with fewer than ``MIN_MESSAGES_FOR_STEP`` are left out.

    Returns:
        Fraction of the messages that should be there, 0 to 1: the median of all streams; None without a stream.
    """
    missing_fractions = []
    for columns in telemetry.messages.values():
        message_count = len(columns["time"])
        is_within_boot = np.diff(columns["boot"]) == 0
        steps = np.diff(columns["time"])[is_within_boot]
        if message_count < MIN_MESSAGES_FOR_STEP or not len(steps):
            continue
        # The mean without the lowest and the highest quarter of the steps (interquartile mean).
        quarter_length = len(steps) // 4
        middle_half = np.sort(steps)[quarter_length : len(steps) - quarter_length]
        usual_step = middle_half.mean()
        if usual_step <= 0:
            continue
        # The jitter is subtracted, so that a step of 1.75 usual ones is rounded down to one.
        usual_steps_in_step = np.rint(steps / usual_step - STEP_JITTER)
        missing_count = np.maximum(usual_steps_in_step - 1, 0).sum()
        missing_fractions.append(missing_count / (missing_count + message_count))
    if not missing_fractions:
        return None
    return np.median(missing_fractions)
