"""Tracking of a fleet: new and changed logs are read, and the flights of each vehicle are judged together.

A vehicle's flights are compared with its healthy ones: by the balance of its motors (``mavdem.motors``), and by the
mean acceleration that the models of healthy flights leave unexplained in another flight.
"""

import json
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavdem.containers import JsonValues
from mavdem.errors import Unreadable
from mavdem.facts import Fact, Facts
from mavdem.facts.fleet import FleetFolderFact, ReadingFact
from mavdem.facts.motors import HealthUnknown
from mavdem.fleet.baseline import row_with_bad_motors
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.health_figures import column_array, health_figures
from mavdem.fleet.judgement import AssessRows, publish_judgements
from mavdem.fleet.names import content_hash
from mavdem.fleet.row import UNKNOWN, FlightRow, FlightRows
from mavdem.fleet.sources import UNKNOWN_SIZE, LogSource, find_logs
from mavdem.fleet.store import Store, open_store
from mavdem.fleet.stored_rows import is_fleet, read_rows
from mavdem.fleet.workers import Job, JobOutcome, MakePage, WorkerPool
from mavdem.motors.health import HealthAssessment, assess_motor_health
from mavdem.motors.healthy_flight_choice import first_healthy_flights
from mavdem.motors.healthy_flights import HealthFigures

ASSESSMENT_COLUMNS = ("health", "fault_probability", "change_probability", "suspect_motor")
"""Columns that are attributes of the assessment of a flight's motors."""

COMPARISON_COLUMNS = (
    "health_reason",
    "health_code",
    "health_figures",
    "reference",
    "residual_mean",
)
"""Further columns that compare a flight with the other flights of its vehicle."""

Progress = Callable[[int, int, JobOutcome | None], None]
"""Called with the number of logs that are done, the number of logs that are to be read, and the outcome of the log that
was done last; None before the first."""

FlightKey = tuple[object, ...]
"""What the rows of one flight have in common: log, vehicle, system and component."""

RowKey = tuple[object, ...]
"""Flight, as its key, and axis of a row."""


class TrackedLogs(NamedTuple):
    """What a run of :func:`track` did."""

    logs: int
    """logs that the names stand for"""
    read: int
    """logs that were read; the others were known"""
    problems: Facts
    """facts on names that stand for no log, and on known logs that could not be read now"""
    healthy: FlightRows
    """rows of the baseline"""


NO_BASELINE = "none"
"""Name in the place of healthy flights by which the baseline is removed; a folder of that name is "./none"."""


def assess_rows(
    rows: FlightRows, baseline: FlightRows, candidates: FlightRows | None = None
) -> FlightRows:
    """Judges the health of the motors in each flight of one vehicle.

    A flight has a row for each axis, but the balance of its motors is judged once per flight. The models of the healthy
    flights then give each row its residual mean (:func:`residual_mean`). Flights under a name that several vehicles may
    share are judged only against a baseline: otherwise one vehicle would be compared with another.

    Args:
        rows: all rows of the vehicle, one for each axis of each flight.
        baseline: rows of its healthy flights; the vehicle's first sound flights where it is empty.
        candidates: rows of the flights among which these first sound ones are chosen; all flights unless given.

    Returns:
        The same rows in their order, with the columns of health.
    """
    rows = rows_without_health(rows)
    rows_of_flights = [row for row in rows if row.is_read]
    if not rows_of_flights:
        return rows
    if not baseline and not rows_of_flights[0].has_own_name:
        reason = Fact(HealthUnknown.VEHICLE_UNNAMED)
        columns: JsonValues = {
            "health_reason": reason.sentence_and_remedy,
            "health_code": reason.code,
        }
        return [replace(row, **columns) if row.is_read else row for row in rows]

    baseline_rows = [row for row in baseline if row.is_read]
    assessments = _health_by_flight(rows_of_flights, baseline_rows, candidates)
    if baseline_rows:
        healthy_rows = baseline_rows
    else:
        healthy_rows = [row for row in rows_of_flights if assessments[_flight_key(row)].is_healthy]
    # One model for each healthy flight and axis: copies of a log have the same key.
    rows_with_model = {row_key(row): row for row in healthy_rows}.values()

    assessed_rows = []
    for row in rows:
        if row.is_read:
            row = replace(
                row,
                **_health_columns(assessments[_flight_key(row)]),
                residual_mean=residual_mean(row, rows_with_model),
            )
        assessed_rows.append(row)
    return assessed_rows


