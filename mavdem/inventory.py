"""Inventory: what a log holds, who sent it, what is damaged, and which vehicles a model can be learnt from."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from mavdem.align import segments
from mavdem.ingest import Log
from mavdem.read import choose_vehicle
from mavdem.telemetry import Columns, Telemetry
from mavdem.verdict import judge

ENOUGH = 50
"""Messages that a stream must hold before the regularity of its steps says anything."""


def inventory(log: Log, axis: str = "roll", vehicle: str | None = None, inputs: str | None = None) -> dict[str, Any]:
    """Everything there is to know of a log before learning, as plain JSON values; times in s, rates in Hz.

    Of each speaker ``lost_share`` is the share of its sequence numbers that do not occur, and of a vehicle
    ``missing_share`` the share of messages missing from a stream by the stream's usual step, the median over its
    streams; None where there are none. A link loses messages of all kinds alike: where ``missing_share`` is near 0, the
    sequence numbers that do not occur are of kinds that the log leaves out. A change of rates raises ``missing_share``
    but not ``lost_share``; only both together mean a loss.

    Args:
        log: as ``mavdem.ingest.read_log`` gives it.
        axis: "roll" or "pitch": which model the verdicts are about.
        vehicle: "system" or "system:component", to leave the others out.
        inputs: of the model, as for :func:`mavdem.read_flight`.

    Raises:
        NotLearnable: there is no such vehicle.
        ValueError: an axis or inputs that are neither.
    """
    vehicles = log.vehicles if vehicle is None else (choose_vehicle(log.vehicles, vehicle),)
    missing = {(one.system, one.component): _missing_share(one) for one in log.vehicles}
    described = [_vehicle(telemetry, axis, inputs, log) for telemetry in vehicles]
    return {
        "source": log.source,
        "frames": log.frames,
        "bytes_skipped": log.bytes_skipped,
        "receive_time": list(log.receive_time),
        "unread": [asdict(unread) for unread in log.unread],
        "speakers": [
            {
                "system": speaker.system,
                "component": speaker.component,
                "kind": speaker.kind,
                "messages": sum(speaker.messages.values()),
                "lost": speaker.lost,
                "lost_share": speaker.lost / max(speaker.lost + sum(speaker.messages.values()), 1),
                "missing_share": missing.get((speaker.system, speaker.component)),
            }
            for speaker in log.speakers
        ],
        "vehicles": described,
        "learnable": any(one["verdict"]["learnable"] for one in described),
    }


def _vehicle(telemetry: Telemetry, axis: str, inputs: str | None, log: Log) -> dict[str, Any]:
    return {
        "system": telemetry.system,
        "component": telemetry.component,
        "vehicle": telemetry.vehicle,
        "autopilot": telemetry.autopilot,
        "translated_from": telemetry.translated_from,
        "parameters": len(telemetry.parameters),
        "messages": {
            name: {"count": len(columns["time"]), "rate": _rate(columns)}
            for name, columns in sorted(telemetry.messages.items())
        },
        "boots": len(set().union(*(np.unique(columns["boot"]).tolist() for columns in telemetry.messages.values()))),
        "segments": [
            {**asdict(segment), "duration": segment.duration} for segment in segments(telemetry, axis, inputs)
        ],
        "repairs": list(telemetry.repairs),
        "verdict": asdict(judge(telemetry, axis, inputs, log.speakers)),
    }


def _rate(columns: Columns) -> float | None:
    """Messages a second from the first to the last of each boot; None where no two are apart in time."""
    boots = [_span(columns["time"][columns["boot"] == boot]) for boot in np.unique(columns["boot"])]
    seconds = sum(span for _, span in boots)
    return sum(steps for steps, _ in boots) / seconds if seconds > 0 else None


def _missing_share(telemetry: Telemetry) -> float | None:
    shares = []
    for columns in telemetry.messages.values():
        time, boot = columns["time"], columns["boot"]
        steps = np.diff(time)[np.diff(boot) == 0]
        # Of the middle half: a loop of 4 ms makes 8 and 12 of 10, and by neither alone one that is gone is told.
        usual = float(trim_mean(steps, 0.25)) if len(time) >= ENOUGH and len(steps) else 0.0
        if usual > 0:
            # A quarter of a step is jitter.
            missing = float(np.maximum(np.rint(steps / usual - 0.25) - 1, 0).sum())
            shares.append(missing / (missing + len(time)))
    return float(np.median(shares)) if shares else None


def _span(time: NDArray[np.float64]) -> tuple[int, float]:
    """Steps between the stamps, and the seconds they take."""
    return len(time) - 1, float(time[-1] - time[0])
