"""Translation of DataFlash messages to MAVLink: which message becomes which, with names and units of its fields.

Fields and units: https://ardupilot.org/copter/docs/logmessages.html, from ArduPilot's ``LogStructure.h`` files.
docs/formats.md#dataflash has the table of both vocabularies. Messages of which only names and units change are in
``translation.toml``.
"""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.files import load_adjacent_toml
from mavdem.ingest.dataflash.attitude import (
    RATE_CONTROLLER_MESSAGES,
    NamedMessage,
    attitude,
    attitude_targets,
    controller_demands,
    derivative_terms,
    rate_tuning,
    rate_units_per_degree,
)
from mavdem.ingest.dataflash.batteries import NUMBERED_BATTERY_MESSAGES, battery_status, sys_status
from mavdem.ingest.dataflash.estimators import FlownEstimates, core_message_names, flown_estimates
from mavdem.ingest.dataflash.outputs import servo_outputs
from mavdem.ingest.dataflash.position_targets import POSITION_CONTROLLER_MESSAGES, position_targets
from mavdem.ingest.dataflash.recording import MessageTable
from mavdem.ingest.dataflash.sensors import (
    FURTHER_SENSOR_MESSAGES,
    OLD_ESC_MESSAGES,
    RECEIVER_MESSAGES,
    STATUS_3D_FIX,
    further_accelerometers,
    further_sensors,
    gps_fixes,
    motor_speeds,
)
from mavdem.ingest.dataflash.states import states_of
from mavdem.ingest.dataflash.tables import (
    continuous_time,
    field_texts,
    message_count,
    messages_with_fields,
    resampled,
    rows_of_instance,
    with_stamps,
)
from mavdem.ingest.dataflash.vibrations import vibration
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.telemetry import (
    Columns,
    Parameters,
    SourceFields,
    Tables,
    fields_by_rule,
    last_values,
    repair_facts,
    selected_rows,
    translated_fields,
)
from mavdem.ingest.vocabulary import (
    ACCELEROMETERS_MESSAGE,
    INSTANCES_MESSAGE,
    NO_SEVERITY,
    EstimatorRatio,
)

FLIGHT_MESSAGES = (
    "ATT",
    "ANG",
    "RATE",
    "IMU",
    "RCOU",
    "RCO2",
    "RCO3",
    "CTUN",
    "XKF1",
    "XKF4",
    "NKF1",
    "EV",
    "ARM",
)
"""Messages of the vehicle's motion, motors and state: a log without any of them has no flight."""

TRANSLATED_MESSAGES = tuple(
    # A dictionary keeps each name once.
    dict.fromkeys(
        (
            *RATE_CONTROLLER_MESSAGES,
            *FLIGHT_MESSAGES,
            *NUMBERED_BATTERY_MESSAGES,
            *core_message_names(),
            "POS",
            "VIBE",
            "BARO",
            "RCIN",
            "MAG",
            "GPS",
            "POWR",
            "MODE",
            "ERR",
            "MSG",
            "PARM",
            "SIDD",
            "SIDS",
            "ESC",
            *OLD_ESC_MESSAGES,
            *FURTHER_SENSOR_MESSAGES,
            "GYR",
            "ACC",
            "ISBH",
            "ISBD",
            "PM",
            "MCU",
            *RECEIVER_MESSAGES,
            *POSITION_CONTROLLER_MESSAGES,
        )
    )
)
"""DataFlash's messages that are read."""

TRANSLATION_RULES = load_adjacent_toml(__file__, "translation.toml")
"""How messages are translated whose fields change names and units only, by name of MAVLink's message."""

RATE_AXES_BEFORE_33 = {"Rll": "R", "Pit": "P", "Yaw": "Y"}
"""Axes in the names of RATE's fields before ArduCopter 3.3 was released, and today."""


def _old_rate_names() -> dict[str, str]:
    """Returns today's name of each field of RATE by the name that it had before ArduCopter 3.3 was released."""
    names = {}
    for old_axis, axis in RATE_AXES_BEFORE_33.items():
        for suffix in ("", "Des", "Out"):
            names[f"{old_axis}{suffix}"] = f"{axis}{suffix}"
    return names