def _health_columns(assessment: HealthAssessment) -> JsonValues:
    """Returns the columns of a row of the fleet's table that state the health of the motors in its flight, by name.

    Args:
        assessment: the health, with the fact (coded finding) that is its reason.
    """
    columns: JsonValues = {name: getattr(assessment, name) for name in ASSESSMENT_COLUMNS}
    return {
        **columns,
        "health_reason": str(assessment.fact),
        "health_code": assessment.fact.code,
        "health_figures": json.dumps(dict(assessment.fact.figures)),
        "reference": int(assessment.is_healthy),
    }


def logs_taken_for_healthy(rows: FlightRows) -> set[str]:
    """Returns the flights of a vehicle that count as healthy without a baseline: others are compared with these.

    Args:
        rows: all rows of the vehicle, one for each axis of each flight.

    Returns:
        Hashes of the contents of their logs; none of a name that several vehicles may share.
    """
    return set(healthy_figures_by_log(rows, baseline_rows=[]))


def healthy_figures_by_log(rows: FlightRows, baseline_rows: FlightRows) -> dict[str, HealthFigures]:
    """Returns the flights with which the motors of a vehicle's other flights are compared.

    Args:
        rows: all rows of the vehicle, one for each axis of each flight.
        baseline_rows: rows of its flights that a user marked as healthy; empty without a baseline.

    Returns:
        Figures of their motors by the hash of the log's content: of the baseline or, without one, of the flights that
        are taken for healthy, which are none for a name that several vehicles may share.
    """
    rows_of_flights = [row for row in baseline_rows or rows if row.is_read]
    figures_by_log = {content_hash(row.key): health_figures(row) for row in rows_of_flights}
    if baseline_rows:
        return {log: figures for log, figures in figures_by_log.items() if not figures.missing}
    if not rows_of_flights or not rows_of_flights[0].has_own_name:
        return {}
    healthy = first_healthy_flights(list(figures_by_log.values()))
    return {log: figures for log, figures in figures_by_log.items() if figures in healthy}


def rows_without_health(rows: FlightRows) -> FlightRows:
    """Returns the rows of flights as they are before their motors are compared with those of other flights."""
    columns: JsonValues = dict.fromkeys((*ASSESSMENT_COLUMNS, *COMPARISON_COLUMNS))
    columns["health"] = UNKNOWN
    return [replace(row, **columns) for row in rows]


def _health_by_flight(
    rows: FlightRows, baseline_rows: FlightRows, candidates: FlightRows | None
) -> dict[FlightKey, HealthAssessment]:
    """Judges the health of the motors in each flight of a vehicle by comparison with its healthy flights.

    Args:
        rows: rows of all flights of the vehicle, to be judged.
        baseline_rows: rows of the flights that the user states to be healthy (the baseline). If there are none, healthy
            flights are chosen among the ``candidates``.
        candidates: rows of the flights that may be chosen; None for all.

    Returns:
        The judgement of each flight by its key.
    """
    figures = {_flight_key(row): health_figures(row) for row in rows}
    if candidates is not None:
        candidate_keys = {_flight_key(row) for row in candidates}
        for key in figures.keys() - candidate_keys:
            # A flight that is marked as not sound is judged, too, but is not chosen as a healthy one.
            figures[key] = replace(figures[key], sound=False)
    baseline_figures = {}
    for row in baseline_rows:
        key = _flight_key(row)
        # A flight that is in the baseline as well must be the same object, so that it counts once.
        baseline_figures[key] = figures.get(key) or health_figures(row)
    assessments = assess_motor_health(
        list(figures.values()), list(baseline_figures.values()) or None
    )
    return dict(zip(figures, assessments, strict=True))


def _flight_key(row: FlightRow) -> FlightKey:
    """Returns the key of a row's flight, equal for all rows of it."""
    return row.key or row.file, row.vehicle, row.system, row.component


def row_key(row: FlightRow) -> RowKey:
    """Returns the key of a row, by which it differs from all others: flight and axis. A copy of a log has the same."""
    return *_flight_key(row), row.axis


