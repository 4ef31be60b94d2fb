"""Rows of a log, or of what was learned from one: all that it says of each vehicle and axis, as the fleet keeps it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mavdem.alignment.drive import TILT_AXES
from mavdem.alignment.signals import Signals, usual_rate
from mavdem.analysis import LogAnalysis, analyse
from mavdem.analysis.figures import physical_values, wind_values
from mavdem.condition import WindVelocity
from mavdem.condition.wind_of_log import Air, air_of
from mavdem.dem import Drag, Learned
from mavdem.errors import Unreadable
from mavdem.fleet.row import DEMAND, NOT_IDENTIFIABLE, FlightRow
from mavdem.fleet.store import is_fleet, read_rows
from mavdem.fleet.workers import PAGES, LogRows
from mavdem.health.balance import balance_of_signals
from mavdem.ingest import Log, Telemetry, read_log

# of what `mavdem learn` writes, those with figures
REPORT = "report.json"
MODEL = "model.json"
MakePage = Callable[[str, Mapping[str, LogAnalysis], Air], str]


def rows_of_log(path: Path, key: str = "", page: MakePage | None = None) -> LogRows:
    """Returns a row for each vehicle and axis of a log, and pages by their names.

    A vehicle without settled flight has one row, whose status says why. Pages are named by the ``key`` of the log's
    content, and made by ``page`` from the log's name, its analyses by axis and the wind; raises ``Unreadable``.
    """
    log = read_log(path)
    rows = []
    pages = {}
    for telemetry in log.vehicles:
        system = telemetry.system
        component = telemetry.component
        try:
            found, analyses, air = _rows_of_vehicle(log, telemetry, str(path))
        except (MemoryError, OSError, Unreadable):
            raise  # of the whole log
        except Exception as error:  # others in the log keep their rows
            if len(log.vehicles) == 1:
                raise
            status = f"This should not have happened ({type(error).__name__}: {error})."
            rows.append(
                FlightRow(file=str(path), status=status, system=system, component=component)
            )
            continue
        if analyses and page is not None:
            name = f"{key[:16]}-{system}-{component}.html"
            pages[name] = page(path.name, analyses, air)
            found = [replace(row, page=f"{PAGES}/{name}") for row in found]
        rows += found
    return rows or [FlightRow(file=str(path), status="There is no vehicle in it.")], pages


def _rows_of_vehicle(
    log: Log, telemetry: Telemetry, file: str
) -> tuple[list[FlightRow], dict[str, LogAnalysis], Air]:
    """The rows of a vehicle, its analyses by axis, none without settled flight, and its wind."""
    signals = Signals(telemetry, inputs="motors")
    first = None
    air = air_of(signals)
    analyses: dict[str, LogAnalysis] = {}
    for axis in TILT_AXES:
        analyses[axis] = analyse(log, axis, signals=signals, other_axis=first)
        first = first or analyses[axis]
    assert first is not None
    columns: dict[str, Any] = {
        "file": file,
        "component": telemetry.component,
        "date": first.identity.date,
    }
    if all(analysis.tier.name is None for analysis in analyses.values()):
        unknown = dict.fromkeys(("axis", "tier", "tier_reason", "attitude_rate", "motor_rate"))
        return (
            [
                FlightRow.of(
                    first.as_dict(), status=first.refusal.reason, warnings=(), **unknown, **columns
                )
            ],
            {},
            air,
        )
    if (balance := balance_of_signals(signals)) is not None:
        columns |= {
            "balance": balance.mean,
            "balance_error": balance.error,
            "balance_lean": balance.lean,
        }
        columns |= {
            name: np.ravel(getattr(balance, name)) for name in ("lean_effect", "lean_effect_error")
        }
    columns |= {} if air[0] is None else _wind(air[0])
    if signals.motors is not None:
        layout = signals.motors.layout
        columns |= {"positions": layout.positions or None, "spins": layout.spins or None}
    rows = []
    for axis, analysis in analyses.items():
        row = FlightRow.of(analysis.as_dict(), axis=axis, **columns, **_means(analysis))
        driven = signals.about(axis).drive
        # the rate of the analysis is the demand's
        if driven is not None and driven.scale.name == DEMAND:
            row = replace(
                row,
                motor_rate=None if signals.motors is None else usual_rate(signals.motors) or None,
            )
        rows.append(row)
    return rows, analyses, air


def _wind(wind: WindVelocity) -> dict[str, Any]:
    drag = wind.drag
    columns = dict[str, Any]()
    if wind.status["speed"] != NOT_IDENTIFIABLE:
        columns |= {"wind_speed": wind.speed, "wind_speed_interval": wind.speed_interval}
    if wind.directed:
        columns |= {
            f"wind_{key}": np.radians(getattr(wind, key))
            for key in ("direction", "direction_interval")
        }
    half = [np.ptp(drag.interval(name), axis=0) / 2 for name in ("linear", "quadratic")]
    return columns | {"drag": (*drag.linear, *drag.quadratic), "drag_interval": np.ravel(half)}


def _means(analysis: LogAnalysis) -> dict[str, Any]:
    """What the frozen model of a flight leaves unexplained in another, as gains of that flight's means."""
    if analysis.learned is None:
        return {}
    inputs = np.concatenate([flight.inputs for flight in analysis.flights]).mean(axis=0)
    outputs = np.concatenate([flight.outputs for flight in analysis.flights]).mean(axis=0)
    columns: dict[str, Any] = {"mean_inputs": inputs, "mean_outputs": outputs}
    physical = analysis.learned.physical
    if physical is not None and physical.identifiable:
        # In settled flight the mean acceleration is 0, so what the motors and the damping leave is the wind's.
        columns |= {
            "residual_gain_inputs": -physical.effect,
            "residual_gain_outputs": (0.0, physical.damping),
            "residual_offset": float(physical.effect @ inputs - physical.damping * outputs[-1]),
        }
    return columns


