"""What a live session reports: its status, events, and the history of the flight and of how well it was predicted."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.findings import Findings
from mavdem.assessment.judgement import Judgement, next_step_of, unjudged
from mavdem.assessment.lights.limits import worst
from mavdem.confidence import Interval
from mavdem.containers import Names, Numbers
from mavdem.dataset.signals import STAMP_ROUNDING
from mavdem.dem import Estimate
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.assessment import NextStep
from mavdem.facts.event import Event
from mavdem.facts.lights import Light
from mavdem.facts.session import Session
from mavdem.immutable import ImmutableResult
from mavdem.live.wind import WindRow
from mavdem.motors.loss_detection import MotorAlarm

AHEAD = 0.25  # s; how well the model predicts so far ahead is reported
HORIZONS = 0.05, 0.1, AHEAD, 0.5  # s; of a live session's predictions, besides one step
# Of the lines; when there are more, every second one is dropped, and from then on not kept
MAX_ROWS = 10_000
GAP_SECONDS = 1.0
"""Between two learned samples, from which on they belong to different parts of the flight; shown of a reboot."""


def horizons(dt: float) -> tuple[int, ...]:
    """Returns the horizons of a live session in steps of ``dt``, s."""
    return tuple(sorted({1, *(max(1, round(seconds / dt)) for seconds in HORIZONS)}))


@dataclass(frozen=True)
class SessionStatus(ImmutableResult):
    """The status of a live session at one moment.

    ``LiveStream`` fills in what concerns the link and the vehicle, ``LiveSession`` the rest.

    Attributes:
        vehicle: the followed one, "system:component".
        obstacle: why there are no rows or no new model; None while all is well.
        rates: Hz of attitude and motors over the last 2 s, by message.
        flying: whether the vehicle is armed and airborne.
        learned, shown: rows that the learner used, and that were only shown.
        latency: s from a packet's arrival here to its estimate: median and 99th percentile of late, and the longest.
        behind: s that what waits for its analysis has waited; 0 while this computer keeps up.
        ahead: about ``AHEAD`` s, and half width, rad, of the angle's 90 % band there.
        useful: the longest useful horizon, s (``Estimate.useful``), and the squared error there over that of the better
            of the last sample and the mean so far.
        lost: messages of the vehicle that were not received, by its sequence numbers; these start again after 256.
        missing: s of gaps in which the numbers may have started again, whose messages are not in ``lost``.
        late, unread: samples that came too late for their row, and frames of another dialect or damaged.
        alarms: the latest changes of the motors' balance; without a motor they are no alarms.
        findings, judgement: what the model so far is good for, and what is judged of the flight; None before.
        wind, no_wind: the latest row in m/s, None before one; why there is none although the vehicle flies.
        mean_wind: the mean of the flight's rows.
        alarm: what is bad now: of motors that are weak it stays after the landing.
        watched: since when each of what needs no model is watched, or why it is not.
        lights: the worst of that so far, by light.
    """

    vehicle: str | None = None
    obstacle: Fact | None = None
    rates: Mapping[str, float] = field(default_factory=dict)
    flying: bool = False
    learned: int = 0
    shown: int = 0
    latency: Numbers = (nan, nan, nan)
    behind: float = 0.0
    ahead: Interval = (nan, nan)
    useful: Interval = (nan, nan)
    lost: int = 0
    missing: float = 0.0
    late: int = 0
    unread: int = 0
    alarms: tuple[MotorAlarm, ...] = ()
    findings: Findings | None = None
    judgement: Judgement | None = None
    alarm: Facts = ()
    wind: WindRow | None = None
    no_wind: Fact | None = None
    mean_wind: WindRow | None = None
    watched: Facts = ()
    lights: NamedFacts = field(default_factory=dict)

    @property
    def judged(self) -> Judgement:
        """What is judged of the flight, by its model and without."""
        weak = [alarm.fact for alarm in self.alarms if alarm.weak]
        waiting = Session.BEING_LEARNED if self.flying else Session.NOT_FLYING
        refusal = [*weak, self.obstacle or Fact(waiting)][0]
        judgement = self.judgement or unjudged(refusal)
        seen = dict(self.lights)
        if weak:
            seen[Light.MOTORS] = worst([*weak, seen.get(Light.MOTORS, weak[0])])
        if self.mean_wind is not None:
            seen[Light.WIND] = self.mean_wind.light
        lights = {
            name: worst([seen.get(name, fact), fact]) for name, fact in judgement.lights.items()
        }
        headline = judgement.headline
        following = judgement.next_step
        bad = [fact for fact in lights.values() if fact.is_bad]
        if bad and not headline.is_bad:
            headline = bad[0]
            following = next_step_of(headline, lights, None)
        if self.flying and headline.is_bad:
            following = Fact(NextStep.LAND_NOW, because=headline)
        return Judgement(headline, following, lights)

    @property
    def slow(self) -> Fact | None:
        """By how much rows and alarms come late; None while this computer keeps up."""
        return Fact(Session.ESTIMATES_LATE, delay=self.behind) if self.behind else None

    def predicting(self, estimate: Estimate) -> SessionStatus:
        """Returns the same with ``ahead`` and ``useful`` of an estimate."""
        seconds = estimate.ahead_times - estimate.time
        longest = estimate.useful
        useful = self.useful
        nearest = abs(seconds - AHEAD).argmin()
        if longest is not None:
            useful = seconds[longest], estimate.ahead_ratio[longest].mean()
        return replace(
            self,
            ahead=(seconds[nearest], estimate.ahead_band[nearest, 0]),
            useful=useful,
        )


class HorizonErrors(NamedTuple):
    """Errors of the predictions ``seconds`` ahead, inputs unknown; (m,) each, over ``samples``."""

    seconds: float
    samples: int
    mse: Array  # mean squared error
    held: Array  # that of the last sample held
    inside: Array  # share inside the 90 % band


class LiveHistory:
    """Collects what happens in a live flight; the memory of its lines is bounded.

    Its time is the boot clock of the first boot, s, which goes on where a later boot begins, ``shift`` s after that
    one's clock; ``now``: the latest, NaN before any.
    """

    def __init__(self) -> None:
        self.now = nan
        self.shift = 0.0
        self._boot = 0
        self.motors: Names = ()
        self.events: list[Event] = []
        self._rows: list[array[float]] = []  # of the lines, after the number of the segment
        self._stride = 1
        self._taken = 0
        self._segment = 0
        # the parts learned from: first and last sample, s
        self.learned: list[Interval] = []
        # By horizon: time, prediction, band and last sample of those whose time has not come.
        self._pending: dict[float, deque[tuple[float, Array, Array, Array]]] = {}
        self._sums: dict[float, tuple[int, Array]] = {}

    def advance(self, time: float, boot: int) -> None:
        """Advances to a ``time`` of the vehicle's clock, s, in its boot of this number; to none if it is NaN."""
        if boot != self._boot:
            self._boot = boot
            self.shift = self.now + GAP_SECONDS - time
        if not time + self.shift <= self.now:
            self.now = time + self.shift

    def take(
        self,
        segment: int,
        time: float,
        outputs: Array,
        estimate: Estimate | None,
        beside: Sequence[float] = (),
    ) -> None:
        """Takes a row at a ``time`` of the vehicle's clock; without an estimate it was not learned from.

        ``segment`` counts the gaps before it; ``outputs`` (m,) are the measured ones; ``beside`` are
        wind, m/s, its band, and the motors, shares of their range.
        """
        time += self.shift
        if new := segment != self._segment:
            self._segment = segment
            self._pending.clear()
        predicted = self._compare(time, outputs)
        torque = nan, nan
        if estimate is not None:
            torque = estimate.wind_torque, estimate.wind_torque_band
        self._taken += 1
        if self._taken % self._stride == 0:
            row = segment, time, outputs[0], *predicted, *torque, *beside
            self._rows.append(array("d", row))
            if len(self._rows) > MAX_ROWS:
                self._rows = self._rows[::2]
                self._stride *= 2
        if estimate is None:
            return
        joins = self.learned and not new and time - self.learned[-1][1] < GAP_SECONDS
        self.learned.append((self.learned.pop()[0] if joins else time, time))
        times = (estimate.ahead_times + self.shift).tolist()
        for ahead, values, width in zip(times, estimate.ahead, estimate.ahead_band, strict=True):
            waiting = self._pending.setdefault(round(ahead - time, 6), deque())
            waiting.append((ahead, values, width, outputs))

    def disown_torque(self, since: float) -> None:
        """Makes the wind torque unknown from ``since``, s of its time, on: it was that of a motor."""
        self._rows = [
            array("d", (*row[:5], nan, nan, *row[7:])) if row[1] >= since else row
            for row in self._rows
        ]

    def errors(self) -> list[HorizonErrors]:
        """Returns those of each horizon, the shortest first."""
        return [
            HorizonErrors(seconds, count, *(sums / count))
            for seconds, (count, sums) in sorted(self._sums.items())
        ]

    @property
    def rows(self) -> Array:
        """(N, 9 + k): segment, time, first output, its prediction ``AHEAD`` s before, its band, then others.

        These are wind torque and its band, rad/s², wind and its band, m/s, and ``motors``, shares of their range.
        """
        width = 9 + len(self.motors)
        return np.array([(*row, *[nan] * width)[:width] for row in self._rows]).reshape(-1, width)

    def _compare(self, time: float, outputs: Array) -> Interval:
        """Compares predictions of ``time`` with what was measured; returns that of the lines and its band, or NaN."""
        shown = (nan, nan)
        nearest = min(self._pending, key=lambda seconds: abs(seconds - AHEAD), default=nan)
        for seconds, waiting in self._pending.items():
            while waiting and waiting[0][0] < time + STAMP_ROUNDING:
                ahead, predicted, band, last = waiting.popleft()
                if ahead < time - STAMP_ROUNDING or not np.isfinite(predicted + band).all():
                    continue
                errors = outputs - np.array([predicted, last])
                count, sums = self._sums.get(seconds) or (0, np.zeros((3, len(outputs))))
                sums[:2] += errors * errors
                sums[2] += abs(errors[0]) <= band
                self._sums[seconds] = count + 1, sums
                if seconds == nearest:
                    shown = predicted[0], band[0]
        return shown
