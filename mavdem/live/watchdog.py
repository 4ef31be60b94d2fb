"""Watchdog: what is wrong with a vehicle by its own messages, without a model, within seconds of take-off.

It is the judgement of a log, in small steps: what the autopilot reports, and the lights of vibration and power, are
those of ``assessment`` on the messages so far; a limit cycle is that of ``condition.oscillation`` on the last seconds.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import inf

import numpy as np

from mavdem.assessment.condition import Condition
from mavdem.assessment.lights.power import power_light
from mavdem.assessment.lights.vibration import vibration_light
from mavdem.assessment.limits import worst_fact
from mavdem.assessment.reported import reported_events
from mavdem.dataset.intervals import Intervals
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.signals import BATTERY_MESSAGES, MIN_STREAM_RATE, Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Facts
from mavdem.facts.events import Reported
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import MotorsLight
from mavdem.facts.session import Rows
from mavdem.facts.watch import Watch, Watched
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND
from mavdem.live.decisions import LiveSignals, RecentMotion, evidence_of
from mavdem.live.messages import OF_ITSELF
from mavdem.live.recent_messages import RecentMessages
from mavdem.live.rows import DECISION_SECONDS
from mavdem.loops.limit_cycles import detect_starting_limit_cycle
from mavdem.motors.loss_detection import alarm_of
from mavdem.plant.online_wind_torque import MEMORY_SECONDS

LIGHTS = {
    Watched.OSCILLATION: Light.MARGINS,
    Watched.MOTOR_LIMITS: Light.MOTORS,
    Watched.VIBRATION: Light.VIBRATION,
    Watched.BATTERY: Light.POWER,
}
ALARMING_SHARE = 0.7
"""So much of the last seconds a motor is at its upper limit: sound vehicles that yaw or climb do half of it."""
CALM_SECONDS = 10.0  # Without what an alarm was about, after which it is over


class Watchdog:
    """Watches one boot of one vehicle.

    Attributes:
        standing: what is wrong as of the last review, by what shows it.
        watched: since when each is watched, or why it is not.
        lights: the worst that was found so far, by light.
    """

    def __init__(self, recent: RecentMessages) -> None:
        self.standing: dict[Watched, Fact] = {}
        self.watched: dict[Watched, Fact] = {}
        self.lights: dict[str, Fact] = {}
        self._recent = recent
        self._phases: list[tuple[float, int]] = []
        self._said = set[tuple[object, ...]]()
        self._seen: dict[Watched, float] = {}
        self._reviewed = -inf

    @property
    def alarms(self) -> Facts:
        """What is bad as of the last review."""
        return tuple(fact for fact in self.standing.values() if fact.is_bad)

    def review(
        self,
        now: float,
        vehicle: Telemetry,
        is_flying: bool,
        settled_since: float | None,
        motion: RecentMotion | None,
    ) -> Iterator[Fact | None]:
        """Yields what is new at ``now``, s, of a ``vehicle`` without messages, and of its last ``motion``.

        None comes between parts of the work. Vibration counts in settled flight only: a touch-down is none.
        """
        state = IN_AIR if is_flying else ON_GROUND
        before = self._phases[-1][1] if self._phases else state
        if not self._phases or before != state:
            self._phases += [(self._reviewed, before), (now, state)]
        settled = None if settled_since is None else [(settled_since, now)]
        recent = self._signals(vehicle, now, now - MEMORY_SECONDS, settled)
        yield from self._reported(recent, now)
        yield None
        since = self._phases[-1][0]
        watched = {}
        if is_flying:
            whole = self._signals(vehicle, now, -inf)
            condition = Condition(duration=now - since)
            watched[Watched.BATTERY] = power_light(evidence_of(whole, condition))
            if settled is not None:
                watched[Watched.VIBRATION] = vibration_light(evidence_of(recent, condition))
            yield None
            watched |= dict(self._of_motion(motion, since, now))
        self._note(watched, motion, is_flying, now)
        yield from self._changes(watched, now)
        self._reviewed = now

    def _signals(
        self, vehicle: Telemetry, now: float, since: float, settled: Intervals | None = None
    ) -> Signals:
        columns = self._recent.columns(OF_ITSELF, since)
        time, states = zip(*self._phases, (now, self._phases[-1][1]), strict=True)
        boots = np.full(len(time), self._recent.boot)
        landed = TimeSeries(np.array(time), boots, np.array(states))
        return LiveSignals(
            replace(vehicle, messages=columns),
            landed_state=landed,
            preset_settled_intervals=settled,
        )

    def _reported(self, signals: Signals, now: float) -> Iterator[Fact]:
        """What the autopilot has reported since the last review."""
        before = self._said
        facts = reported_events(signals)
        self._said = {_kind(fact) for fact in facts}
        for fact in facts:
            is_new = _kind(fact) not in before and (fact.time or 0.0) > self._reviewed - 1.0
            # A stream has no beginning of its own, and a restart is shown by the clock.
            is_ours = fact.code is not Reported.RESTARTED and not fact.figures.get("is_begun")
            if is_new and is_ours:
                yield fact.but(height=None)

    def _of_motion(
        self, motion: RecentMotion | None, since: float, now: float
    ) -> Iterator[tuple[Watched, Fact]]:
        """A limit cycle, and the motor most at its upper limit."""
        if motion is None:
            return
        motors = motion.motors
        shares = motors.scale.fraction(motors.outputs)
        upper, lower = samples_at_limits(shares, motors.scale)
        cycle = None
        if upper.any() or lower.any():  # without, there is none; most flights have none
            cycle = detect_starting_limit_cycle(motors, motion.tilts, self._recent.boot, since, now)
        if cycle is not None:
            yield Watched.OSCILLATION, Fact(MarginsLight.OSCILLATES, **cycle.figures)
        latest = motors.time >= now - DECISION_SECONDS
        if now - since < DECISION_SECONDS or not latest.any():
            return
        limited = upper[latest].mean(axis=0)
        motor = limited.argmax()
        # All of them: a climb at full throttle.
        if limited[motor] >= ALARMING_SHARE > limited.min():
            yield (
                Watched.MOTOR_LIMITS,
                Fact(
                    MotorsLight.MOTOR_LIMITED,
                    subject=motors.geometry.names[motor],
                    share=limited[motor],
                ),
            )

    def _changes(self, watched: Mapping[Watched, Fact], now: float) -> Iterator[Fact]:
        """What became wrong, or worse, and what no longer is."""
        for kind, fact in watched.items():
            light = str(LIGHTS[kind])
            self.lights[light] = worst_fact([fact, self.lights.get(light, fact)])
            if not fact.warns:
                continue
            before = self.standing.get(kind)
            self._seen[kind] = now
            if before is None or (before.level, before.code) != (fact.level, fact.code):
                self.standing[kind] = fact
                yield alarm_of(fact, now)
        for kind in [*self.standing]:
            has_landed = self._phases[-1][1] == ON_GROUND
            if has_landed or now - self._seen[kind] >= CALM_SECONDS:
                yield Fact(Watch.ALARM_OVER, time=self._seen[kind], because=self.standing.pop(kind))

    def _note(
        self,
        watched: Mapping[Watched, Fact],
        motion: RecentMotion | None,
        is_flying: bool,
        now: float,
    ) -> None:
        """Keeps since when each is watched, and why it is not."""
        sent = set(self._recent.columns(OF_ITSELF, now - MEMORY_SECONDS))
        missing = {}
        if motion is None:
            missing = dict.fromkeys(
                (Watched.OSCILLATION, Watched.MOTOR_LIMITS), Fact(Rows.NO_LIVE_MOTORS)
            )
        elif motion.rate < MIN_STREAM_RATE / 2:
            slow = Fact(Watch.MESSAGE_MISSING, name=motion.motors.message, rate=motion.rate)
            missing[Watched.OSCILLATION] = slow
        for kind, names in {
            Watched.VIBRATION: ["VIBRATION"],
            Watched.BATTERY: BATTERY_MESSAGES,
            Watched.WARNINGS: ["HEARTBEAT"],
        }.items():
            if not sent.intersection(names):
                missing[kind] = Fact(Watch.MESSAGE_MISSING, name=names[0], rate=None)
        for kind in [*Watched][1:]:
            waits = None if is_flying or kind is Watched.WARNINGS else Fact(Watch.ON_GROUND_NOW)
            self.watches(kind, missing.get(kind) or waits, now)

    def watches(self, kind: Watched, obstacle: Fact | None, now: float) -> None:
        """Notes that it is watched, or not because of an ``obstacle``, as of ``now``, s."""
        before = self.watched.get(kind)
        code = Watch.NOT_WATCHED if obstacle else Watch.WATCHED
        if before is not None and (before.code, before.figures.get("because")) == (code, obstacle):
            return
        self.watched[kind] = Fact(code, time=now, subject=kind, because=obstacle)


def not_watched(watched: Fact, because: Fact, time: float) -> Fact:
    """Returns that what was ``watched`` is not any more since ``time``, s."""
    return Fact(
        Watch.NOT_WATCHED,
        time=time,
        subject=watched.subject,
        **{**watched.figures, "because": because},
    )


def _kind(fact: Fact) -> tuple[object, ...]:
    return fact.code, fact.subject, fact.figures.get("text"), fact.time
