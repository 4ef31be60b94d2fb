"""MAVLink messages from PX4's topics that have an instance for each battery, estimator or sensor.

Of batteries and estimators the one that counts becomes the message, and a table has all of them. Sensors besides the
first become the further messages that MAVLink has for them: GPS2_RAW, SCALED_IMU2, SCALED_PRESSURE2 and so on.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Integers
from mavdem.ingest.px4_messages import TRANSLATION_RULES
from mavdem.ingest.px4_topics import (
    MessageMaker,
    Topics,
    array_field,
    first_instance,
    flag_or_true,
    in_time_order,
)
from mavdem.ingest.telemetry import (
    Columns,
    Fields,
    fields_by_rule,
    selected_rows,
    translated_fields,
)
from mavdem.ingest.vocabulary import EstimatorRatio


def sys_status(topics: Topics) -> Fields:
    """Makes SYS_STATUS of the first connected battery.

    PX4 itself (SYS_STATUS.hpp) sends that of the connected battery with the least charge, which may be another one
    later in the flight. Voltage and current keep their decimals, which the integers of a real message cut off. In
    addition to the message's fields there is ``charge_state`` (MAV_BATTERY_CHARGE_STATE), as in BATTERY_STATUS.

    Args:
        topics: The logged topics, by name and number of the instance; each battery is an instance of battery_status.

    Returns:
        Columns (N,) with ``time``, s; empty if no battery was logged.
    """
    batteries = _connected_batteries(topics)
    if not batteries:
        return {}
    first_number = min(batteries)
    return _battery_fields(batteries[first_number])


def battery_status(topics: Topics) -> Fields:
    """Makes BATTERY_STATUS (BATTERY_STATUS.hpp) of all connected batteries, with the number of each, from 0, as ``id``.

    It is made only if a battery besides the first is connected: otherwise it would repeat SYS_STATUS.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        Columns (N,) in the order of time: ``time``, s, ``id``, ``voltages`` (N, 1), mV, of the whole battery,
        ``cell_count``, and if logged ``current_battery``, ``battery_remaining`` and ``charge_state``.
    """
    tables_of_batteries = []
    batteries = _connected_batteries(topics)
    has_further_battery = bool(batteries.keys() - {0})
    if not has_further_battery:
        return {}
    for battery_id, battery in batteries.items():
        columns = _battery_fields(battery)
        columns["voltages"] = columns.pop("voltage_battery")[:, None]
        columns["id"] = np.full(len(battery["time"]), battery_id, np.uint8)
        columns["cell_count"] = battery.get("cell_count", np.zeros(len(battery["time"])))
        tables_of_batteries.append(columns)
    return in_time_order(tables_of_batteries)


def _battery_fields(battery: Columns) -> Fields:
    """Translates one instance of PX4's topic battery_status to fields of MAVLink's SYS_STATUS.

    Args:
        battery: Columns (N,) of battery_status.

    Returns:
        Columns (N,) of SYS_STATUS, with the warning as ``charge_state`` (MAV_BATTERY_CHARGE_STATE).
    """
    rule = TRANSLATION_RULES["SYS_STATUS"]
    fields = fields_by_rule(battery, rule)
    columns = {"time": battery["time"], **fields}
    if "warning" in battery:
        # PX4's warning 0 means none; in MAVLink 0 means undefined and 1 means OK. The further levels agree.
        columns["charge_state"] = battery["warning"] + 1
    return columns


def _connected_batteries(topics: Topics) -> dict[int, Columns]:
    """Selects the messages of each battery while it is connected.

    Old versions and simulators report no battery as connected; then all messages are kept.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        Columns by the battery's number, from 0.
    """
    connected_batteries: dict[int, Columns] = {}
    all_batteries: dict[int, Columns] = {}
    for instance, topic in topics.get("battery_status", {}).items():
        number = _battery_number(topic, instance)
        if number in all_batteries:
            # Two instances report the same battery.
            number = instance
        all_batteries[number] = topic
        is_connected = flag_or_true(topic, "connected")
        if is_connected.any():
            connected_batteries[number] = selected_rows(topic, is_connected)
    return connected_batteries or all_batteries


def _battery_number(topic: Columns, instance: int) -> int:
    """Returns the number of a battery, from 0.

    Args:
        topic: Columns (N,) of one instance of battery_status. Its field ``id`` is the battery's number from 1, or 0
            without a battery.
        instance: Number of the instance, which is used if the topic does not have the battery's number.
    """
    if "id" not in topic or len(topic["id"]) == 0:
        return instance
    number_from_1 = int(np.median(topic["id"]))
    return number_from_1 - 1 if number_from_1 > 0 else instance


RATIO_FIELDS = {
    EstimatorRatio.VELOCITY: "vel_ratio",
    EstimatorRatio.POSITION: "pos_horiz_ratio",
    EstimatorRatio.HEIGHT: "pos_vert_ratio",
    EstimatorRatio.COMPASS: "mag_ratio",
}
"""Fields of ESTIMATOR_STATUS with the test ratios of the estimator's innovations."""


