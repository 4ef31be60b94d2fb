"""Tracking: from the logs that were named to the fleet's table, of which only what is new is read and judged.

A vehicle's flights are judged beside its healthy ones: by the balance of its motors (``mavdem.motors``), and by what
the models of healthy flights, frozen, leave unexplained in another.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues, Numbers
from mavdem.errors import Unreadable
from mavdem.facts import Fact, Facts
from mavdem.facts.fleet import Folder, Reading
from mavdem.facts.motors import HealthUnknown
from mavdem.fleet.cluster import Cluster
from mavdem.fleet.row import SHARED, UNKNOWN, FlightRow, FlightRows
from mavdem.fleet.sources import LogSource, find_logs
from mavdem.fleet.store import AssessRows, Store, is_fleet, opened, read_rows
from mavdem.fleet.workers import Job, MakePage, WorkerPool
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance import BalanceFigures, HealthFigures, motor_signatures
from mavdem.motors.health import assess

# of the time at its upper stop: with more a motor has nothing left, and the flight is not sound
SATURATED_SHARE = 0.01
OF_ASSESSMENT = ("health", "fault_probability", "change_probability", "suspect_motor")
BESIDE_OTHERS = ("health_reason", "health_code", "residual_mean")

Progress = Callable[[int, int], None]
"""Called with how many logs are done, and how many there are to read."""


class TrackedLogs(NamedTuple):
    """What a run did."""

    logs: int  # how many were named
    read: int  # how many of them were read; the others were known
    # of names that name no log, and of known logs that could not be read now
    problems: Facts
    healthy: FlightRows  # rows of the baseline


def assess_rows(rows: FlightRows, baseline: FlightRows) -> FlightRows:
    """Returns all rows of a vehicle, each judged beside its ``baseline`` or, without any, its first sound flights."""
    blank: JsonValues = dict.fromkeys((*OF_ASSESSMENT, *BESIDE_OTHERS)) | {"health": UNKNOWN}
    rows = [replace(row, **blank) for row in rows]
    flown = [row for row in rows if row.is_read]
    if not flown:
        return rows
    if not baseline and (flown[0].vehicle == UNKNOWN or flown[0].vehicle_basis == SHARED):
        unnamed = Fact(HealthUnknown.VEHICLE_UNNAMED)
        said: JsonValues = {"health_reason": unnamed.advised, "health_code": unnamed.code}
        return [replace(row, **said) if row.is_read else row for row in rows]
    healthy_rows = [row for row in baseline if row.is_read]
    judged = {_key(row): health_figures(row) for row in flown}
    # A flight that is among both is one flight.
    given = {_key(row): judged.get(_key(row)) or health_figures(row) for row in healthy_rows}
    vehicles = assess([*judged.values()], [*given.values()] or None)
    assessments = dict(zip(judged, vehicles, strict=True))
    models = healthy_rows or [row for row in flown if assessments[_key(row)].is_healthy]
    healthy = {(*_key(row), row.axis): row for row in models}.values()

    def with_health(row: FlightRow) -> FlightRow:
        assessment = assessments[_key(row)]
        return replace(
            row,
            **{name: getattr(assessment, name) for name in OF_ASSESSMENT},
            residual_mean=residual_mean(row, healthy),
            health_reason=str(assessment.fact),
            health_code=assessment.fact.code,
        )

    return [with_health(row) if row.is_read else row for row in rows]


def health_figures(row: FlightRow) -> HealthFigures:
    """Returns what a vehicle's health is judged by, of one flight's row."""
    motors = row.motors or ()
    balance = None
    signatures = None
    if row.balance is not None:
        balance = BalanceFigures(
            _array(row.balance, 3),
            _array(row.balance_error, 3),
            _array(row.balance_lean, 2),
            _array(row.lean_effect, 6).reshape(3, 2),
            _array(row.lean_effect_error, 6).reshape(3, 2),
            row.duration or 0.0,
        )
    if motors:
        numbers = tuple(range(len(motors)))
        layout = MotorGeometry(numbers, numbers, row.positions or (), spins=row.spins or ())
        signatures = motor_signatures(layout)
    name = f"{row.file} {row.system} {row.component}"
    sound = row.oscillation is None and max(row.saturated or (0.0,)) < SATURATED_SHARE
    return HealthFigures(
        name, motors, signatures, balance, row.date, row.collective, row.voltage_mean, sound
    )


def _key(row: FlightRow) -> tuple[object, ...]:
    """What the rows of one flight have in common."""
    return row.key or row.file, row.vehicle, row.system, row.component


def _kind(row: FlightRow) -> tuple[object, ...]:
    """What models must have in common to be driven by each other's inputs: motors and the demand are other inputs."""
    return row.axis, row.motors, row.inputs, row.input_unit


