"""The slow path: whether the vehicle flies, and which inputs drive it, by the offline functions on the last seconds.

What those seconds alone do not show is carried on: when the flight began, since when it is settled, and the extremes
of the outputs.

A landing is known only once it has happened, and the last seconds before it are taken back. While the autopilot does
not report whether it is in the air, a vehicle that descends may be landing: nothing is settled until it has not
descended for ``TRANSIENT_SECONDS``. Without a vertical speed only the motors show a landing, once it is over.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis import AxisFigures
from mavdem.assessment.axis.findings import Findings, findings_of, with_own_torque_marked
from mavdem.assessment.axis.loops import loop_or_refusal
from mavdem.assessment.condition import Condition
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.judgement import Judgement, judge
from mavdem.assessment.lights.motors import motors_light
from mavdem.containers import Names, Numbers
from mavdem.dataset import motor_outputs, phases
from mavdem.dataset.attitude import Attitude
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.intervals import intersection
from mavdem.dataset.learnability import Learnability
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import (
    AVERAGING_SECONDS,
    MAX_LEVEL_FLIGHT_SPEED,
    MAX_REPORT_INTERVAL,
    TRANSIENT_SECONDS,
)
from mavdem.dataset.quality import QualityFigures
from mavdem.dataset.resampling import mean_rate
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import CLIMB_RATE_FIELDS, Signals
from mavdem.dataset.time_series import TimeSeries, recorded_series
from mavdem.dem import Learned
from mavdem.facts import Fact
from mavdem.facts.lights import Unjudged
from mavdem.facts.motors import Trim
from mavdem.facts.session import Session
from mavdem.ingest.motors import MOTOR_MESSAGES, MotorGeometry
from mavdem.ingest.output_scale import OutputScale, output_scale
from mavdem.ingest.telemetry import Fields, Telemetry, concatenated_columns, log_of_vehicles
from mavdem.ingest.vocabulary import IN_AIR, UNNAMED
from mavdem.live.recent_messages import MAX_ROWS, RecentMessages
from mavdem.live.rows import KEPT_SECONDS, Samples
from mavdem.loops.limit_cycles import detect_limit_cycle
from mavdem.motors.hover import hover_figures
from mavdem.motors.loss_detection import MotorAlarm, losses_of

LANDED = "EXTENDED_SYS_STATE"
PHASES = ("HEARTBEAT", LANDED, *CLIMB_RATE_FIELDS)
"""The messages that show the phase, beside the motors."""


@dataclass(frozen=True, eq=False)
class RowFormat:
    """What the rows of a segment are, like the ``provenance`` of a ``Flight``.

    Attributes:
        boot: its number.
        dt: step, s.
        attitude, motors: names of the messages.
        layout, scale: of the inputs.
        rates: Hz of attitude and motors that decided the step.
        start: first point of the grid, s; the first row may be a few seconds later.
    """

    boot: int
    dt: float
    attitude: str
    motors: str
    layout: MotorGeometry
    scale: OutputScale
    rates: Numbers
    start: float

    @property
    def units(self) -> Names:
        """The unit of each input."""
        return (self.scale.unit,) * len(self.layout.names)


@dataclass(frozen=True, eq=False)
class Inputs:
    """The inputs of the model: ``motors`` of the last seconds, and for each its port and its place in the channels."""

    motors: MotorOutputs
    picks: tuple[tuple[int, int], ...]

    @property
    def collective(self) -> TimeSeries | None:
        """How hard the motors worked together in the last seconds; None where nothing came."""
        return self.motors.collective if len(self.motors.time) else None

    @cached_property
    def ports(self) -> tuple[int, ...]:
        """The ports with inputs, the one with most of them first."""
        counts = Counter(port for port, _ in sorted(self.picks))
        return tuple(port for port, _ in counts.most_common())

    @property
    def key(self) -> tuple[object, ...]:
        """What must not change within a segment."""
        return self.motors.message, self.motors.geometry.channels, self.picks


class InputChoice:
    """Chooses the inputs from the outputs of the last seconds, and from the rows with their extremes.

    These show which channels move, and on which scale, also while they hold still.
    """

    def __init__(self, boot: int = 0) -> None:
        self._boot = boot
        self._extremes: dict[tuple[str, int], list[tuple[float, Numbers]]] = {}

    def shown(
        self, streams: Mapping[tuple[str, int], Samples], staying: str | None
    ) -> dict[str, Fields]:
        """Returns what to choose from of ``streams`` by message and port; only of ``staying``, if there is one."""
        messages: dict[str, Fields] = {}
        for (name, port), stream in sorted(streams.items()):
            if name in MOTOR_MESSAGES and staying in (None, name) and stream.time:
                columns = self._columns(name, port, stream)
                messages[name] = (
                    concatenated_columns([messages[name], columns]) if name in messages else columns
                )
        return messages

    def choose(self, messages: dict[str, Fields], vehicle: Telemetry, now: float) -> Inputs | None:
        """Returns the motors as of ``now``, s, by the rule of ``Signals.motors``; None without any in ``messages``."""
        motors = Signals(replace(vehicle, messages=messages)).motors
        if motors is None:
            return None
        _, width = motor_outputs.channel_outputs(motors.message, messages[motors.message])
        picks = tuple(divmod(n - 1, width) for n in motors.geometry.channels)
        # A climb at one throttle of a few seconds looks like a stop: only parameters say where one is.
        scale = output_scale(motors.outputs, vehicle.parameters, motors.geometry.drivers)
        recent = motors.time >= now - KEPT_SECONDS
        parts = {name: getattr(motors, name)[recent] for name in ("time", "boot", "outputs")}
        motors = replace(motors, scale=replace(motors.scale, stop=scale.stop), **parts)
        return Inputs(motors, picks)

    def _columns(self, name: str, port: int, stream: Samples) -> Fields:
        """The outputs of one port as columns."""
        # Of more, half as many show the same, and no row waits for them.
        every = 1 + len(stream.time) // (MAX_ROWS // 2)
        recent = zip(stream.time[::every], stream.values[::every], strict=True)
        rows = [*self._extremes.get((name, port), ()), *recent]
        times, values = zip(*rows, strict=True)
        table = np.array(values, float)
        sent = (table != 0) & np.isfinite(table)  # 0 is "no output yet"
        lowest = np.where(sent, table, inf).argmin(axis=0)
        highest = np.where(sent, table, -inf).argmax(axis=0)
        self._extremes[name, port] = [rows[row] for row in np.union1d(lowest, highest)]
        form = MOTOR_MESSAGES[name]
        stamps = {"time": np.array(times), "boot": np.full(len(rows), self._boot)}
        if not form.is_ported:
            return stamps | {form.field: table}
        channels = {form.field.format(number): sent for number, sent in enumerate(table.T, 1)}
        return stamps | channels | {"port": np.full(len(rows), port)}


@dataclass(frozen=True, eq=False)
class LiveSignals(Signals):
    """Signals of a live flight, of which these are not read from messages."""

    motors: MotorOutputs | None = None
    collective: TimeSeries | None = None
    landed_state: TimeSeries | None = None
    tilts: tuple[Attitude, ...] = ()


class Phase:
    """Whether one boot is armed, airborne and settled, by what is ``recent``."""

    def __init__(self, recent: RecentMessages) -> None:
        self.flying = False  # as of the last review, airborne and, if that is reported, armed
        self.steady = False  # and neither taking off nor landing where that is reported
        self.idle = False  # whether outputs come and none has moved so far
        self._recent = recent
        self._is_shown = False  # whether anything shows whether it flies
        self._start = self._reviewed = self._reported_until = -inf
        self._settled_from: float | None = None
        self._risen_from = inf  # s, since when it flies freely on its way up; none before it rises
        self._landing: float | None = None

    @property
    def obstacle(self) -> Fact | None:
        """Why it is not flying; None if it is."""
        if self.flying:
            return None
        is_shown = self.idle or self._is_shown
        return Fact(Session.NOT_FLYING if is_shown else Session.FLIGHT_UNKNOWN)

    def settled(self, time: float) -> bool:
        """Returns whether ``time``, s, is in settled flight, apart from the tilt."""
        return self.steady and self._settled_from is not None and time >= self._settled_from

    def free(self, time: float) -> bool:
        """Returns whether at ``time``, s, the flight is settled, apart from the tilt, or on its way off the ground."""
        return self.settled(time) or (self.flying and time >= self._risen_from)

    @property
    def carries(self) -> bool:
        """Whether rows can be of free flight, as of the last review."""
        return self.steady or (self.flying and self._risen_from < inf)

    def settled_since(self, now: float) -> float | None:
        """Returns since when, s, the flight is settled; None where it is not ``now``."""
        return self._settled_from if self.settled(now) else None

    def landing(self) -> float | None:
        """Returns the time, s, since which samples that counted as settled were of a landing.

        It is None if there is no new one.
        """
        since = self._landing
        self._landing = None
        return since

    def review(self, now: float, vehicle: Telemetry, collective: TimeSeries | None) -> None:
        """Decides the phase at ``now``, s, of a ``vehicle`` whose motors did ``collective`` in the last seconds."""
        boot = self._recent.boot
        signals = self._signals(now, vehicle, collective)
        armed = phases.armed_intervals(signals, boot)
        climb = signals.climb_rate
        self.flying = any(
            start < now <= end for start, end in phases.airborne_intervals(signals, boot)
        )
        has_states = signals.landed_state is not None or collective is not None
        self._is_shown = has_states or armed != [(-inf, inf)]
        flights = intersection(armed, phases.landed_state_intervals(signals, boot, (IN_AIR,)))
        flight = next((flight for flight in flights if flight[0] < now <= flight[1]), None)
        if self.steady and (flight is None or flight[0] > self._reviewed):
            self._take_back(max((end for _, end in flights if end < now), default=now))
            self.steady = False
            self._settled_from = None
            self._risen_from = inf
        if flight is not None:
            # The take-off is carried on once the mean collective around it is known; later it is no longer in sight.
            if not self.steady or (isfinite(flight[0]) and now < self._start + AVERAGING_SECONDS):
                self._start = flight[0]
            self.steady = True
            self._settle(now, climb)
        self._rise(now, climb)
        self._reviewed = now

    def _signals(self, now: float, vehicle: Telemetry, collective: TimeSeries | None) -> Signals:
        """What the last seconds show; while the landed state is reported, the last one holds until ``now``."""
        columns = self._recent.columns(PHASES, now - 2 * MAX_REPORT_INTERVAL)
        telemetry = replace(vehicle, messages=columns)
        landed = recorded_series(telemetry, LANDED, "landed_state")
        self._reported_until = -inf
        if landed is not None and now <= landed.time[-1] + MAX_REPORT_INTERVAL:
            state = landed.values[-1]
            self._reported_until = landed.time[-1] + MAX_REPORT_INTERVAL if state else -inf
            time = np.append(landed.time, now)
            boots = np.full(len(time), self._recent.boot)
            landed = TimeSeries(time, boots, np.append(landed.values, state))
        return LiveSignals(telemetry, collective=collective, landed_state=landed)

    def _settle(self, now: float, climb: TimeSeries | None) -> None:
        """Decides since when the flight is settled; means are known half of their window later."""
        averaged_until = now if climb is None else now - AVERAGING_SECONDS / 2
        if self._settled_from is None:
            level = phases.without_transients((self._start, inf), climb)
            if level is not None and level[0] <= averaged_until:
                self._settled_from = level[0]
        elif climb is not None:
            sinks = phases.moving_average(climb) <= -MAX_LEVEL_FLIGHT_SPEED
            since = self._reviewed - AVERAGING_SECONDS / 2
            new = (climb.time > max(since, self._reported_until)) & (climb.time <= averaged_until)
            if len(sinking := climb.time[sinks & new]):
                # It may be landing.
                self._settled_from = max(self._settled_from, float(sinking[-1]) + TRANSIENT_SECONDS)

    def _rise(self, now: float, climb: TimeSeries | None) -> None:
        """Decides since when it flies freely without being settled: what rises for long is held by nothing."""
        if not self.flying or climb is None:
            self._risen_from = inf
            return
        since = max(self._reviewed, now - MAX_REPORT_INTERVAL) - AVERAGING_SECONDS / 2
        new = (climb.time > since) & (climb.time <= now - AVERAGING_SECONDS / 2)
        speed = phases.moving_average(climb)[new]
        rising = climb.time[new][speed >= MAX_LEVEL_FLIGHT_SPEED]
        if np.any(speed <= -MAX_LEVEL_FLIGHT_SPEED):
            self._risen_from = inf
        elif len(rising) and self._settled_from is None:
            self._risen_from = min(self._risen_from, float(rising[0]) + TRANSIENT_SECONDS / 2)

    def _take_back(self, time: float) -> None:
        """It landed at ``time``; the earlier of two landings counts where neither was fetched."""
        since = time - TRANSIENT_SECONDS
        self._landing = since if self._landing is None else min(since, self._landing)


class RecentMotion(NamedTuple):
    """The ``motors`` of some seconds, and the attitude by axis."""

    motors: MotorOutputs
    tilts: Mapping[str, Attitude]

    @property
    def rate(self) -> float:
        """Hz of the slower of both."""
        times = [self.motors.time, *(tilt.time for tilt in self.tilts.values())]
        return min(mean_rate(time) if len(time) > 1 else 0.0 for time in times)


def tilt_of(message: str, time: Array, boot: int, angle: Array, rate: Array) -> Attitude:
    """Returns angle and body rate (N,) of one axis at ``time`` (N,), from a ``message``."""
    count = len(time)
    return Attitude(message, time, np.full(count, boot), angle, rate, rate, count, 0, 0)


def evidence_of(signals: Signals, condition: Condition, **fields: Any) -> Evidence:
    """Returns what a live vehicle is judged by, in flight for as long as its ``condition`` says."""
    unknown = Fact(Unjudged.NOT_JUDGED, because=None)
    learnability = Learnability(
        signals.axis,
        True,
        unknown,
        figures=QualityFigures(armed=condition.duration, airborne=condition.duration),
    )
    return Evidence(
        log_of_vehicles((signals.telemetry,), 0, 0), signals, learnability, condition, **fields
    )


def judged(
    learned: Learned, setup: RowFormat, alarms: Sequence[MotorAlarm], recorded: str | None
) -> tuple[Findings, Judgement]:
    """Returns what a model whose inputs are those of ``setup`` is good for, and the judgement of its vehicle.

    ``recorded`` is the file that shows more, as ``LiveSession`` has it.
    """
    record = learned.record
    inputs, outputs = max(record.segments, key=lambda part: len(part[1]))
    axis = record.output_names[0]
    count = len(inputs)
    duration = count * learned.dt
    time: Any = learned.dt * np.arange(count)
    telemetry = Telemetry(1, 1, UNNAMED, "", {}, record.parameters, recorded or "")
    boots = np.zeros(count, int)
    motors = MotorOutputs(setup.motors, time, boots, inputs, setup.layout, setup.scale, count, 0)
    tilt = tilt_of(setup.attitude, time, 0, *outputs.T)
    signals = LiveSignals(telemetry, axis, motors=motors, tilts=(tilt,) * len(TILT_AXES))
    swing = detect_limit_cycle(motors, {axis: tilt}, [Segment(0, 0.0, duration)])
    lean = {axis: np.degrees(outputs[:, 0].mean())}
    hover = hover_figures(setup.layout.names, setup.scale, duration, inputs, lean)
    condition = Condition(duration=duration, settled=duration, hover=hover, oscillation=swing)
    learned = with_own_torque_marked(learned, swing is not None)
    physical = AxisFigures((), learned.physical, None, learned.physical_reason)
    unknown = Fact(Unjudged.NOT_JUDGED, because=None)
    loops = dict.fromkeys(AXES, unknown) | {axis: loop_or_refusal(physical, record)}
    evidence = evidence_of(signals, condition, events=tuple(losses_of(alarms)), loops=loops)
    findings = findings_of(learned, None, condition, alarms)
    # by messages that nothing in flight looks at
    later = Fact(Unjudged.JUDGED_LATER, path=recorded)
    light = motors_light(evidence)
    if light.code is Trim.TRIM_UNKNOWN:
        light = later  # the trim is of all axes, the model of one
    return findings, judge(
        evidence, findings.purposes, motors=light, tracking=later, estimator=later
    )
