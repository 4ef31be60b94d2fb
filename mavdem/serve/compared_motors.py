"""The verdict on a flight that is shown, sorted, searched and given to programs: by its log and beside other flights.

The table ``entries`` has the verdict by the log alone: headline, level, next step and suspected motor. A comparison
with the vehicle's other flights shows smaller losses of thrust (a fault or a drift, an anomaly of the motors), and is
made anew whenever such a flight comes, so it is looked up in the fleet's table ``flights``. Two functions of
``report.fleet`` join both: ``is_headline_replaced`` and ``level_beside_other_flights``. The SQL of searches is made
from them.
"""

import json
from dataclasses import replace

from mavdem.containers import JsonValues
from mavdem.facts import Level
from mavdem.facts.motors import MotorHealth
from mavdem.facts.serve import ListingOrder
from mavdem.facts.urgency import Urgency
from mavdem.fleet.row import SYSTEM_ID_BASIS, UNKNOWN, FlightRow
from mavdem.fleet.workers import KEY_HASH_DIGITS
from mavdem.report.fleet import (
    HEALTH_LEVELS,
    URGENCY_OF_HEALTHS,
    is_headline_replaced,
    level_beside_other_flights,
)
from mavdem.report.pages.motor_anomaly import motor_anomaly, review_with_anomaly
from mavdem.serve.index import CONTENT_HASH_SQL, SQL_ORDERS, LibraryEntry

HEALTH_SQL = "json_extract(iif(json_valid(brief), brief, '{}'), '$.health')"
"""SQL expression of the motors' health in a row of the fleet's table; null where the row is damaged."""

IS_ANOMALOUS_SQL = f"{HEALTH_SQL} in ('{MotorHealth.FAULT}', '{MotorHealth.DRIFT}')"
"""SQL condition of a row in which the motors have a fault or a drift; a damaged row does not meet it."""

ANOMALIES_INDEX_SQL = (
    "create index if not exists flights_with_anomaly on flights (log, vehicle)"
    f" where {IS_ANOMALOUS_SQL}"
)
"""SQL that creates an index of these rows, which are few: without it each search reads the JSON of all rows."""

HAS_BALANCE_SQL = (
    "json_extract(iif(json_valid({table}.row), {table}.row, '{{}}'), '$.balance') is not null"
)
"""SQL condition of a row of the fleet, in the named table, with the figures by which its motors are compared."""

BASELINE_VEHICLES_SQL = (
    "select distinct json_extract(row, '$.vehicle') from healthy where json_valid(row)"
)
"""SQL query of the vehicles of which a user marked flights as healthy."""

IS_COMPARABLE_SQL = f"""
({HAS_BALANCE_SQL.format(table="flights")} and (vehicle in ({BASELINE_VEHICLES_SQL})
or vehicle <> '{UNKNOWN}' and json_extract(row, '$.vehicle_basis') is not '{SYSTEM_ID_BASIS}'
and exists (select 1 from flights other where other.vehicle = flights.vehicle and other.log <> flights.log
and {HAS_BALANCE_SQL.format(table="other")})))
"""
"""SQL condition of a row of the fleet whose motors can be compared: with a baseline, or with other flights.

Flights that only have a system id in common, which several vehicles may have, are compared with a baseline alone.
"""

IS_UNCOMPARED_SQL = f"(judged is null and {IS_COMPARABLE_SQL})"
"""SQL condition of a row of the fleet whose motors are still to be compared, or to be compared again.

The column "judged" is empty until the vehicle is judged, and again once its flights or its baseline have changed. What
the row says of the motors is then of an earlier comparison, and may not be true any more.
"""

AWAITS_COMPARISON_SQL = (
    f"({CONTENT_HASH_SQL} || entries.vehicle in"
    f" (select substr(log, 1, {KEY_HASH_DIGITS}) || vehicle from flights join logs using (log)"
    f" where tracked and {IS_UNCOMPARED_SQL}))"
)
"""SQL condition of a flight of the library whose motors are still to be compared.

Logs that the fleet does not track are never compared.
"""