AID_SOURCES = {
    EstimatorRatio.VELOCITY: ("gnss_vel", "ev_vel"),
    EstimatorRatio.POSITION: ("gnss_pos", "ev_pos"),
    EstimatorRatio.HEIGHT: ("baro_hgt", "gnss_hgt", "rng_hgt", "ev_hgt"),
    EstimatorRatio.COMPASS: ("mag", "mag_heading"),
}
"""Endings of the topics ``estimator_aid_src_…`` (PX4 1.14 and later), each with the samples of one aiding source."""

UNFILTERED_ENDING = "_is_unfiltered"
"""Ending of further fields of ESTIMATOR_STATUS: whether a ratio is the largest of samples (1), or the topic's (0)."""

MAX_AID_AGE = 1.0
"""Age, s, up to which the last sample of an aiding source counts: two steps at the 2 Hz at which PX4 logs it."""


def estimator_status(topics: Topics) -> Fields:
    """Makes the columns of ESTIMATOR_STATUS from the estimator instance that PX4 uses at each time.

    PX4 runs several instances of its EKF and selects a primary one. The columns are named like the fields of MAVLink's
    message, which PX4 fills from the topic estimator_status (ESTIMATOR_STATUS.hpp). If no primary instance was logged,
    the lowest-numbered one takes its place.

    Args:
        topics: The logged topics: by the name of the topic and the number of its instance, columns (N,) by field.

    Returns:
        Columns (N,) of ESTIMATOR_STATUS in the order of time; ``time`` is s since boot.
    """
    instances = _estimator_status_by_instance(topics)
    tables_of_primary: list[Columns] = []
    for instance, columns in instances.items():
        is_primary = primary_estimators(topics, columns["time"]) == instance
        if is_primary.any():
            tables_of_primary.append(selected_rows(columns, is_primary))
    if not tables_of_primary and instances:
        tables_of_primary = [instances[min(instances)]]
    return in_time_order(tables_of_primary)


def estimator_instances(topics: Topics) -> Fields:
    """Makes a table of the test ratios of all estimator instances, where the log has more than the primary one.

    PX4 may run several instances of its EKF, each with other sensors, and flies by the primary one. A test ratio is an
    innovation (measurement less prediction) relative to the largest one that the estimator accepts.

    Args:
        topics: The logged topics: by the name of the topic and the number of its instance, columns (N,) by field.

    Returns:
        Columns (N,) in the order of time: ``time``, s since boot, the number of the ``instance``, ``is_primary`` (0 or
        1), and the test ratios by the names of ``EstimatorRatio``, NaN where the estimator does not use a sensor. Empty
        if only primary instances were logged.
    """
    tables_of_instances = []
    has_other_instance = False
    for instance, columns in _estimator_status_by_instance(topics).items():
        # Another instance may become the primary one during the flight.
        is_primary = primary_estimators(topics, columns["time"]) == instance
        has_other_instance |= not is_primary.all()
        fields: Fields = {ratio: columns[field] for ratio, field in RATIO_FIELDS.items()}
        fields["time"] = columns["time"]
        fields["instance"] = np.full(len(columns["time"]), instance)
        fields["is_primary"] = is_primary.astype(np.uint8)
        tables_of_instances.append(fields)
    if not has_other_instance:
        return {}
    return in_time_order(tables_of_instances)


def _estimator_status_by_instance(topics: Topics) -> dict[int, Fields]:
    """Returns the fields of ESTIMATOR_STATUS for each logged instance of estimator_status, with ``time``, s.

    PX4 1.15 and later low-pass the test ratios of estimator_status, so that a rejected sample may stay below 1 there.
    Where the samples of the aiding sources were logged, their ratios replace these, and the flag under the field's name
    with ``UNFILTERED_ENDING`` is 1.

    Args:
        topics: The logged topics, by name and number of the instance.

    Returns:
        Columns (N,) by the number of the instance.
    """
    rule = TRANSLATION_RULES["ESTIMATOR_STATUS"]
    instances = {}
    for instance, topic in topics.get("estimator_status", {}).items():
        columns: Fields = {"time": topic["time"], **translated_fields(topic, rule["fields"])}
        for ratio, field in RATIO_FIELDS.items():
            sampled_ratios = _sampled_ratios(topics, instance, ratio, topic["time"])
            is_sampled = np.isfinite(sampled_ratios)
            if is_sampled.any():
                columns[field] = np.where(is_sampled, sampled_ratios, columns[field])
                columns[field + UNFILTERED_ENDING] = is_sampled.astype(np.uint8)
        instances[instance] = columns
    return instances


