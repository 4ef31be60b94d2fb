"""Rows of what ``mavdem learn`` wrote: the figures in ``report.json``, or those of a ``model.json`` alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mavdem.alignment.drive import INPUTS, TILT_AXES
from mavdem.analysis.figures import physical_values, wind_values
from mavdem.dem import Learned
from mavdem.errors import Unreadable
from mavdem.fleet.row import FlightRow

REPORT = "report.json"
MOTORS, DEMAND = INPUTS
LEARNT_FILES = (REPORT, "model.json")


def is_learnt(path: Path) -> bool:
    """Whether it is a file of a learnt flight, or the folder with them."""
    return path.suffix == ".json" or (path.is_dir() and (path / REPORT).is_file())


def rows_of_learnt(path: Path) -> list[FlightRow]:
    """A row an axis, with the figures that the file has.

    Raises:
        Unreadable: it cannot be read, or ``mavdem learn`` did not write it.
    """
    file = path / REPORT if path.is_dir() else path
    try:
        text = file.read_text()
        document = json.loads(text)
        if "free_energy" in document and "physical" not in document:
            document = _of_model(Learned.from_json(text))
        if "physical" not in document:
            raise ValueError("no figures of a vehicle")
        return _rows(path, document)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not of `mavdem learn`"
        raise Unreadable(f"{file} cannot be read ({reason}): name a {' or a '.join(LEARNT_FILES)}.") from None


def _of_model(learned: Learned) -> dict[str, Any]:
    """What a model alone has of a report."""
    return {
        "inputs": list(learned.record.input_names),
        "flight": {"scale": {"unit": learned.record.input_units[0] if learned.record.input_units else None}},
        "outputs": list(learned.record.output_names),
        "physical": physical_values(learned.physical),
        "wind": wind_values(learned.wind),
    }


def _rows(path: Path, report: Mapping[str, Any]) -> list[FlightRow]:
    flight, condition = report.get("flight") or {}, report.get("condition") or {}
    hover = report.get("hover") or condition.get("hover") or {}
    own = str(report["outputs"][0] if report.get("outputs") else flight.get("axis"))
    axes = report.get("axes") or {}
    # With --axis all there are figures of each axis; those of the model are one of them.
    figures: dict[str, Mapping[str, Any]] = {name: axes[name] for name in TILT_AXES if name in axes} or {own: report}
    return [
        FlightRow(
            axis=axis,
            **_who(path, report, flight),
            **_inputs(report, flight, hover),
            **_hover(hover, condition),
            **_physical(values.get("physical"), values.get("wind")),
        )
        for axis, values in figures.items()
    ]


def _who(path: Path, report: Mapping[str, Any], flight: Mapping[str, Any]) -> dict[str, Any]:
    identity = report.get("identity") or {}
    return {
        "file": str(flight.get("source") or path),
        "key": str(path),
        "vehicle": identity.get("name") or "unknown",
        "vehicle_basis": identity.get("basis"),
        "autopilot": flight.get("autopilot"),
        "frame": flight.get("vehicle"),
        "firmware": identity.get("firmware") or None,
        "date": identity.get("date"),
        "tier": report.get("tier") or "a",
    }


def _inputs(report: Mapping[str, Any], flight: Mapping[str, Any], hover: Mapping[str, Any]) -> dict[str, Any]:
    """The model's inputs, and the motors, which they need not be."""
    names: list[str] = list(report.get("inputs") or ())
    by_demand = len(names) == 1 and names[0].endswith(f" {DEMAND}")
    return {
        "motors": hover.get("motors") or (None if by_demand else names or None),
        "inputs": DEMAND if by_demand else MOTORS,
        "input_unit": (flight.get("scale") or {}).get("unit"),
    }


def _hover(hover: Mapping[str, Any], condition: Mapping[str, Any]) -> dict[str, Any]:
    if not hover:
        return {}
    intervals = condition.get("share_interval")
    battery = condition.get("battery") or {}
    return {
        "duration": hover["seconds"],
        "collective": float(np.mean(hover["trim_of_range"])),
        "trim_unit": hover.get("unit"),
        "trim": hover["trim"],
        "trim_share": hover["trim_share"],
        "trim_share_interval": intervals if intervals and None not in intervals else None,
        "headroom": hover["headroom"],
        "lean_roll": None if hover["roll"] is None else float(np.radians(hover["roll"])),
        "lean_pitch": None if hover["pitch"] is None else float(np.radians(hover["pitch"])),
        "tilt_sd": condition.get("tilt_sd"),
        "voltage_mean": battery.get("voltage_mean"),
    }


def _physical(found: Mapping[str, Any] | None, wind: Mapping[str, Any] | None) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    if found is not None:
        halves = found["interval_90_percent"]
        for name in ("effect", "damping", "lag"):
            columns |= {name: found[name], f"{name}_interval": halves[name], f"{name}_status": found["status"][name]}
    if wind is not None:
        columns |= {
            "wind_torque_sd": wind["sd"],
            "wind_torque_mean": wind["mean"],
            "wind_torque_interval": wind["mean_band"],
        }
    return columns