NEW_NAMES_OF_OLD_FIELDS = {
    # Before ArduPilot 3.3 TimeMS was the time of the week, and T the time since boot.
    "GPS": {"TimeMS": "GMS", "Week": "GWk", "T": "TimeMS"},
    "GPS2": {"TimeMS": "GMS", "Week": "GWk", "T": "TimeMS"},
    # The first filter has three test ratios of the compass, of which the first counts.
    "EKF4": {"SMX": "SM"},
    "RATE": _old_rate_names(),
}
"""Today's names of fields by their old names, by message."""


def with_new_names(message: str, table: MessageTable) -> MessageTable:
    """Renames the fields of a message to the names of the latest ArduPilot version.

    A table comes from an old version if it has all the old names.

    Args:
        message: Name of the messages ("ATT").
        table: The messages, under the field names of the version that wrote them.

    Returns:
        The same columns under the latest names.
    """
    new_names = NEW_NAMES_OF_OLD_FIELDS.get(message, {})
    if not all(old_name in table.columns for old_name in new_names):
        return table
    columns = {new_names.get(field, field): values for field, values in table.columns.items()}
    return table._replace(columns=columns)


class TranslatedMessages(NamedTuple):
    """Messages of a DataFlash log in the vocabulary of MAVLink."""

    messages: dict[str, Columns]
    """Columns of each message, by the name that MAVLink gives it."""

    source_names: dict[str, str]
    """What the log calls each message, also those that it could have."""

    repairs: Facts
    """Units that were converted, and another core of the estimator that was read."""


def mavlink_messages(
    tables: Tables, vehicle_type: int, parameters: Parameters
) -> TranslatedMessages:
    """Translates a log's messages into MAVLink's.

    Each MAVLink message is made by a function of its own, or, where only names and units differ, by its rule in
    ``translation.toml``. Messages without rows are left out.

    Args:
        tables: DataFlash's messages by name, with ``time`` and ``boot``.
        vehicle_type: MAV_TYPE, for HEARTBEAT.
        parameters: The autopilot's parameters by name.

    Returns:
        Columns of MAVLink's messages by name; what the log calls each, also of messages that it could have; and
        facts that report where units were converted, or another core of the estimator was read.
    """
    estimates = flown_estimates(tables, parameters)
    tables = estimates.tables
    units_per_degree, unit_repairs = rate_units_per_degree(tables)
    attitude_message = attitude(tables, units_per_degree)
    demands, demand_repairs = controller_demands(tables)
    tuning = rate_tuning(tables, attitude_message.columns, units_per_degree)
    armed_states, landed_states = states_of(tables, vehicle_type)
    messages = {
        "ATTITUDE": attitude_message,
        "SERVO_OUTPUT_RAW": servo_outputs(tables),
        "ACTUATOR_CONTROL_TARGET": NamedMessage("RATE", demands),
        "ATTITUDE_TARGET": attitude_targets(tables, units_per_degree),
        "PID_TUNING": NamedMessage("RATE", tuning),
        "D_TERM": NamedMessage("/".join(RATE_CONTROLLER_MESSAGES), derivative_terms(tables)),
        "SYS_STATUS": sys_status(tables),
        "BATTERY_STATUS": battery_status(tables),
        "VIBRATION": NamedMessage("VIBE", vibration(tables)),
        "SYSTEM_TIME": NamedMessage("GPS", _calendar_time(tables)),
        "GPS_RAW_INT": gps_fixes(tables, 0),
        "GPS2_RAW": gps_fixes(tables, 1),
        "STATUSTEXT": NamedMessage("MSG", _status_texts(tables)),
        "ERR": NamedMessage("ERR", messages_with_fields(tables, "ERR", ("Subsys", "ECode"))),
        "PARAM_VALUE": NamedMessage("PARM", _parameter_values(tables)),
        "EV": NamedMessage("EV", messages_with_fields(tables, "EV", ("Id",))),
        # The main loop's load and memory: no message of MAVLink that has them has these stamps.
        "PM": NamedMessage("PM", messages_with_fields(tables, "PM", ("NLon",))),
        "POSITION_TARGET_LOCAL_NED": position_targets(tables),
        ACCELEROMETERS_MESSAGE: further_accelerometers(tables),
        "ESC": motor_speeds(tables),
        "SIDD": NamedMessage("SIDD", _injected_signal(tables)),
    }
    for message in TRANSLATION_RULES:
        messages[message] = _renamed_message(estimates, message)
    messages |= further_sensors(tables, TRANSLATION_RULES)
    messages["LOCAL_POSITION_NED"] = _local_position(estimates)
    messages["GLOBAL_POSITION_INT"] = _global_position(messages)
    messages["EKF_STATUS_REPORT"] = _estimator_status(messages["EKF_STATUS_REPORT"])
    messages[INSTANCES_MESSAGE] = _estimator_instances(estimates, messages["EKF_STATUS_REPORT"])
    messages["HEARTBEAT"] = NamedMessage("EV", armed_states)
    messages["EXTENDED_SYS_STATE"] = NamedMessage("EV", landed_states)
    return _translated_messages(messages, estimates, unit_repairs + demand_repairs)