def _sampled_ratios(topics: Topics, instance: int, ratio: EstimatorRatio, time: Array) -> Array:
    """Returns the largest test ratio of an innovation, over all aiding sources, at the times of estimator_status.

    A test ratio is the size of an innovation relative to the limit beyond which the estimator rejects it. The topics
    estimator_aid_src_… have its square (``estimator_aid_source.hpp``) for each aiding source, such as a receiver or a
    barometer, also for sources that the estimator does not use, which are left out.

    Args:
        topics: The logged topics, by name and number of the instance.
        instance: Number of the estimator instance.
        ratio: Which innovation: of velocity, position, height or heading.
        time: Times (T,) of estimator_status, s, ascending.

    Returns:
        Ratios (T,): of the samples since the time before, or else of the last one if that is at most ``MAX_AID_AGE``
        old; NaN where there are none.
    """
    largest_ratios = np.full(len(time), np.nan)
    for source in AID_SOURCES[ratio]:
        for topic_instance, topic in topics.get(f"estimator_aid_src_{source}", {}).items():
            samples = _samples_in_use(topic, topic_instance, instance)
            # A field, or its elements, such as "test_ratio[0]".
            squared_ratios = [
                samples[field] for field in samples if field.partition("[")[0] == "test_ratio"
            ]
            if not len(samples["time"]) or not squared_ratios:
                continue
            sampled_ratios = np.sqrt(np.maximum(np.max(squared_ratios, axis=0), 0.0))
            largest_of_source = _largest_since_previous_time(time, samples["time"], sampled_ratios)
            # The larger of both; a NaN is ignored.
            largest_ratios = np.fmax(largest_ratios, largest_of_source)
    return largest_ratios


def _samples_in_use(topic: Columns, topic_instance: int, estimator: int) -> Columns:
    """Selects the samples of an aiding source that are of one estimator instance, while that uses the source.

    Args:
        topic: Columns (N,) of an instance of a topic estimator_aid_src_….
        topic_instance: Number of this instance of the topic.
        estimator: Number of the estimator instance.

    Returns:
        The columns of the selected samples, which may be none.
    """
    # Without the field, the instance of the topic has the number of the estimator.
    default_estimator = np.full(len(topic["time"]), topic_instance)
    is_of_estimator = topic.get("estimator_instance", default_estimator) == estimator
    samples = selected_rows(topic, is_of_estimator)
    is_fused = samples.get("fused", np.zeros(len(samples["time"]))) > 0
    # Without the field, samples that were not fused count as rejected: a source in use remains in use.
    is_rejected = samples.get("innovation_rejected", np.ones(len(samples["time"]))) > 0
    return selected_rows(samples, _is_source_in_use(is_fused, is_rejected))


def _largest_since_previous_time(time: Array, sample_time: Array, values: Array) -> Array:
    """Resamples a signal: returns at each of T times the largest sample since the previous one of these times.

    Where no sample came since then, the last sample counts, unless it is older than ``MAX_AID_AGE``. For example, of
    the samples 3, 5 and 4 at 0.1, 0.6 and 0.9 s the largest at 1 s is 5, and at 2 s it is 4, the last one.

    Args:
        time: Times (T,) to resample at, s, ascending.
        sample_time: Times (N,) of the samples, s, ascending; at least one.
        values: Samples (N,).

    Returns:
        Largest samples (T,); NaN where there are none.
    """
    # Each time has a window of samples: those after the time before it, from row ``starts`` to before row ``ends``.
    ends = np.searchsorted(sample_time, time, side="right")
    last_rows = ends - 1
    # The first time has no time before it, and its window is the last sample.
    starts = np.append(last_rows[:1], ends[:-1])
    largest_samples = values[last_rows].astype(np.float64)
    has_new_samples = (starts < ends) & (ends > 0)
    if has_new_samples.any():
        # One window ends where the next one with samples begins, and the last one with the last row in use.
        # ``reduceat`` returns the maxima from each of these rows to the next.
        values_in_windows = values[: ends[-1]]
        largest_samples[has_new_samples] = np.maximum.reduceat(
            values_in_windows, starts[has_new_samples]
        )
    has_recent_sample = (ends > 0) & (time - sample_time[last_rows] <= MAX_AID_AGE)
    return np.where(has_recent_sample, largest_samples, np.nan)


