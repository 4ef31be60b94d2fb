"""Rows of a log: all that it says of each vehicle and axis in it, as the fleet keeps it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mavdem.alignment.drive import TILT_AXES
from mavdem.alignment.signals import Signals, usual_rate
from mavdem.analysis import LogAnalysis, analyse
from mavdem.condition import condition_of, identity_of
from mavdem.errors import NotLearnable, Unreadable
from mavdem.fleet.row import DEMAND, FlightRow
from mavdem.fleet.workers import PAGES, LogRows
from mavdem.health.balance import BalanceFigures, balance_of_signals
from mavdem.ingest import Log, Telemetry, read_log

MakePage = Callable[[str, Mapping[str, LogAnalysis]], str]
"""From a log's name and its analyses by axis to the HTML of the flight's page."""


def rows_of_log(path: Path, key: str = "", page: MakePage | None = None) -> LogRows:
    """Returns a row for each vehicle and axis of a log; of a vehicle without settled flight one, whose status says why.

    Args:
        path: of the log.
        key: of the log's content, for the names of pages.
        page: makes the page of a flight; without it there is none.

    Raises:
        Unreadable: the log cannot be read.
    """
    log = read_log(path)
    rows: list[FlightRow] = []
    pages: dict[str, str] = {}
    for telemetry in log.vehicles:
        try:
            analyses, found = _analysed(log, telemetry, str(path))
        except (MemoryError, OSError, Unreadable):
            raise  # of the whole log
        except Exception as error:  # others in the log keep their rows
            if len(log.vehicles) == 1:
                raise
            status = f"This should not have happened ({type(error).__name__}: {error})."
            ids = telemetry.system, telemetry.component
            rows.append(FlightRow(file=str(path), status=status, system=ids[0], component=ids[1]))
            continue
        name = None
        if analyses and page is not None:
            name = f"{key[:16]}-{telemetry.system}-{telemetry.component}.html"
            pages[name] = page(path.name, analyses)
        rows += [replace(row, page=name and f"{PAGES}/{name}") for row in found]
    return LogRows(rows or [FlightRow(file=str(path), status="There is no vehicle in it.")], pages)


def _analysed(log: Log, telemetry: Telemetry, file: str) -> tuple[dict[str, LogAnalysis], list[FlightRow]]:
    """The analyses of a vehicle by axis, none without settled flight, and its rows."""
    signals = Signals(telemetry, inputs="motors")
    identity = identity_of(signals, log.receive_time[0])
    columns: dict[str, Any] = {"file": file, "component": telemetry.component, "date": identity.date}
    analyses: dict[str, LogAnalysis] = {}
    try:
        for axis in TILT_AXES:
            analyses[axis] = analyse(log, axis, f"{telemetry.system}:{telemetry.component}")
    except NotLearnable as error:
        report = {"identity": identity.as_dict(), "condition": condition_of(signals).as_dict(), "tier": None}
        return {}, [FlightRow.of(report, status=error.reason, **columns)]
    if all(analysis.tier.name is None for analysis in analyses.values()):
        first = analyses[TILT_AXES[0]]
        unknown = {"axis": None, "tier": None, "tier_reason": None, "attitude_rate": None, "motor_rate": None}
        return {}, [FlightRow.of(first.as_dict(), status=_why_nothing(first), warnings=(), **unknown, **columns)]
    columns |= _balance(balance_of_signals(signals))
    if signals.motors is not None:
        layout = signals.motors.layout
        columns |= {"positions": layout.positions or None, "spins": layout.spins or None}
    return analyses, [
        FlightRow.of(analysis.as_dict(), axis=axis, **columns, **_motor_rate(analysis, signals), **_means(analysis))
        for axis, analysis in analyses.items()
    ]


def _why_nothing(analysis: LogAnalysis) -> str:
    """Why a log holds no settled flight; its rates are not the cause where there is none at any rate."""
    measured = analysis.verdict.figures
    if measured.airborne and not measured.segments:
        return f"It holds no settled flight, between climb and landing, in {measured.airborne:.0f} s in the air."
    return analysis.reason


def _balance(balance: BalanceFigures | None) -> dict[str, Any]:
    if balance is None:
        return {}
    return {
        "balance": balance.mean,
        "balance_error": balance.error,
        "balance_lean": balance.lean,
        "lean_effect": np.ravel(balance.lean_effect),
        "lean_effect_error": np.ravel(balance.lean_effect_error),
    }


def _motor_rate(analysis: LogAnalysis, signals: Signals) -> dict[str, Any]:
    """The motors' rate where that of the analysis is the demand's, which drives its axis."""
    driven = Signals(signals.telemetry, analysis.verdict.axis).drive
    if driven is None or driven.scale.name != DEMAND:
        return {}
    return {"motor_rate": None if signals.motors is None else usual_rate(signals.motors) or None}


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