def is_learned(path: Path) -> bool:
    """Returns whether it is a file of a learned flight, or the folder with them."""
    return path.suffix == ".json" or (path / REPORT).is_file()


def earlier_flight(path: Path, axis: str) -> Learned:
    """Returns a ``model.json``, or that in a folder, whose physical parameters can be a prior.

    Raises Unreadable: it cannot be read, is of another axis, or its flight does not identify the motors' effect.
    """
    try:
        learned = Learned.from_json(_text(path / MODEL if path.is_dir() else path))
    except (OSError, ValueError) as error:
        raise Unreadable(f"{path} is no learned model: {error}.") from None
    if learned.record.output_names[:1] != (axis,):
        raise Unreadable(
            f"{path} is not a model of {axis}: learn the earlier flight with --axis {axis}."
        )
    if learned.physical is None or not learned.physical.identifiable:
        raise Unreadable(
            f"{path} does not know the motors' effect: learn from a flight with steering on {axis}."
        )
    return learned


def _text(path: Path) -> str:
    if path.is_fifo():
        raise OSError("it is a pipe, whose writer may never come")
    return path.read_text()


def earlier_drag(path: Path, vehicle: str, speed: float | None = None) -> Drag:
    """Returns the drag of earlier flights: of what ``mavdem learn`` or ``mavdem wind --json`` wrote, or of a fleet.

    Of the folder or a ``model.json`` the report beside it counts; of a fleet, the ``vehicle``'s best known drag. The
    flight with this very wind ``speed``, m/s, is the one in question, and none before it.

    Raises:
        Unreadable: it cannot be read, is of the flight in question, or holds no drag of that vehicle.
    """
    if is_fleet(path):
        rows = [
            row
            for row in read_rows(path)
            if row.vehicle == vehicle and row.drag and row.drag_interval
        ]
        rows = [row for row in rows if row.wind_speed != speed]
        if not rows:
            raise Unreadable(
                f"{path} holds no drag of {vehicle}: run `mavdem track` on its flights with legs."
            )
        axes = [(row.drag or (), row.drag_interval or ()) for row in rows]
        return Drag.of_axes(
            *min(axes, key=lambda both: sum(np.divide(both[1], both[0])))
        ).of_next_flight()
    file = (
        path / REPORT if path.is_dir() else path.with_name(REPORT) if path.name == MODEL else path
    )
    try:
        read = json.loads(_text(file))
        told = read.get("wind_velocity", read)
        drag = Drag.from_dict(told["drag"]).of_next_flight()
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        why = f" ({error.strerror or error})" if isinstance(error, OSError) else ""
        what = f"{file} holds no drag{why}: give a {REPORT} of a flight with wind, or a `mavdem wind --json`."
        raise Unreadable(what) from error
    if told.get("speed") == speed is not None:
        raise Unreadable(
            f"{file} is of this very flight, whose drag would count twice: give that of another flight."
        )
    return drag


def rows_of_learned(path: Path) -> list[FlightRow]:
    """Returns a row an axis of what ``mavdem learn`` wrote: its folder, its report, or a model alone.

    Raises Unreadable: it cannot be read, or ``mavdem learn`` did not write it.
    """
    file = path / REPORT if path.is_dir() else path
    try:
        text = _text(file)
        report = json.loads(text)
        if "free_energy" in report and "physical" not in report:
            learned = Learned.from_json(text)
            record = learned.record
            report = {
                "physical": physical_values(learned.physical),
                "wind": wind_values(learned.wind_torque),
            }
            report |= {"inputs": record.input_names, "outputs": record.output_names}
            report |= {"flight": {"scale": {"unit": next(iter(record.input_units), None)}}}
        if "physical" not in report:
            raise ValueError("no figures of a vehicle")
        source = {"file": str((report.get("flight") or {}).get("source") or path), "key": str(path)}
        # With --axis all there are figures of each axis; those of the model are one of them.
        axes = {
            axis: values for axis in TILT_AXES if (values := (report.get("axes") or {}).get(axis))
        }
        rows = [FlightRow.of(report | values, axis=axis, **source) for axis, values in axes.items()]
        return rows or [FlightRow.of(report, **source)]
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not of `mavdem learn`"
        raise Unreadable(
            f"{file} cannot be read ({reason}): name a {REPORT} or a {MODEL}."
        ) from None
