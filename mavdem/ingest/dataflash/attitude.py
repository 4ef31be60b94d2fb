"""Attitude, body rates, setpoints and controller demands of DataFlash logs as MAVLink messages.

RATE has the rates that MAVLink's ATTITUDE sends, filtered and without the gyro bias that the estimator finds. IMU has
the bias still, and is used only where RATE was logged slower than both it and the angles, or not at all.

ArduCopter before 3.4 logged RATE's rates in centidegrees/s for a time, the demands as -4500 to 4500, and AOut as 0 to
1000. Repairs report where that was found.
"""

from typing import NamedTuple

import numpy as np

from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.containers import Names
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.dataflash.samples import GYRO_FIELDS
from mavdem.ingest.dataflash.tables import (
    float_table,
    message_count,
    messages_with_fields,
    resampled,
    rows_of_instance,
    with_stamps,
)
from mavdem.ingest.telemetry import (
    MIN_PREFERRED_SHARE,
    Columns,
    Tables,
    concatenated_columns,
    repair_facts,
    selected_rows,
)
from mavdem.ingest.vocabulary import attitude_target, quaternion, wrapped_angle

ANGLE_MESSAGES = ("ATT", "ANG")
"""Messages with the attitude; ANG is the one that may be logged in every cycle of the loop."""
ANGLE_FIELDS = ("Roll", "Pitch", "Yaw")
"""Their fields with the attitude, degrees."""
ANGLE_SETPOINT_FIELDS = ("DesRoll", "DesPitch", "DesYaw")
"""Their fields with the setpoints of the attitude, degrees."""
RATE_FIELDS = ("R", "P", "Y")
"""Fields of RATE with the body rates, degrees/s."""
RATE_SETPOINT_FIELDS = ("RDes", "PDes", "YDes")
"""Fields of RATE with the setpoints of the body rates, degrees/s."""
DEMAND_FIELDS = ("ROut", "POut", "YOut")
"""Fields of RATE with what the rate controllers demand of the mixer, -1 to 1."""

CENTIDEGREE_RATIOS = (15.0, 400.0)
"""Range of the ratio of RATE, taken for degrees/s, to the gyro's rate, in which RATE is in centidegrees/s.

It is 100 without filters. RATE may be filtered where the gyro is not, so that it is less.
"""

MIN_TURN_RATE = 0.1
"""Rate of the gyro, rad/s, from which on a sample counts for that ratio: below, noise and bias decide."""

CENTIDEGREES = 100.0
"""Centidegrees in a degree."""

DEMAND_CHANNELS = 8
"""Number of elements of ACTUATOR_CONTROL_TARGET.controls."""
THRUST_CHANNEL = 3
"""Element of ACTUATOR_CONTROL_TARGET.controls with the thrust; the first three are roll, pitch and yaw."""

MAX_DEMAND = 2.0
"""Bound of demands of the range -1 to 1: damaged ones only lie beyond it."""
DEMAND_PERCENTILE = 75
"""Percentile of the demands other than 0 that is compared with ``MAX_DEMAND``: fewer than a quarter are damaged."""
OLD_FULL_DEMAND = 4500.0
"""Full demand in ArduCopter before 3.4."""
OLD_FULL_THRUST = 1000.0
"""Full thrust in ArduCopter before 3.4."""


class NamedMessage(NamedTuple):
    """A translated message, and the log's name of its original."""

    source_name: str
    """Name in the log: "RATE"."""
    columns: Columns
    """Columns of MAVLink's message; empty where there is none."""


def rate_units_per_degree(tables: Tables) -> tuple[float, Facts]:
    """Finds out whether RATE logged body rates in degrees/s or in centidegrees/s, by comparison with the gyro.

    The log does not state the unit. The magnitude of RATE's body rate, taken for degrees/s, is divided by the magnitude
    of the gyro's rate at the same stamps while the vehicle turns. The median of this ratio is near 1 or near 100.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        RATE's units per degree/s, 1 or 100, and a fact that reports it if it is 100. It is 1 if there are too few
        samples in turns to decide.
    """
    ratio = _rate_to_gyro_ratio(tables)
    lowest_ratio, highest_ratio = CENTIDEGREE_RATIOS
    if ratio is not None and lowest_ratio < ratio < highest_ratio:
        return CENTIDEGREES, repair_facts(Repair.CENTIDEGREES_CONVERTED, ratio=ratio)
    return 1.0, ()


def _rate_to_gyro_ratio(tables: Tables) -> float | None:
    """Returns the median ratio of the magnitudes of RATE's body rate and the gyro's, in turns of the vehicle.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        The ratio, with RATE's values taken for degrees/s; None if there are too few samples in turns.
    """
    rates = messages_with_fields(tables, "RATE", RATE_FIELDS)
    gyro = rows_of_instance(messages_with_fields(tables, "IMU", GYRO_FIELDS), "I", 0)
    if not rates or not gyro:
        return None
    gyro_rates = resampled(rates, gyro, float_table(gyro, GYRO_FIELDS))
    gyro_magnitude = np.linalg.norm(gyro_rates, axis=1)
    # NaN, where the gyro has a gap, compares as false.
    is_turning = gyro_magnitude > MIN_TURN_RATE
    if np.count_nonzero(is_turning) < MIN_SAMPLES_FOR_STATISTICS:
        return None
    logged_rates = np.radians(float_table(rates, RATE_FIELDS)[is_turning])
    logged_magnitude = np.linalg.norm(logged_rates, axis=1)
    return float(np.median(logged_magnitude / gyro_magnitude[is_turning]))


