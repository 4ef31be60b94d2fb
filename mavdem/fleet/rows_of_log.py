"""Rows of a log: all that it says of each vehicle and axis, as the fleet keeps it."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_signals
from mavdem.assessment.axis import LogAnalysis
from mavdem.assessment.record import NoLoop
from mavdem.containers import JsonValues
from mavdem.dataset.axes import AXES
from mavdem.dataset.signals import Signals
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.fleet import Reading
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.fleet.workers import PAGES, LogRows, MakePage, fault
from mavdem.ingest import read_log
from mavdem.loops.axis_loops import Loop
from mavdem.motors.balance import balance_of_signals
from mavdem.wind_velocity.estimation import WindVelocity

# of what `mavdem learn` writes, those with figures
REPORT = "report.json"
MODEL = "model.json"


def rows_of_log(path: Path, key: str = "", page: MakePage | None = None) -> LogRows:
    """Returns a row for each vehicle and axis of a log, and pages by their names.

    A vehicle without settled flight has one row, whose status says why. Pages are named by the ``key`` of the log's
    content, and made by ``page`` from the log's name and its assessment; raises ``Unreadable``.
    """
    log = read_log(path)
    rows = []
    pages = {}
    for telemetry in log.vehicles:
        try:
            assessment = assess_signals(log, Signals(telemetry)).with_axis("pitch")
            judged = rows_of_assessment(assessment, str(path))
        except (MemoryError, OSError, Unreadable):
            raise  # of the whole log
        except Exception as error:  # others in the log keep their rows
            if len(log.vehicles) == 1:
                raise
            rows.append(
                FlightRow.without_flight(
                    str(path), fault(error), system=telemetry.system, component=telemetry.component
                )
            )
            continue
        if judged[0].has_flight and page is not None:
            name = f"{key[:16]}-{telemetry.system}-{telemetry.component}.html"
            pages[name] = page(path.name, assessment)
            judged = [replace(row, page=f"{PAGES}/{name}") for row in judged]
        rows += judged
    return rows or [FlightRow.without_flight(str(path), Fact(Reading.NO_VEHICLE))], pages


def rows_of_assessment(assessment: Assessment, file: str) -> FlightRows:
    """Returns a row for each axis that the ``assessment`` of a vehicle has an analysis of.

    ``file`` is the name of its log. Without settled flight there is one row, of no axis, whose status says why.
    """
    first = assessment.analysis
    assert first is not None and assessment.evidence is not None
    signals = assessment.evidence.signals.for_axis(AXES[0], "motors")
    columns = {"file": file, "component": signals.telemetry.component}
    judged = assessment.judgement_values | {"headline_fact": assessment.headline}
    if all(analysis.tier.tier is None for analysis in assessment.analyses.values()):
        unknown = dict.fromkeys(("axis", "tier", "tier_reason", "attitude_rate"))
        reason = first.reason or assessment.headline
        row = FlightRow.of(
            first.as_dict() | judged,
            status=reason.advised,
            status_code=reason.code,
            warnings=(),
            warning_codes=(),
            **unknown,
            **columns,
        )
        return [row]
    if (balance := balance_of_signals(signals)) is not None:
        columns |= {
            "balance": balance.mean,
            "balance_error": balance.error,
            "balance_lean": balance.lean,
            "lean_effect": balance.lean_effect.ravel(),
            "lean_effect_error": balance.lean_effect_error.ravel(),
        }
    columns |= {} if assessment.wind is None else _wind(assessment.wind)
    if signals.motors is not None:
        layout = signals.motors.geometry
        columns |= {"positions": layout.positions or None, "spins": layout.spins or None}
    rows = []
    for axis, analysis in assessment.analyses.items():
        report = analysis.as_dict() | judged
        loop = assessment.loops[axis]
        margins = {} if isinstance(loop, NoLoop) else _margins(loop)
        rows.append(FlightRow.of(report, axis=axis, **columns, **margins, **_means(analysis)))
    return rows


def _wind(wind: WindVelocity) -> JsonValues:
    drag = wind.drag
    columns = JsonValues()
    if wind.speed_identifiable:
        speed = None if wind.calm else wind.speed
        columns |= {"wind_speed": speed, "wind_speed_interval": wind.speed_interval}
    if wind.direction_identifiable:
        columns |= {
            f"wind_{key}": np.radians(getattr(wind, key))
            for key in ("direction", "direction_interval")
        }
    half = [np.ptp(drag.interval(name), axis=0) / 2 for name in ("linear", "quadratic")]
    return columns | {"drag": (*drag.linear, *drag.quadratic), "drag_interval": np.ravel(half)}


def _margins(loop: Loop) -> JsonValues:
    """The margins of a rate loop; none that is infinite."""
    return {
        "phase_margin": np.radians(loop.phase_margin),
        "phase_margin_interval": np.radians(np.ptp(loop.phase_margin_interval)) / 2,
        "gain_margin": loop.gain_margin,
        "gain_margin_interval": np.ptp(loop.gain_margin_interval) / 2,
    }


def _means(analysis: LogAnalysis) -> JsonValues:
    """The means of what the model has seen."""
    if analysis.learned is None:
        return {}
    return {
        f"mean_{name}": np.concatenate([getattr(flight, name) for flight in analysis.flights]).mean(
            axis=0
        )
        for name in ("inputs", "outputs")
    }


def text_of(path: Path) -> str:
    """Returns what a file holds; raises ``OSError``, also of a pipe or a device, which may never end."""
    if path.is_fifo() or path.is_char_device():
        raise OSError(errno.ESPIPE, os.strerror(errno.ESPIPE))
    return path.read_text()