def _array(values: Numbers | None, count: int) -> Array:
    """As an array, NaN for what is not known."""
    return np.full(count, np.nan) if values is None else np.array(values, dtype=np.float64)


def residual_mean(row: FlightRow, healthy: Iterable[FlightRow]) -> float | None:
    """Returns the mean acceleration, rad/s², that frozen models of other ``healthy`` flights leave in this.

    None if unknown. In settled flight the mean acceleration is 0, so what the motors and the damping leave is the
    wind's.
    """
    if row.mean_inputs is None or row.mean_outputs is None:
        return None
    residuals = []
    for model in healthy:
        if (
            model.effect
            and model.mean_inputs
            and model.key != row.key
            and _kind(model) == _kind(row)
        ):
            more = np.subtract(row.mean_inputs, _array(model.mean_inputs, len(row.mean_inputs)))
            faster = row.mean_outputs[-1] - (model.mean_outputs or (0.0,))[-1]
            effect = _array(model.effect, len(more))
            residuals.append(float((model.damping or 0.0) * faster - effect @ more))
    return float(np.mean(residuals)) if residuals else None


def track(
    folder: Path,
    names: Sequence[str],
    reader: WorkerPool | Cluster,
    baseline: Sequence[str] = (),
    page: MakePage | None = None,
    assess: AssessRows = assess_rows,
    progress: Progress = lambda *_: None,
) -> TrackedLogs:
    """Brings the table of a fleet up to date with the logs that ``names`` stand for.

    The ``folder`` of the fleet is made if it is not there. ``names`` are files, folders, patterns and URLs, ``reader``
    reads them. ``baseline`` names healthy flights, or one fleet; it is as in the last run unless given. ``page`` is the
    function that makes a flight's page, as of ``Job``, ``assess`` judges all flights of a vehicle, and ``progress`` is
    called as logs are read. Raises Unreadable: there is no log, or the folder cannot be written to, or is damaged.
    """
    logs, problems = find_logs(names, folder)
    if not logs and not is_fleet(folder):
        raise Unreadable(problems[0])
    with opened(folder) as store:
        if page is not None:
            store.forget_lost_pages()
        if len(baseline) == 1 and is_fleet(Path(baseline[0])):
            store.healthy = _with_flight(read_rows(Path(baseline[0])))
        elif baseline:
            healthy, unknown = find_logs(baseline, folder)
            if unknown:
                raise Unreadable(Folder.BASELINE_UNKNOWN, because=unknown[0])
            _read(store, healthy, reader, page, progress)
            store.healthy = _with_flight(store.rows_of(healthy))
        read, unread = _read(store, logs, reader, page, progress)
        store.track(logs)
        store.publish(assess)
        return TrackedLogs(len(logs), read, (*problems, *unread), store.healthy)


def _with_flight(rows: FlightRows) -> FlightRows:
    """The rows of a baseline; raises ``Unreadable`` where there is no flight among them."""
    if not any(row.is_read for row in rows):
        path, why = (rows[0].file, rows[0].status) if rows else (None, None)
        raise Unreadable(Folder.BASELINE_WITHOUT_FLIGHT, path=path, because=why)
    return rows


def _read(
    store: Store,
    logs: Sequence[LogSource],
    reader: WorkerPool | Cluster,
    page: MakePage | None,
    progress: Progress,
) -> tuple[int, list[Fact]]:
    """Reads what is new; returns how many logs that were, and a fact for each known one that cannot be read."""
    # The largest first: were one the last, the other processes would wait for it.
    new = sorted(
        (log for log in logs if not store.knows(log, reader.limits)), key=lambda log: -log.size
    )
    sources = {log.path: log for log in new}
    unread = []
    jobs = (Job(log.path, store.keys_to_try(log, reader.limits), page) for log in new)
    progress(0, len(new))
    with closing(reader.outcomes(jobs)) as outcomes:
        for number, outcome in enumerate(outcomes, 1):
            source = sources[outcome.path]
            if store.keeps(source, outcome):
                why = outcome.rows[0].status
                unread.append(Fact(Reading.LOG_KEPT, path=source.path, because=why))
            else:
                store.add(source, outcome, reader.limits)
            progress(number, len(new))
    return len(new), unread