def attitude(tables: Tables, units_per_degree: float) -> NamedMessage:
    """Makes ATTITUDE from the Euler angles (ATT or ANG) and the body rates (RATE, or else IMU).

    Both are logged in separate messages, at different stamps. Body rates are interpolated at the stamps of the
    angles or, where they were logged clearly less often, angles at the stamps of the body rates: the faster signal
    bears interpolation better.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        units_per_degree: RATE's units per degree/s.

    Returns:
        Columns of ATTITUDE (N,): angles, rad, within half a turn of zero, and body rates, rad/s; NaN in gaps of the
        faster message. There are none if angles or rates were not logged.
    """
    angle_message = _faster_angle_message(tables, ANGLE_FIELDS)
    angles = messages_with_fields(tables, angle_message, ANGLE_FIELDS)
    rates = messages_with_fields(tables, "RATE", RATE_FIELDS)
    gyro = rows_of_instance(messages_with_fields(tables, "IMU", GYRO_FIELDS), "I", 0)
    if not angles or not (rates or gyro):
        return NamedMessage(angle_message, {})
    enough_for_angles = MIN_PREFERRED_SHARE * message_count(angles)
    rate_count = message_count(rates)
    # RATE has body rates without the gyro's bias, so IMU, the gyro itself, replaces it only where RATE is slower than
    # IMU and clearly slower than the angles.
    if rate_count < enough_for_angles and rate_count < message_count(gyro):
        rate_message = "IMU"
        rates = gyro
        body_rates = float_table(gyro, GYRO_FIELDS)
    else:
        rate_message = "RATE"
        body_rates = np.radians(float_table(rates, RATE_FIELDS)) / units_per_degree
    if message_count(rates) < enough_for_angles:
        slower_columns, slower_message = rates, rate_message
    else:
        slower_columns, slower_message = angles, angle_message
    euler_angles = np.radians(float_table(angles, ANGLE_FIELDS))
    euler_angles = resampled(slower_columns, angles, euler_angles, is_angle=True)
    body_rates = resampled(slower_columns, rates, body_rates)
    # MAVLink's angles are within half a turn of zero. Those that already are, stay exactly as they are, since wrapping
    # would round them.
    euler_angles = np.where(abs(euler_angles) > np.pi, wrapped_angle(euler_angles), euler_angles)
    roll, pitch, yaw = euler_angles.T
    roll_rate, pitch_rate, yaw_rate = body_rates.T
    fields = {
        "roll": roll,
        "pitch": pitch,
        "yaw": yaw,
        "rollspeed": roll_rate,
        "pitchspeed": pitch_rate,
        "yawspeed": yaw_rate,
    }
    return NamedMessage(slower_message, with_stamps(slower_columns, fields))


def _faster_angle_message(tables: Tables, fields: Names) -> str:
    """Returns the name of the message with these fields of the attitude that has more messages; ATT if equal."""
    counts = {
        name: message_count(messages_with_fields(tables, name, fields)) for name in ANGLE_MESSAGES
    }
    return max(ANGLE_MESSAGES, key=lambda name: counts[name])


def attitude_targets(tables: Tables, units_per_degree: float) -> NamedMessage:
    """Makes ATTITUDE_TARGET, one message for each setpoint of the body rates, and one for each of the attitude.

    DataFlash logs the two setpoints in different messages (RATE, and ATT or ANG). Each of these becomes one
    ATTITUDE_TARGET, whose ``type_mask`` marks the other setpoint as not sent.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        units_per_degree: RATE's units per degree/s.

    Returns:
        Columns of ATTITUDE_TARGET (N,), body rates in rad/s and attitude as quaternions, in the order of boot and
        time; no columns if neither setpoint was logged.
    """
    tables_of_setpoints: list[Columns] = []
    names = []
    rates = messages_with_fields(tables, "RATE", RATE_SETPOINT_FIELDS)
    if rates:
        rate_setpoints = np.radians(float_table(rates, RATE_SETPOINT_FIELDS)) / units_per_degree
        tables_of_setpoints.append(with_stamps(rates, attitude_target(rate_setpoints)))
        names.append("RATE")
    angle_message = _faster_angle_message(tables, ANGLE_SETPOINT_FIELDS)
    angles = messages_with_fields(tables, angle_message, ANGLE_SETPOINT_FIELDS)
    if angles:
        roll, pitch, yaw = np.radians(float_table(angles, ANGLE_SETPOINT_FIELDS)).T
        tables_of_setpoints.append(
            with_stamps(angles, attitude_target(quaternion(roll, pitch, yaw)))
        )
        names.append(angle_message)
    if not tables_of_setpoints:
        return NamedMessage("RATE", {})
    targets = concatenated_columns(tables_of_setpoints)
    time_order = np.lexsort((targets["time"], targets["boot"]))
    return NamedMessage(" and ".join(names), selected_rows(targets, time_order))