ROWS_WITH_ANOMALY_SQL = f"""
select substr(log, 1, {KEY_HASH_DIGITS}) || vehicle as flight, {HEALTH_SQL} as health,
    json_extract(brief, '$.health_reason') as reason, json_extract(brief, '$.suspect_motor') as suspect_motor
from flights where file is not null and {IS_ANOMALOUS_SQL} and not {IS_UNCOMPARED_SQL}
"""
"""SQL query of the fleet's rows, one for each axis, in which the motors have a fault or a drift that is up to date."""

WORST_ANOMALIES_SQL = f"""
select flight, health, reason, suspect_motor, min(iif(health = '{MotorHealth.FAULT}', 0, 1))
from ({ROWS_WITH_ANOMALY_SQL}) group by flight
"""
"""SQL query of the worst anomaly of each flight; SQLite takes the other columns from the row that has the minimum."""


def has_anomaly_sql(condition: str) -> str:
    """Returns the SQL condition that a flight's motors have an anomaly compared with the vehicle's other flights.

    Args:
        condition: SQL condition on the anomaly, whose columns are ``health``, ``reason`` and ``suspect_motor``.
    """
    return (
        f"({CONTENT_HASH_SQL} || entries.vehicle in"
        f" (select flight from ({WORST_ANOMALIES_SQL}) where {condition}))"
    )


HAS_FAULT_SQL = has_anomaly_sql(f"health = '{MotorHealth.FAULT}'")
"""SQL condition that a flight's motors have a fault compared with the vehicle's other flights."""

HAS_DRIFT_SQL = has_anomaly_sql(f"health = '{MotorHealth.DRIFT}'")
"""SQL condition that a flight's motors have a drift compared with the vehicle's other flights."""

KEPT_LEVELS_SQL = ", ".join(f"'{level}'" for level in Level if not is_headline_replaced(level))
"""SQL list of the levels at which the headline by the log alone stays."""

SHOWN_HEADLINE_OF_LOG_SQL = (
    f"iif(level not in ({KEPT_LEVELS_SQL}) and ({HAS_FAULT_SQL} or {HAS_DRIFT_SQL}), '', headline)"
)
"""SQL expression of the headline by the log alone; empty where an anomaly of the motors has taken its place."""

SHOWN_URGENCY_SQL = (
    f"min(urgency, iif({HAS_FAULT_SQL}, {URGENCY_OF_HEALTHS[MotorHealth.FAULT]:d},"
    f" iif({HAS_DRIFT_SQL}, {URGENCY_OF_HEALTHS[MotorHealth.DRIFT]:d}, {Urgency.UNKNOWN:d})))"
)
"""SQL expression of how urgently a flight needs a look: the more urgent of both judgements, as of a vehicle."""


def level_compared_with_fleet_sql(column: str) -> str:
    """Returns the SQL expression of a level that an anomaly of the motors may make worse.

    It is the SQL of ``level_beside_other_flights``.

    Args:
        column: column of the table ``entries`` with the level by the log alone.
    """
    level_with_fault = _level_with_anomaly_sql(column, MotorHealth.FAULT)
    level_with_drift = _level_with_anomaly_sql(column, MotorHealth.DRIFT)
    return (
        f"case when {HAS_FAULT_SQL} then {level_with_fault}"
        f" when {HAS_DRIFT_SQL} then {level_with_drift} else {column} end"
    )


def motors_level_sql() -> str:
    """Returns the SQL expression of the level of a flight's motors that lists show and searches find, such as "good".

    It is the level by the log and by comparison with the vehicle's other flights. Until that is made, good motors are
    unknown, since the log alone does not show smaller losses of thrust. Pages get the same level by
    :func:`entry_awaiting_comparison` and :func:`entry_compared_with_fleet`.
    """
    compared_level = level_compared_with_fleet_sql("motors")
    is_good_so_far = f"motors = '{Level.GOOD}' and {AWAITS_COMPARISON_SQL}"
    return f"case when {is_good_so_far} then '{Level.UNKNOWN}' else {compared_level} end"


