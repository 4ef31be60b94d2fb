"""Flights of a log: all that it says of each vehicle and axis in it, as rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mavdem.alignment.drive import INPUTS, TILT_AXES
from mavdem.alignment.signals import Signals, usual_rate
from mavdem.analysis import LogAnalysis, analyse
from mavdem.condition import Condition, condition_of, identity_of
from mavdem.confidence import LEVEL
from mavdem.dem import Learned
from mavdem.errors import NotLearnable, Unreadable
from mavdem.fleet.row import FlightRow
from mavdem.health.balance import BalanceFigures, balance_of_signals
from mavdem.ingest import Log, Telemetry, read_log

MOTORS, DEMAND = INPUTS

WritePage = Callable[[str, Mapping[str, LogAnalysis], Path], None]
"""Called with a log's name, its analyses by axis and the path of the page."""


def rows_of_log(path: Path, page: WritePage | None, pages: str, key: str) -> list[FlightRow]:
    """A row for each vehicle and axis of a log; of a vehicle without settled flight one, whose status says why.

    Args:
        path: of the log.
        page: writes the page of a flight.
        pages: the folder for pages.
        key: of the log's content, for the page's name.

    Raises:
        Unreadable: the log cannot be read.
    """
    log = read_log(path)
    rows = [row for one in log.vehicles for row in _rows_or_reason(log, one, path, page, Path(pages), key)]
    return rows or [FlightRow(file=str(path), status="There is no vehicle in it.")]


def _rows_or_reason(
    log: Log, telemetry: Telemetry, path: Path, page: WritePage | None, pages: Path, key: str
) -> list[FlightRow]:
    """The rows of a vehicle; where reading it fails unexpectedly one that says so: others in the log keep theirs."""
    try:
        return _rows_of_vehicle(log, telemetry, path, page, pages, key)
    except (MemoryError, OSError, Unreadable):
        raise  # of the whole log
    except Exception as error:
        if len(log.vehicles) == 1:
            raise
        status = f"This should not have happened ({type(error).__name__}: {error})."
        return [FlightRow(file=str(path), system=telemetry.system, component=telemetry.component, status=status)]


def _rows_of_vehicle(
    log: Log, telemetry: Telemetry, path: Path, page: WritePage | None, pages: Path, key: str
) -> list[FlightRow]:
    signals = Signals(telemetry, inputs="motors")
    identity = identity_of(signals, log.receive_time[0])
    condition = condition_of(signals)
    head = partial(
        FlightRow,
        file=str(path),
        vehicle=identity.name,
        vehicle_basis=identity.basis,
        system=identity.system,
        component=telemetry.component,
        autopilot=identity.autopilot,
        frame=identity.frame,
        firmware=identity.firmware or None,
        date=identity.date,
        **_of_condition(condition),
    )
    analyses: dict[str, LogAnalysis] = {}
    for axis in TILT_AXES:
        try:
            analyses[axis] = analyse(log, axis, f"{telemetry.system}:{telemetry.component}")
        except NotLearnable as error:
            return [head(status=error.reason)]
    if all(one.tier.name is None for one in analyses.values()):
        return [head(status=_why_nothing(analyses[TILT_AXES[0]]))]
    written = None
    if page is not None and pages.is_dir():  # a worker of a cluster may not have the fleet's folder
        written = f"{pages.name}/{key[:16]}-{telemetry.system}-{telemetry.component}.html"
        page(path.name, analyses, pages.parent / written)
    balance = _of_balance(balance_of_signals(signals))
    layout = _of_layout(signals)
    return [
        head(axis=axis, page=written, **layout, **balance, **_of_analysis(one), **_motor_rate(one, signals))
        for axis, one in analyses.items()
    ]


def _why_nothing(found: LogAnalysis) -> str:
    """Why a log holds no settled flight; its rates are not the cause where there is none at any rate."""
    measured = found.verdict.figures
    if measured.airborne and not measured.segments:
        return f"It holds no settled flight, between climb and landing, in {measured.airborne:.0f} s in the air."
    return found.reason


def _of_condition(condition: Condition) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "duration": condition.settled,
        "collective": condition.collective,
        "tilt_sd": condition.tilt_sd,
        "tilt_max": condition.tilt_max,
    }
    columns |= {f"lean_{axis}": lean.mean for axis, lean in condition.lean.items()}
    if (battery := condition.battery) is not None:
        columns |= {
            "voltage_start": battery.voltage_start,
            "voltage_end": battery.voltage_end,
            "voltage_mean": battery.voltage_mean,
        }
    if (vibration := condition.vibration) is not None:
        columns |= {"vibration": vibration.level, "clips": vibration.clips}
    if (hover := condition.hover) is not None:
        columns |= {
            "motors": hover.motors,
            "trim_unit": hover.unit,
            "trim": hover.trim,
            "trim_share": hover.trim_share,
            "trim_share_interval": condition.share_interval,
            "headroom": hover.headroom,
            "saturated": hover.at_upper_limit,
            "inputs": MOTORS,
            "input_unit": hover.unit,
            "mean_inputs": hover.trim,
        }
    return columns


def _of_layout(signals: Signals) -> dict[str, Any]:
    if signals.motors is None:
        return {}
    layout = signals.motors.layout
    return {"positions": layout.positions or None, "spins": layout.spins or None}


def _of_balance(balance: BalanceFigures | None) -> dict[str, Any]:
    if balance is None:
        return {}
    return {
        "balance": balance.mean,
        "balance_error": balance.error,
        "balance_lean": balance.lean,
        "lean_effect": np.ravel(balance.lean_effect),
        "lean_effect_error": np.ravel(balance.lean_effect_error),
    }


def _of_analysis(found: LogAnalysis) -> dict[str, Any]:
    """The columns of one axis."""
    measured = found.verdict.figures
    columns: dict[str, Any] = {
        "tier": found.tier.name,
        "tier_reason": found.reason or None,
        "attitude_rate": measured.attitude_rate,
        "warnings": (
            *(alarm.sentence for alarm in found.alarms if alarm.motor is not None),
            *(found.verdict.cautions if found.learned is None else found.learned.cautions),
        ),
    }
    if found.learned is not None:
        columns |= _of_model(found, found.learned)
    return columns


def _motor_rate(found: LogAnalysis, signals: Signals) -> dict[str, Any]:
    """The motors' rate: that of the analysis is the demand's where this drives it."""
    driven = Signals(signals.telemetry, found.verdict.axis).drive
    if driven is None or driven.scale.name != DEMAND:
        return {"motor_rate": found.verdict.figures.motor_rate}
    return {"motor_rate": None if signals.motors is None else usual_rate(signals.motors) or None}


def _of_model(found: LogAnalysis, learned: Learned) -> dict[str, Any]:
    inputs = np.concatenate([flight.inputs for flight in found.flights]).mean(axis=0)
    outputs = np.concatenate([flight.outputs for flight in found.flights]).mean(axis=0)
    first = found.flights[0]
    columns: dict[str, Any] = {
        "inputs": DEMAND if first.provenance["scale"]["name"] == DEMAND else MOTORS,
        "input_unit": first.input_units[0],
        "mean_inputs": inputs,
        "mean_outputs": outputs,
    }
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
        }
        if physical.identifiable:
            # In settled flight the mean acceleration is 0, so what the motors and the damping leave is the wind's.
            columns |= {
                "residual_gain_inputs": -physical.effect,
                "residual_gain_outputs": (0.0, physical.damping),
                "residual_offset": float(physical.effect @ inputs - physical.damping * outputs[-1]),
            }
    return columns