def rate_tuning(tables: Tables, attitude_columns: Columns, units_per_degree: float) -> Columns:
    """Makes PID_TUNING, which has RATE's setpoints and body rates at the full rate of RATE.

    ATTITUDE has the body rates too, but where angles were logged more slowly than RATE, only at the stamps of the
    angles. Where RATE is not clearly faster than that, PID_TUNING would add nothing and is not made.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        attitude_columns: Columns of ATTITUDE, which was made of the same log, with their time.
        units_per_degree: RATE's units per degree/s.

    Returns:
        Three messages per row of RATE, degrees/s: setpoint (``desired``) and body rate (``achieved``) about roll, pitch
        and yaw, whose ``axis`` is 1, 2 and 3. They come one axis after the other. Empty if it is not made.
    """
    logged_columns = messages_with_fields(tables, "RATE", (*RATE_SETPOINT_FIELDS, *RATE_FIELDS))
    if message_count(attitude_columns) >= MIN_PREFERRED_SHARE * message_count(logged_columns):
        return {}
    tables_of_axes = []
    fields_of_axes = zip(RATE_SETPOINT_FIELDS, RATE_FIELDS, strict=True)
    for axis_number, fields in enumerate(fields_of_axes, 1):
        setpoint, rate = (float_table(logged_columns, fields) / units_per_degree).T
        axis = np.full(message_count(logged_columns), axis_number, np.uint8)
        tables_of_axes.append(
            with_stamps(logged_columns, {"axis": axis, "desired": setpoint, "achieved": rate})
        )
    return concatenated_columns(tables_of_axes)


RATE_CONTROLLER_MESSAGES = ("PIDR", "PIDP", "PIDY")
"""Messages of the rate controllers of roll, pitch and yaw."""


def derivative_terms(tables: Tables) -> Columns:
    """Makes D_TERM: the derivative terms of the rate controllers of roll, pitch and yaw, as x, y and z.

    D_TERM is no message of MAVLink, but a table of this package. ArduPilot logs PIDR, PIDP and PIDY in the same step of
    its loop, so row i of each belongs to the same step. If the log ends within a step, the longer tables are cut.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns (N,) at the stamps of PIDR, in the unit of the demand, -1 to 1; empty unless all three were logged.
    """
    logged_columns = [
        messages_with_fields(tables, name, ("D",)) for name in RATE_CONTROLLER_MESSAGES
    ]
    step_count = min(map(message_count, logged_columns))
    if not step_count:
        return {}
    terms = {}
    for axis, columns in zip("xyz", logged_columns, strict=True):
        terms[axis] = columns["D"][:step_count]
    roll_columns = selected_rows(logged_columns[0], slice(step_count))
    return with_stamps(roll_columns, terms)


def controller_demands(tables: Tables) -> tuple[Columns, Facts]:
    """Makes ACTUATOR_CONTROL_TARGET: the demands of the rate controllers on the mixer, and thrust.

    ArduCopter before 3.4 logged demands as -4500 to 4500. This scale is recognised by the magnitudes: more than a
    quarter of the demands other than 0 exceed 2. Then demands and thrust are divided by their old full values.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").

    Returns:
        Columns with ``controls`` (N, 8): demands on roll, pitch and yaw, -1 to 1, then thrust, 0 to 1 (NaN where RATE
        has none), then zeros; and a fact that reports it if they were scaled.
    """
    logged_columns = messages_with_fields(tables, "RATE", DEMAND_FIELDS)
    if not logged_columns:
        return {}, ()
    controls = np.zeros((message_count(logged_columns), DEMAND_CHANNELS))
    axes = slice(len(DEMAND_FIELDS))
    controls[:, axes] = float_table(logged_columns, DEMAND_FIELDS)
    controls[:, THRUST_CHANNEL] = logged_columns.get("AOut", np.nan)
    repairs: Facts = ()
    # Demands of 0, as on the ground, do not show the scale.
    magnitudes = abs(controls[:, axes])
    magnitudes = magnitudes[magnitudes > 0]
    if len(magnitudes) and np.percentile(magnitudes, DEMAND_PERCENTILE) > MAX_DEMAND:
        controls[:, axes] /= OLD_FULL_DEMAND
        controls[:, THRUST_CHANNEL] /= OLD_FULL_THRUST
        repairs = repair_facts(Repair.DEMANDS_SCALED, divisor=OLD_FULL_DEMAND)
    demand_group = np.zeros(len(controls), dtype=np.uint8)
    return with_stamps(logged_columns, {"group_mlx": demand_group, "controls": controls}), repairs