def _is_source_in_use(is_fused: Flags, is_rejected: Flags) -> Flags:
    """Returns for each sample of an aiding source whether the estimator uses the source at that time.

    A source is in use from a sample that was fused until one that was neither fused nor rejected: then it was
    deselected, or its data became invalid. Rejected samples do not change the state.

    Args:
        is_fused: (N,) whether the estimator fused the sample.
        is_rejected: (N,) whether it rejected the sample's innovation.

    Returns:
        (N,) flags, false before the first fused sample.
    """
    shows_state = is_fused | ~is_rejected
    rows = np.arange(len(is_fused))
    # Each sample has the row of the latest one that shows the state; before the first of these there is none.
    no_row = -1
    latest_row = np.maximum.accumulate(np.where(shows_state, rows, no_row))
    return (latest_row != no_row) & is_fused[latest_row]


def primary_estimators(topics: Topics, time: Array) -> Integers:
    """Returns the number of the estimator instance that PX4 uses at each time; 0 if no topic states it.

    Args:
        topics: The logged topics, by name and number of the instance.
        time: Times (T,) since boot, s.

    Returns:
        Numbers (T,), from 0.
    """
    selector = first_instance(topics, "estimator_selector_status")
    primary = selector.get("primary_instance", np.zeros(0, np.int64))
    if not len(primary):
        return np.zeros(len(time), np.int64)
    # Before the first message the primary instance is taken from that message.
    rows = np.searchsorted(selector["time"], time, side="right") - 1
    return primary[np.maximum(rows, 0)].astype(np.int64)


class SensorTopic(NamedTuple):
    """The topic whose instances are the sensors of one kind, and the messages that they become."""

    topic: str
    """Topic with an instance for each sensor, from 0."""
    first_message: str
    """Message of the first sensor, whose rule in ``px4_messages.toml`` the others share."""
    further_messages: tuple[str, ...]
    """Messages of the second sensor, and of the third."""


SENSOR_TOPICS = (
    SensorTopic("sensor_gps", "GPS_RAW_INT", ("GPS2_RAW",)),
    SensorTopic("sensor_baro", "SCALED_PRESSURE", ("SCALED_PRESSURE2", "SCALED_PRESSURE3")),
    SensorTopic("vehicle_magnetometer", "SCALED_IMU", ("SCALED_IMU2", "SCALED_IMU3")),
)
"""Sensors of which a vehicle has several."""


def accelerometers(topics: Topics) -> Fields:
    """Makes a table of all accelerometers, if there are several, from their mean specific force in vehicle_imu_status.

    Args:
        topics: The logged topics, by name and number of the instance; each IMU is an instance.

    Returns:
        Columns (N,) in the order of time: ``time``, s, the number of the IMU from 0 as ``instance``, and ``xacc``,
        ``yacc`` and ``zacc``, m/s²; empty if there is only one accelerometer.
    """
    tables_of_imus = []
    statuses = topics["vehicle_imu_status"]
    for instance, status in statuses.items():
        forces = array_field(status, "mean_accel", 3)
        fields: Fields = dict(zip(("xacc", "yacc", "zacc"), forces.T, strict=True))
        fields["time"] = status["time"]
        fields["instance"] = np.full(len(status["time"]), instance)
        tables_of_imus.append(fields)
    return in_time_order(tables_of_imus) if len(tables_of_imus) > 1 else {}


def further_sensors() -> dict[str, MessageMaker]:
    """Returns functions that make the messages of second and third sensors, by the names of the messages (GPS2_RAW)."""
    makers = {}
    for sensor in SENSOR_TOPICS:
        # Instance 0 of a topic is the first sensor, whose message is made elsewhere.
        for instance, message in enumerate(sensor.further_messages, 1):
            make = partial(_sensor_message, sensor=sensor, instance=instance)
            makers[message] = MessageMaker(sensor.topic, make)
    return makers


def _sensor_message(topics: Topics, sensor: SensorTopic, instance: int) -> Fields:
    """Makes a message from one instance of a sensor's topic.

    Args:
        topics: topics of the log, by name and instance.
        sensor: the topic, and the messages of its instances.
        instance: number of the instance, from 0.

    Returns:
        Columns (N,) of the message, with ``time``, s.

    Raises:
        KeyError: The instance was not logged.
    """
    topic = topics[sensor.topic][instance]
    rule = TRANSLATION_RULES[sensor.first_message]
    fields = fields_by_rule(topic, rule)
    return {"time": topic["time"], **fields}
