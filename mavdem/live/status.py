"""What a live session reports: one status of the link, the vehicle and the learning, and events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import nan
from typing import Any, NamedTuple

from mavdem.dem import Estimate
from mavdem.health.motor_watch import MotorAlarm


def sentence(text: str) -> str:
    """``text`` with a capital letter and one full stop; empty if it is."""
    text = text.rstrip(". ")
    return f"{text[:1].upper()}{text[1:]}." if text else ""


class Event(NamedTuple):
    """One event: the UNIX time ``received``, s, of the bytes that caused it, and a ``sentence``."""

    received: float
    sentence: str


NOT_FLYING = "The vehicle is on the ground."
FLIGHT_UNKNOWN = "Nothing shows yet whether the vehicle flies."
NO_FLIGHT = NOT_FLYING, FLIGHT_UNKNOWN
UNCONFIRMED = (
    "The vehicle did not confirm that its message rates were restored (the link was lost?): reboot it, or set them "
    "again."
)
NOT_SETTLED = "This part of the flight is not learned from: climb, landing or strong tilt."
ACCOUNT = {
    "learned": "learned from (what was taken back after a landing included)",
    "unsettled": "in the air, but climbing, landing, tilted too far, or at the beginning of a segment",
    "on_ground": "on the ground",
    "waiting": "without attitude and motor outputs that come fast enough",
    "silent": "without a message",
    "link_lost": "with the link lost",
    "no_vehicle": "without a vehicle",
}
"""What the seconds of a session are accounted for as."""


AHEAD = 0.25  # s; how well the model predicts so far ahead is reported
HORIZONS = 0.05, 0.1, AHEAD, 0.5
"""Seconds ahead of a live session's predictions, besides one step."""


def horizons(dt: float) -> tuple[int, ...]:
    """The horizons of a live session in steps of ``dt``, s."""
    return tuple(sorted({1, *(max(1, round(seconds / dt)) for seconds in HORIZONS)}))


@dataclass(frozen=True)
class SessionStatus:
    """The status of a live session at one moment.

    ``LiveStream`` fills in what concerns the link and the vehicle, ``LiveSession`` the rows, the latency and the
    silence of the link. ``dataclasses.asdict`` turns it into plain JSON values.

    Attributes:
        vehicle: the followed vehicle, "system:component"; ``None`` before one is chosen.
        obstacle: why there are no rows or no new model; empty while all is well.
        rates: Hz of the vehicle's attitude and motor messages over the last two seconds of its clock, by name.
        flying: whether the vehicle is armed and airborne.
        learned, shown: rows that the learner used, and rows that were only shown.
        latency: median and 99th percentile, s, from the link to the estimate.
        ahead: about ``AHEAD`` seconds ahead, and the half width, rad, of the 90 % band of the angle predicted there.
        useful: seconds of the longest useful horizon (``Estimate.useful``), and the squared error of predictions there
            over that of the better of the last sample and the mean so far; NaN where there is none.
        lost: messages of the vehicle missing by its sequence numbers.
        late: samples that came too late for their row.
        outlier_stamps: messages with outlier time stamps.
        frames, unread: complete frames, and those of another dialect or damaged.
        garbage: bytes that belong to no frame.
        senders: each sender kept: system, component, kind, autopilot, frames, lost, flies.
        others: frames of senders that are no longer kept.
        alarms: lasting changes of the motors' balance, the latest of all boots; those without a motor are no alarms.
        alarm_count: number of these so far.
        alarm: the sentence of the latest alarm on a motor in this boot and this flight; it stays after the landing.
    """

    vehicle: str | None = None
    obstacle: str = ""
    rates: Mapping[str, float] = field(default_factory=dict)
    flying: bool = False
    learned: int = 0
    shown: int = 0
    latency: tuple[float, float] = (nan, nan)
    ahead: tuple[float, float] = (nan, nan)
    useful: tuple[float, float] = (nan, nan)
    lost: int = 0
    late: int = 0
    outlier_stamps: int = 0
    frames: int = 0
    unread: int = 0
    garbage: int = 0
    senders: tuple[dict[str, Any], ...] = ()
    others: int = 0
    alarms: tuple[MotorAlarm, ...] = ()
    alarm_count: int = 0
    alarm: str = ""

    def predicting(self, estimate: Estimate | None) -> SessionStatus:
        """The same with ``ahead`` and ``useful`` of an estimate."""
        if estimate is None:
            return self
        seconds, place = estimate.ahead_times - estimate.time, estimate.useful
        nearest = int(abs(seconds - AHEAD).argmin())
        ratio = nan, nan
        if place is not None:
            ratio = float(seconds[place]), float(estimate.ahead_ratio[place].mean())
        return replace(self, ahead=(float(seconds[nearest]), float(estimate.ahead_band[nearest, 0])), useful=ratio)