def _level_with_anomaly_sql(column: str, health: MotorHealth) -> str:
    """Returns the SQL expression of the level that a flight gets if its motors have an anomaly.

    Args:
        column: column with the level by the log alone. A log that is not judged yet has none, which counts as unknown.
        health: the anomaly, fault or drift.
    """
    cases = ""
    for level_of_log in Level:
        level = level_beside_other_flights(level_of_log, HEALTH_LEVELS[health])
        cases += f" when '{level_of_log}' then '{level}'"
    level_without_log = level_beside_other_flights(Level.UNKNOWN, HEALTH_LEVELS[health])
    return f"case {column}{cases} else '{level_without_log}' end"


def order_sql(order: ListingOrder, *, is_reversed: bool = False) -> str:
    """Returns the SQL sort keys of an order in which flights are listed, such as "date desc, received desc, rowid".

    Args:
        order: the order; that by urgency also counts anomalies of the motors.
        is_reversed: whether the first key, such as the date, sorts in the opposite direction. The others, which order
            flights with the same date, stay.
    """
    first_key, other_keys = SQL_ORDERS[order].split(", ", 1)
    if is_reversed:
        first_key = _reversed_sort_key(first_key)
    if order is ListingOrder.URGENCY:
        first_key = first_key.replace("urgency", SHOWN_URGENCY_SQL)
    return f"{first_key}, {other_keys}"


def _reversed_sort_key(key: str) -> str:
    """Returns the SQL sort key for the opposite direction, with flights without a value last in both directions.

    Args:
        key: a column, followed by "desc" for descending order, such as "urgency" or "date desc".
    """
    column, _, direction = key.partition(" ")
    opposite_key = column if direction == "desc" else f"{column} desc"
    is_unknown = f"nullif({column}, '') is null"
    return f"{is_unknown}, {opposite_key}"


def entry_awaiting_comparison(entry: LibraryEntry) -> LibraryEntry:
    """Returns the index entry of a flight whose motors are still to be compared with other flights of the vehicle.

    By its log alone smaller losses of thrust do not show, so that good motors are not known to be good yet.

    Args:
        entry: the entry, whose verdict is by the log alone.

    Returns:
        A copy in which the motors are unknown; the entry itself if the log already shows something wrong with them.
    """
    if entry.motors != Level.GOOD:
        return entry
    return replace(entry, motors=str(Level.UNKNOWN))


def entry_compared_with_fleet(entry: LibraryEntry, row: FlightRow | None) -> LibraryEntry:
    """Returns a flight's index entry with the verdict that is shown: by its log, and by comparison with other flights.

    Args:
        entry: the entry, whose verdict is by the log alone.
        row: the row of the fleet's table with the worst anomaly of the flight's motors; None if they have none.

    Returns:
        A copy in which the anomaly decides headline, level, next step, suspected motor, and the light of the motors;
        without an anomaly the entry itself.
    """
    anomaly = motor_anomaly(row)
    if row is None or anomaly is None:
        return entry
    # What an anomaly replaces is decided for review documents, so that the entry is written as one.
    review = review_with_anomaly(_review_by_log(entry), anomaly)
    motors_light = review["lights"]["motors"]
    light_sentences = json.loads(entry.light_sentences)
    light_sentences["motors"] = motors_light["sentence"]
    # The figure of the motors is by the log alone, and does not fit the new sentence.
    light_figures = json.loads(entry.light_figures)
    light_figures.pop("motors", None)
    return replace(
        entry,
        headline=review["headline"]["sentence"],
        level=str(review["headline"]["level"]),
        next_step=review["next_step"]["sentence"],
        motors=str(motors_light["level"]),
        light_sentences=json.dumps(light_sentences),
        light_figures=json.dumps(light_figures),
        motor=row.suspect_motor if entry.motor is None else entry.motor,
    )


def _review_by_log(entry: LibraryEntry) -> JsonValues:
    """Returns the parts of a flight's review document that an anomaly of the motors may replace.

    Args:
        entry: the flight's index entry, whose verdict is by the log alone.
    """
    motors_sentence = json.loads(entry.light_sentences).get("motors", "")
    return {
        "headline": {"level": entry.level, "sentence": entry.headline},
        "next_step": {"sentence": entry.next_step},
        "lights": {"motors": {"level": entry.motors, "sentence": motors_sentence}},
    }
