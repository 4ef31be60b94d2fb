"""Flights of a log: all that it says of each vehicle and axis in it, as rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mavdem.alignment.drive import TILT_AXES
from mavdem.analysis import LogAnalysis, analyse
from mavdem.dem import Learned
from mavdem.dem.parallel import stay_in_this_process
from mavdem.errors import NotLearnable
from mavdem.fleet.row import FlightRow
from mavdem.ingest import Telemetry, read_log

LEVEL = 0.9  # of all intervals
SLOW_MOTION_HZ = 8.0  # attitude and motors for tier b


def rows_of_log(path: Path, page: Callable[..., Any] | None, pages: str, key: str) -> list[FlightRow]:
    """A row for each vehicle and axis of a log; of a vehicle without settled flight one, whose status says why.

    Args:
        path: of the log.
        page: writes a flight's page: called with the analyses by axis and a path.
        pages: the folder for it.
        key: of the log's content, for the page's name.

    Raises:
        Unreadable: the log cannot be read.
    """
    stay_in_this_process()  # others like it have the other cores
    log = read_log(path)
    rows: list[FlightRow] = []
    for telemetry in log.vehicles:
        name = f"{telemetry.system}:{telemetry.component}"
        head = partial(FlightRow, file=str(path), **_who(telemetry))
        analyses: dict[str, LogAnalysis] = {}
        reason = ""
        for axis in TILT_AXES:
            try:
                analyses[axis] = analyse(log, axis, name)
            except NotLearnable as error:
                reason = error.reason
        flown = {axis: one for axis, one in analyses.items() if _tier(one) is not None}
        if not flown:
            reasons = [one.reason for one in analyses.values() if one.reason]
            rows.append(head(status=reasons[0] if reasons else reason))
            continue
        place = f"{key[:16]}-{telemetry.system}-{telemetry.component}.html" if page and pages else None
        if page and place:
            page(flown, Path(pages) / place)
        rows += [
            head(axis=axis, page=f"{Path(pages).name}/{place}" if place else None, **_figures(one))
            for axis, one in flown.items()
        ]
    return rows or [FlightRow(file=str(path), status="There is no vehicle in it.")]


def _who(telemetry: Telemetry) -> dict[str, Any]:
    return {
        "system": telemetry.system,
        "autopilot": telemetry.autopilot,
        "frame": telemetry.vehicle,
        "firmware": telemetry.firmware or None,
    }


def _tier(found: LogAnalysis) -> str | None:
    if found.learned is not None:
        return "a"
    if found.vehicle.hover is None:
        return None
    figures = found.verdict.figures
    return "b" if min(figures.attitude_rate or 0, figures.motor_rate or 0) >= SLOW_MOTION_HZ else "c"


def _figures(found: LogAnalysis) -> dict[str, Any]:
    """All columns that the analysis of one axis fills."""
    measured = found.verdict.figures
    return {
        "tier": _tier(found),
        "tier_reason": found.reason or None,
        "duration": measured.duration,
        "attitude_rate": measured.attitude_rate,
        "motor_rate": measured.motor_rate,
        "warnings": found.verdict.cautions if found.learned is None else found.learned.cautions,
        **_condition(found),
        **({} if found.learned is None else _model(found, found.learned)),
    }


def _condition(found: LogAnalysis) -> dict[str, Any]:
    hover = found.vehicle.hover
    if hover is None:
        return {}
    layout: Mapping[str, Any] = found.verdict.flight.provenance.get("motors", {}) if found.verdict.flight else {}
    return {
        "duration": hover.seconds,
        "motors": hover.motors,
        "positions": layout.get("positions") or None,
        "spins": layout.get("spins") or None,
        "input_unit": hover.unit,
        "trim": hover.trim,
        "collective": float(np.mean(hover.trim_of_range)),
        "trim_share": hover.trim_share,
        "headroom": hover.headroom,
        "saturated": hover.at_upper_limit,
        "lean_roll": None if hover.roll is None else np.radians(hover.roll),
        "lean_pitch": None if hover.pitch is None else np.radians(hover.pitch),
    }


def _model(found: LogAnalysis, learned: Learned) -> dict[str, Any]:
    inputs = np.concatenate([flight.inputs for flight in found.flights]).mean(axis=0)
    outputs = np.concatenate([flight.outputs for flight in found.flights]).mean(axis=0)
    columns: dict[str, Any] = {"mean_inputs": inputs, "mean_outputs": outputs}
    if (held_out := found.held_out) is not None:
        columns |= {"error_ratio": held_out.error_ratio(), "coverage": held_out.coverage}
    if (wind := learned.wind) is not None:
        columns |= {
            "wind_torque_sd": wind.sd,
            "wind_torque_mean": wind.mean,
            "wind_torque_interval": wind.mean_band,
        }
    if (physical := learned.physical) is not None:
        half = physical.interval(LEVEL)
        columns |= {
            "effect": physical.effect,
            "damping": physical.damping,
            "lag": physical.lag,
            "effect_interval": half.effect,
            "damping_interval": half.damping,
            "lag_interval": half.lag,
            **{f"{name}_status": physical.status[name] for name in ("effect", "damping", "lag")},
            # In settled flight the mean acceleration is 0, so what the motors and the damping leave is the wind's.
            "residual_gain_inputs": -physical.effect,
            "residual_gain_outputs": (0.0, physical.damping),
            "residual_offset": float(physical.effect @ inputs - physical.damping * outputs[-1]),
        }
    return columns
