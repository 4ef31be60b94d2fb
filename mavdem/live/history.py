"""What a live session reports: its status, events, and the history of the flight and of how well it was predicted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import nan
from typing import NamedTuple

import numpy as np

from mavdem.analysis.findings import Findings
from mavdem.dem import Estimate
from mavdem.dem.engine.linalg import Array
from mavdem.dem.online.errors import HorizonErrors, PredictionErrors, TimedSample
from mavdem.health.in_flight import MotorAlarm

NOT_FLYING = "The vehicle is on the ground: learning begins after take-off."
FLIGHT_UNKNOWN = "Nothing shows yet whether the vehicle flies."
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
    "left_out": "not analysed, since this computer was too slow (what it received is recorded)",
    "no_vehicle": "without a vehicle",
}  # What the seconds of a session are accounted for as
AHEAD = 0.25  # s; how well the model predicts so far ahead is reported
HORIZONS = 0.05, 0.1, AHEAD, 0.5  # s; of a live session's predictions, besides one step
MAX_ROWS = 100_000  # Of the lines; when there are more, every second one is dropped, and from then on not kept
REBOOT_GAP_SECONDS = 1.0  # Shown between the last time before a reboot and the first after it
SETTLED_GAP = 1.0  # s between two learned samples from which on they belong to different parts of the flight
BLOCK_ROWS = 64  # Taken together


def horizons(dt: float) -> tuple[int, ...]:
    """Returns the horizons of a live session in steps of ``dt``, s."""
    return tuple(sorted({1, *(max(1, round(seconds / dt)) for seconds in HORIZONS)}))


def sentence(text: str) -> str:
    """Returns ``text`` with a capital letter and one full stop; empty if it is."""
    text = text.rstrip(". ")
    return f"{text[:1].upper()}{text[1:]}." if text else ""


class Event(NamedTuple):
    """Something that happened, in one sentence.

    Attributes:
        seconds: UNIX s of the bytes that caused it for a stream, s of the vehicle's clock in a history.
        sentence: what happened.
        level: "INFO", or "ERROR" for an alarm.
        since: when what an alarm is about began, s of the vehicle's clock; else NaN.
    """

    seconds: float
    sentence: str
    level: str = "INFO"
    since: float = nan


@dataclass(frozen=True)
class SessionStatus:
    """The status of a live session at one moment.

    ``LiveStream`` fills in what concerns the link and the vehicle, ``LiveSession`` the rest.

    Attributes:
        vehicle: the followed one, "system:component".
        obstacle: why there are no rows or no new model; empty while all is well.
        rates: Hz of attitude and motors over the last 2 s, by message.
        flying: whether the vehicle is armed and airborne.
        learned, shown: rows that the learner used, and that were only shown.
        latency: s from a packet's arrival at this computer to its estimate: median and 99th percentile of the latest
            rows, and the largest of all.
        ahead: about ``AHEAD`` s, and half width, rad, of the angle's 90 % band there.
        useful: the longest useful horizon, s (``Estimate.useful``), and the squared error there over that of the better
            of the last sample and the mean so far.
        lost: messages of the vehicle missing by its sequence numbers, which start again after 256.
        missing: s of gaps in which that may have happened, which are not in ``lost``.
        late, unread: samples that came too late for their row, and frames of another dialect or damaged.
        alarms: the latest changes of the motors' balance; without a motor they are no alarms.
        findings: what the flight says so far; None before the first model.
        alarm: the latest on a motor in this boot and this flight; it stays after the landing.
    """

    vehicle: str | None = None
    obstacle: str = ""
    rates: Mapping[str, float] = field(default_factory=dict)
    flying: bool = False
    learned: int = 0
    shown: int = 0
    latency: tuple[float, ...] = (nan, nan, nan)
    ahead: tuple[float, float] = (nan, nan)
    useful: tuple[float, float] = (nan, nan)
    lost: int = 0
    missing: float = 0.0
    late: int = 0
    unread: int = 0
    alarms: tuple[MotorAlarm, ...] = ()
    findings: Findings | None = None
    alarm: str = ""

    def predicting(self, estimate: Estimate) -> SessionStatus:
        """Returns the same with ``ahead`` and ``useful`` of an estimate."""
        seconds, longest, useful = estimate.ahead_times - estimate.time, estimate.useful, self.useful
        nearest = int(abs(seconds - AHEAD).argmin())
        if longest is not None:
            useful = float(seconds[longest]), float(estimate.ahead_ratio[longest].mean())
        return replace(self, ahead=(float(seconds[nearest]), float(estimate.ahead_band[nearest, 0])), useful=useful)


class LiveHistory:
    """Collects what happens in a live flight; the memory of its lines is bounded.

    Its time is the boot clock of the first boot, s, which goes on where a later boot begins, ``shift`` s after that
    one's clock; ``now``: the latest, NaN before any.
    """

    def __init__(self) -> None:
        self.now, self.shift, self._boot = nan, 0.0, 0
        self.events: list[Event] = []
        # Of the lines, after the number of the segment; from the beginning as large as it becomes.
        self._rows = np.full((MAX_ROWS + BLOCK_ROWS, 7), nan)
        self._number, self._stride, self._taken = 0, 1, 0
        self._segment, self._offset = 0, 0.0  # of the latest rows
        self._latest: list[TimedSample] = []  # which are not in the lines yet
        self._errors = PredictionErrors()
        self.learned: list[tuple[float, float]] = []  # the parts learned from: first and last sample, s
        self.modelled = np.inf  # end of what the model at the end was learned from, s

    def advance(self, time: float, boot: int) -> None:
        """Advances to a ``time`` of the vehicle's clock, s, in its boot of this number; to none if it is NaN."""
        if boot != self._boot:
            self._boot, self.shift = boot, self.now + REBOOT_GAP_SECONDS - time
        if not time + self.shift <= self.now:
            self.now = time + self.shift

    def take(self, segment: int, time: float, outputs: Array, estimate: Estimate | None) -> None:
        """Takes a row at a ``time`` of the vehicle's clock; without an estimate it was not learned from.

        ``segment`` counts the gaps before it; ``outputs`` (m,) are the measured ones.
        """
        if new := segment != self._segment:
            self._write()
            self._errors.end_segment()
            self._segment = segment
        self._offset = self.shift
        self._latest.append(TimedSample(time, outputs, estimate))
        if len(self._latest) == BLOCK_ROWS:
            self._write()
        time += self.shift
        if estimate is not None:
            joins = self.learned and not new and time - self.learned[-1][1] < SETTLED_GAP
            self.learned.append((self.learned.pop()[0] if joins else time, time))

    def errors(self) -> list[HorizonErrors]:
        """Returns those of each horizon, the shortest first."""
        self._write()
        return self._errors.result()

    @property
    def rows(self) -> Array:
        """(N, 7): segment, time, first output, its prediction ``AHEAD`` s before, its band, wind torque, its band."""
        self._write()
        return self._rows[: self._number]

    def _write(self) -> None:
        """Compares the latest rows with what was predicted of them, and adds them to the lines."""
        rows, self._latest = self._latest, []
        if not rows:
            return
        predicted = self._errors.add(rows, AHEAD)
        winds = [(nan, nan) if one is None else (one.wind_torque, one.wind_torque_band) for *_, one in rows]
        starts = [(self._segment, time + self._offset, outputs[0]) for time, outputs, _ in rows]
        kept = slice(-(self._taken + 1) % self._stride, None, self._stride)
        self._taken += len(rows)
        block = np.column_stack([starts, predicted, winds])[kept]
        self._rows[self._number : self._number + len(block)] = block
        self._number += len(block)
        if self._number > MAX_ROWS:
            self._number, self._stride = (self._number + 1) // 2, 2 * self._stride
            self._rows[: self._number] = self._rows[: 2 * self._number : 2].copy()