def _model_inputs(row: FlightRow) -> tuple[object, ...]:
    """Returns axis, motors, inputs and their unit: if these agree, a model can be evaluated in another flight."""
    return row.axis, row.motors, row.inputs, row.input_unit


def residual_mean(row: FlightRow, healthy_models: Iterable[FlightRow]) -> float | None:
    """Returns the mean wind torque of a flight by the models of healthy flights: a large one may also be a fault.

    A model is: acceleration = effect · u − damping · ω + residual, with motor inputs u and body rate ω. In settled
    flight the mean acceleration is 0. With the changes Δu and Δω of mean input and rate since the healthy flight, the
    mean residual is damping Δω − effect · Δu. It is the mean wind torque, or a fault.

    Args:
        row: the flight on one axis.
        healthy_models: rows of healthy flights. Flights without a model of the same axis and inputs are left out, and
            so is the flight itself.

    Returns:
        The mean over the models, rad/s²; None if no model can be evaluated in this flight.
    """
    if row.mean_inputs is None or row.mean_outputs is None:
        return None
    residuals = []
    for model in healthy_models:
        is_same_flight = model.key == row.key
        if not model.effect or not model.mean_inputs or is_same_flight:
            continue
        if _model_inputs(model) != _model_inputs(row):
            continue
        model_inputs = column_array(model.mean_inputs, len(row.mean_inputs))
        input_change = np.subtract(row.mean_inputs, model_inputs)
        # The body rate is the last output. A row without means counts as one at rest.
        mean_rate_of_model = 0.0
        if model.mean_outputs:
            mean_rate_of_model = model.mean_outputs[-1]
        rate_change = row.mean_outputs[-1] - mean_rate_of_model
        effect = column_array(model.effect, len(input_change))
        damping = model.damping or 0.0
        residuals.append(float(damping * rate_change - effect @ input_change))
    if not residuals:
        return None
    return float(np.mean(residuals))


def track(
    folder: Path,
    names: Sequence[str],
    reader: WorkerPool | Cluster,
    baseline: Sequence[str] = (),
    page: MakePage | None = None,
    assess: AssessRows = assess_rows,
    progress: Progress = lambda *_: None,
) -> TrackedLogs:
    """Brings the table of a fleet up to date with logs.

    Logs that are new, or have changed since they were read, are read now, logs of the baseline first. Then the vehicles
    with new flights are judged, and the table is written.

    Args:
        folder: folder of the fleet, which is made if it does not exist.
        names: files, folders, patterns and URLs of logs.
        reader: workers that read the logs.
        baseline: names of healthy flights, or the folder of one fleet; if empty, the baseline of the last run. The name
            ``NO_BASELINE`` alone removes that.
        page: function that makes the page of a flight, as in ``Job``; None for no pages.
        assess: judges all flights of a vehicle.
        progress: function that is called as logs are read.

    Returns:
        The number of logs, how many were read now, the problems with others, and the rows of the baseline.

    Raises:
        Unreadable: the names match no log and the fleet does not exist, the baseline contains no flight or one with bad
            motors, the folder cannot be written, or its store is damaged.
    """
    logs, problems = find_logs(names, folder)
    if not logs and not is_fleet(folder):
        raise Unreadable(problems[0])
    with open_store(folder) as store:
        if page is not None:
            store.reread_logs_without_page()
        if list(baseline) == [NO_BASELINE]:
            store.healthy = []
        elif len(baseline) == 1 and is_fleet(Path(baseline[0])):
            store.healthy = _checked_baseline(read_rows(Path(baseline[0])))
        elif baseline:
            healthy_logs, unknown_names = find_logs(baseline, folder)
            if unknown_names:
                raise Unreadable(FleetFolderFact.BASELINE_UNKNOWN, reason=unknown_names[0])
            _read_new_logs(store, healthy_logs, reader, page, progress)
            store.healthy = _checked_baseline(store.rows_of(healthy_logs))
        read_count, unread_logs = _read_new_logs(store, logs, reader, page, progress)
        store.track(logs)
        publish_judgements(store, assess)
        return TrackedLogs(len(logs), read_count, (*problems, *unread_logs), store.healthy)