def _translated_messages(
    messages: Mapping[str, NamedMessage], estimates: FlownEstimates, repairs: Facts
) -> TranslatedMessages:
    """Collects the messages that have rows, and what the log calls each.

    Args:
        messages: All messages that a log can have, by their names in MAVLink; those that were not logged are empty.
        estimates: Messages of the estimator core that was used in flight, with the names of other cores.
        repairs: Facts that report where units were converted.

    Returns:
        The messages with rows; what the log calls each, also of those without; and the facts, with one more if another
        core of the estimator was read.
    """
    columns_of_messages = {}
    source_names = {}
    for name, message_of_log in messages.items():
        if message_count(message_of_log.columns):
            columns_of_messages[name] = message_of_log.columns
        if message_of_log.source_name:
            source_names[name] = message_of_log.source_name
    other_cores = {name for name in source_names.values() if name in estimates.names.values()}
    core_repairs = repair_facts(
        Repair.OTHER_CORE_READ, count=len(other_cores), names=sorted(other_cores)
    )
    return TranslatedMessages(columns_of_messages, source_names, repairs + core_repairs)


def _renamed_message(estimates: FlownEstimates, message: str) -> NamedMessage:
    """Translates a message of which only names and units change, by its rule in ``translation.toml``.

    A rule lists the DataFlash messages that different versions of ArduPilot write. The first that was logged with all
    required fields is used; messages of the filter in use precede messages of other filters.

    Args:
        estimates: DataFlash's messages; of the filters, only messages of the core that was used.
        message: Name of MAVLink's message, the key of the rule.

    Returns:
        The message; without columns if none was logged.
    """
    rule = TRANSLATION_RULES[message]
    names = estimates.preferred_names(rule["messages"])
    for name in names:
        logged_columns = estimates.tables.get(name, {})
        if "instance_field" in rule:
            logged_columns = _rows_of_first_sensor(logged_columns, rule["instance_field"])
        if not message_count(logged_columns):
            continue
        try:
            fields = fields_by_rule(logged_columns, rule)
        except KeyError:
            # A required field was not logged; another version's message may have it.
            continue
        return NamedMessage(estimates.names.get(name, name), with_stamps(logged_columns, fields))
    return NamedMessage(names[0], {})


def _rows_of_first_sensor(logged_columns: Columns, instance_field: str) -> Columns:
    """Returns the rows of the first sensor of a message that several sensors write.

    Args:
        logged_columns: The message.
        instance_field: Its field with the number of the sensor. Old versions do not log it, and then have one sensor.
    """
    instances = logged_columns.get(instance_field, np.zeros(0))
    if len(instances) == 0:
        return logged_columns
    return rows_of_instance(logged_columns, instance_field, instances.min())


def _local_position(estimates: FlownEstimates) -> NamedMessage:
    """Makes LOCAL_POSITION_NED: position, m, and velocity, m/s, in north-east-down.

    The vertical speed of ArduPilot's first estimator, EKF1, is off by 0.3 m/s. If the climb rate was logged too (in
    DataFlash's CTUN, which is translated to VFR_HUD), it replaces that speed: resampled at the stamps of the position,
    with its sign changed, since z points down.

    Args:
        estimates: DataFlash's messages; of those with estimates, the ones of the estimator that was used in flight.

    Returns:
        Columns x, y, z, vx, vy and vz (n,), from the start of the estimator on.
    """
    logged_position = _renamed_message(estimates, "LOCAL_POSITION_NED")
    position = NamedMessage(
        logged_position.source_name, _rows_of_running_estimator(logged_position.columns)
    )
    climb = _renamed_message(estimates, "VFR_HUD").columns
    if position.source_name != "EKF1" or not position.columns:
        return position
    # A climb rate that is 0 throughout was not measured.
    if not climb or not climb["climb"].any():
        return position
    climb_rate = resampled(position.columns, climb, climb["climb"][:, None])[:, 0]
    return NamedMessage(position.source_name, {**position.columns, "vz": -climb_rate})


def _rows_of_running_estimator(position: Columns) -> Columns:
    """Selects the messages LOCAL_POSITION_NED that are estimates, and not zeros of an estimator that did not run.

    An estimator that has not started, or has stopped, is logged with zeros: taken for estimates, they say that a
    vehicle in flight stands still on the ground. An estimator that runs never has all six values exactly 0.

    Args:
        position: Columns x, y, z, vx, vy and vz (N,); may be empty.

    Returns:
        The selected messages; no columns if the estimator never ran.
    """
    if not message_count(position):
        return position
    fields = TRANSLATION_RULES["LOCAL_POSITION_NED"]["fields"]
    is_running = np.any([position[field] != 0 for field in fields], axis=0)
    return selected_rows(position, is_running) if is_running.any() else {}


def _global_position(messages: Mapping[str, NamedMessage]) -> NamedMessage:
    """Returns GLOBAL_POSITION_INT of POS, the position of whatever estimator flies, where no filter's was logged."""
    position = messages["GLOBAL_POSITION_INT"]
    if messages["LOCAL_POSITION_NED"].columns:
        return NamedMessage(position.source_name, {})
    return position


FILTER_GPS_GLITCH_FLAG = 1 << 14
"""Bit of the filter's own status for a glitch of GPS (``nav_filter_status.gps_glitching`` in ``AP_Nav_Common.h``)."""

SHARED_STATUS_FLAGS = mavlink_constant("EKF_UNINITIALIZED") - 1
"""Bits of the filter's own status that are also those of EKF_STATUS_REPORT: all below EKF_UNINITIALIZED."""


def _estimator_status(status: NamedMessage) -> NamedMessage:
    """Makes EKF_STATUS_REPORT, the health of the state estimator.

    DataFlash has the filter's own status word. Its lower bits mean the same as in EKF_STATUS_REPORT.flags; the bit for
    a glitch of GPS is at another place in the two, and is moved.

    Args:
        status: The message with the filter's own status word as ``flags``.

    Returns:
        The message with the ``flags`` of MAVLink.
    """
    # Before ArduCopter 3.3 there was no status.
    if "flags" not in status.columns:
        return status
    filter_flags = status.columns["flags"].astype(np.int64)
    is_glitching = (filter_flags & FILTER_GPS_GLITCH_FLAG) > 0
    glitch_flag = np.where(is_glitching, mavlink_constant("EKF_GPS_GLITCHING"), 0)
    flags = (filter_flags & SHARED_STATUS_FLAGS) | glitch_flag
    return NamedMessage(status.source_name, {**status.columns, "flags": flags})


def _estimator_instances(estimates: FlownEstimates, status: NamedMessage) -> NamedMessage:
    """Makes a table of the test ratios of all cores of the Kalman filter, if the log has more than the primary one.

    A test ratio is the size of an innovation relative to the limit beyond which the filter rejects it. ArduPilot runs
    one core (instance) of the filter per IMU. The ratios are in the same message of the log from which
    EKF_STATUS_REPORT was made, which has only the rows of the primary core.

    Args:
        estimates: DataFlash's messages, with the rows of all cores.
        status: EKF_STATUS_REPORT of the primary core, with the name of its message in the log.

    Returns:
        Columns (N,): the number of the core as ``instance``, ``is_primary`` (0 or 1), and the test ratios by the names
        of ``EstimatorRatio``; no columns if only the primary core was logged.
    """
    # If another core than the primary one was logged, its number follows the message's name: "XKF4[1]".
    name, _, _ = status.source_name.partition("[")
    logged_columns = estimates.all_cores.get(name, {})
    if not status.columns or not message_count(logged_columns):
        return NamedMessage(name, {})
    core = logged_columns["C"].astype(np.int64)
    is_primary = core == estimates.primary_cores[name]
    if is_primary.all():
        return NamedMessage(name, {})
    sources_by_field = TRANSLATION_RULES["EKF_STATUS_REPORT"]["fields"]
    sources_by_ratio: SourceFields = {
        ratio: sources_by_field[field] for ratio, field in RATIO_FIELDS.items()
    }
    ratios = translated_fields(logged_columns, sources_by_ratio)
    fields = {"instance": core, "is_primary": is_primary.astype(np.uint8), **ratios}
    return NamedMessage(name, with_stamps(logged_columns, fields))