def _checked_baseline(rows: FlightRows) -> FlightRows:
    """Checks that the flights that the user named as healthy can serve as a baseline.

    Args:
        rows: rows of these flights in the fleet's table.

    Returns:
        The same rows.

    Raises:
        Unreadable: none of the flights has figures, or the motors of one are bad.
    """
    bad_row = row_with_bad_motors(rows)
    if bad_row is not None:
        raise Unreadable(FleetFolderFact.BASELINE_MOTORS_BAD, path=bad_row.file)
    has_flight_with_figures = any(row.is_read for row in rows)
    if has_flight_with_figures:
        return rows
    path = None
    reason = None
    if rows:
        # The first log stands for all that were named.
        path = rows[0].file
        reason = rows[0].status
    raise Unreadable(FleetFolderFact.BASELINE_WITHOUT_FLIGHT, path=path, reason=reason)


class _NewReadings(NamedTuple):
    """The outcome of reading the logs that are new or changed."""

    read_count: int
    """Number of logs that were read."""

    unread_logs: list[Fact]
    """A fact for each known log that cannot be read now."""


def _read_new_logs(
    store: Store,
    logs: Sequence[LogSource],
    reader: WorkerPool | Cluster,
    page: MakePage | None,
    progress: Progress,
) -> _NewReadings:
    """Reads new and changed logs in several processes, and adds each to the store as soon as it is read.

    A log that cannot be read now, for example because its server does not answer, keeps the rows of its last reading.

    Args:
        store: the open SQLite store of the fleet, with the rows of all logs.
        logs: the logs, read or not.
        reader: the processes that read logs, with their limits.
        page: function that makes the page of a flight; None for no pages.
        progress: function that is called before the first log, and after each one.

    Returns:
        The number of new logs, and a fact for each log that keeps the rows of its last reading.
    """
    new_logs = [log for log in logs if not store.has_read(log, reader.limits)]
    # The largest log is read first: if it were last, the other processes would have nothing left to do meanwhile.
    new_logs.sort(key=lambda log: -log.size)
    # Outcomes come in any order, and name their log by its path.
    sources = {log.path: log for log in new_logs}
    # A fact for each log that could not be read now, and keeps its rows.
    unread_logs = []
    progress(0, len(new_logs), None)
    with closing(_outcomes(store, new_logs, reader, page)) as outcomes:
        for done_count, outcome in enumerate(outcomes, 1):
            source = sources[outcome.path]
            if store.are_stored_rows_valid(source, outcome):
                reason = outcome.rows[0].status
                unread_logs.append(Fact(ReadingFact.LOG_KEPT, path=source.path, reason=reason))
            else:
                store.add(source, outcome, reader.limits)
            progress(done_count, len(new_logs), outcome)
    return _NewReadings(len(new_logs), unread_logs)


def _outcomes(
    store: Store, logs: Sequence[LogSource], reader: WorkerPool | Cluster, page: MakePage | None
) -> Generator[JobOutcome]:
    """Yields the outcome of each log as soon as it is read, first of logs that cannot be copies of each other.

    Args:
        store: the open store of the fleet, to which the caller adds each outcome before it takes the next.
        logs: the logs in the order in which they are to be read.
        reader: the processes that read logs, with their limits.
        page: function that makes the page of a flight; None for no pages.
    """
    for logs_of_round in _reading_rounds(logs):
        jobs = (
            Job(log.path, store.keys_of_size(log, reader.limits), page) for log in logs_of_round
        )
        with closing(reader.outcomes(jobs)) as outcomes:
            yield from outcomes


def _reading_rounds(logs: Iterable[LogSource]) -> list[list[LogSource]]:
    """Returns the logs in at most two rounds: the first log of each size, then further ones, which may be copies.

    Logs of a round are read at the same time. A copy in the second one is recognised by its hash, and not read.
    """
    first_of_size = []
    further_logs = []
    sizes = set()
    for log in logs:
        if log.size in sizes and log.size != UNKNOWN_SIZE:
            further_logs.append(log)
        else:
            first_of_size.append(log)
        sizes.add(log.size)
    return [logs_of_round for logs_of_round in (first_of_size, further_logs) if logs_of_round]