RATIO_FIELDS = {
    EstimatorRatio.VELOCITY: "velocity_variance",
    EstimatorRatio.POSITION: "pos_horiz_variance",
    EstimatorRatio.HEIGHT: "pos_vert_variance",
    EstimatorRatio.COMPASS: "compass_variance",
}
"""Fields of EKF_STATUS_REPORT with the test ratios of the filter's innovations."""


GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC).timestamp()
"""Time at which GPS time began, UNIX s."""
WEEK = timedelta(weeks=1).total_seconds()
"""Seconds in a week."""
LEAP_SECONDS = 18
"""Time, s, by which GPS time is ahead of UTC since 2017; it was a second or two less in the years before."""


def satellite_utc(weeks: NDArray[Any], milliseconds: NDArray[Any]) -> Array:
    """Returns UTC (n,), UNIX s, by the time of the satellites.

    GPS gives time as a week (GWk) and milliseconds of the week (GMS). It runs ahead of UTC by the leap seconds since
    1980.

    Args:
        weeks: Weeks (n,) since GPS time began.
        milliseconds: Milliseconds (n,) of the week.

    Returns:
        Times (n,), UNIX s.
    """
    return GPS_EPOCH + WEEK * weeks.astype(np.float64) + milliseconds / 1e3 - LEAP_SECONDS


def _calendar_time(tables: Tables) -> Columns:
    """Makes SYSTEM_TIME from GPS: UTC by the receiver, UNIX µs, while it has a fix.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns (N,) with ``time_unix_usec``; empty if there is no GPS.
    """
    logged_columns = messages_with_fields(tables, "GPS", ("Status", "GMS", "GWk"))
    if not logged_columns:
        return {}
    has_time = (logged_columns["Status"] >= STATUS_3D_FIX) & (logged_columns["GWk"] > 0)
    logged_columns = selected_rows(logged_columns, has_time)
    seconds = satellite_utc(logged_columns["GWk"], logged_columns["GMS"])
    # In MAVLink 0 stands for a time that is not known.
    known_seconds = np.where(np.isfinite(seconds), seconds, 0.0)
    microseconds = np.rint(1e6 * known_seconds).astype(np.uint64)
    return with_stamps(logged_columns, {"time_unix_usec": microseconds})


def _status_texts(tables: Tables) -> Columns:
    """Makes STATUSTEXT from MSG, which has no severity.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns (N,) with ``severity`` and ``text``; empty without a text.
    """
    logged_columns = messages_with_fields(tables, "MSG", ("Message",))
    if not logged_columns:
        return {}
    severity = np.full(message_count(logged_columns), NO_SEVERITY, dtype=np.uint8)
    texts = np.array(field_texts(logged_columns, "Message"), dtype=np.object_)
    return with_stamps(logged_columns, {"severity": severity, "text": texts})


def _parameter_values(tables: Tables) -> Columns:
    """Makes PARAM_VALUE from PARM: the parameters when the logger began, and each one that was set later.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns (N,) with ``param_id`` and ``param_value``; empty without parameters.
    """
    logged_columns = messages_with_fields(tables, "PARM", ("Name", "Value"))
    if not logged_columns:
        return {}
    parameter_values = logged_columns["Value"].astype(np.float32)
    return with_stamps(
        logged_columns, {"param_id": logged_columns["Name"], "param_value": parameter_values}
    )


def _injected_signal(tables: Tables) -> Columns:
    """Makes SIDD: the test signal that ArduCopter's system identification mode injects.

    SIDS begins each run and has its axis (SID_AXIS); SIDD has the samples of the signal. Each sample gets the axis of
    the last run that began before it.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns (N,): ``axis`` and ``target``, the signal in the unit of its axis; empty without such a run.
    """
    runs = messages_with_fields(tables, "SIDS", ("Ax",))
    signal_samples = messages_with_fields(tables, "SIDD", ("Targ",))
    if not runs or not signal_samples:
        return {}
    axis = last_values(continuous_time(signal_samples), continuous_time(runs), runs["Ax"])
    return with_stamps(signal_samples, {"axis": axis, "target": signal_samples["Targ"]})
