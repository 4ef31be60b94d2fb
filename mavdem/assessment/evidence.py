"""Evidence: all that a log shows of one vehicle, as measurements and facts (coded findings), each made once.

Measurements count in flight only: off the ground, and until the vehicle was lost. What happens to a vehicle after that
is a consequence and no fault.
"""

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf

import numpy as np

from mavdem.arrays import Array, Integers
from mavdem.assessment.axis.margins import (
    AxisMargins,
    axes_with_doubtful_loop,
    stability_margins_by_axis,
)
from mavdem.assessment.axis.overrides import flight_overrides
from mavdem.assessment.axis.tracking import (
    MODES_WITHOUT_ANGLE_SETPOINT,
    AttitudeGain,
    attitude_gain,
    tracking_of_axes,
)
from mavdem.assessment.condition import Condition
from mavdem.assessment.flights import loss_onset, settled_flight
from mavdem.assessment.time_history import TimeHistory, time_history
from mavdem.dataset import phases, time_series
from mavdem.dataset.intervals import Intervals, in_intervals, intersection
from mavdem.dataset.parameter_history import ParametersInFlight, parameter_history
from mavdem.dataset.segment_learnability import Learnability
from mavdem.dataset.segments import (
    Segment,
    Segments,
    recorded_spans,
    segments_without_modes,
)
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Code, Fact, Facts, NamedFacts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Unjudged
from mavdem.facts.margins import TrackingLight
from mavdem.facts.sources import Repair
from mavdem.ingest import Log
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import gain_reduction_advice
from mavdem.loops.axis_loops import Loop, LoopsByAxis, identified_loops
from mavdem.wind_velocity.from_log import WindEvidence
from mavdem.witnesses import SensorTrust, trust_of_boots

EXCITATION_MODES = frozenset({"Autotune", "Systemid"})
"""ArduPilot's flight modes that excite the vehicle by themselves, up to and beyond what its gains allow."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that a log shows of one vehicle before it is judged."""

    log: Log
    """The log of the vehicle."""
    signals: Signals
    """The signals of the vehicle."""
    learnability: Learnability
    """Whether a full model can be learned from the log."""
    condition: Condition
    """Motor balance, lean, vibration, battery and oscillation."""
    wind: WindEvidence = WindEvidence(None, None, Fact(Unjudged.NOT_JUDGED, reason=None))
    """The wind in m/s, or why it is not known."""
    events: Facts = ()
    """What happened, in order of boot and time, with changes of the motors' thrust and the ending among them."""
    ending: Fact | None = None
    """How the flight was lost, and what failed first; None if it was not lost."""
    loops: Mapping[str, Loop | Fact] = field(default_factory=dict)
    """The identified control loops of each axis, or why they are not known."""

    @property
    def other_vehicle(self) -> Fact | None:
        """The fact that the vehicle is not a multirotor; None if it is one, or may be one.

        It is the reason why its motors, tracking, margins and wind are not judged. Vibration, power, estimator and log
        are judged of every vehicle.
        """
        kind = self.signals.telemetry.vehicle
        if kind in POSSIBLE_MULTIROTORS:
            return None
        return Fact(Unjudged.MULTIROTORS_ONLY, kind=kind)

    @cached_property
    def has_operated(self) -> bool:
        """Whether the vehicle flew or, if it is not a multirotor, was in operation, as a rover that drives."""
        if self.other_vehicle is None:
            # Duration of all flight of a multirotor, s.
            return bool(self.learnability.figures.airborne)
        # The motor outputs of other vehicles do not show a flight, so that their intervals of operation are used.
        for span in recorded_spans(self.signals):
            recorded_flights = intersection([(span.start, span.end)], self.flights(span.boot))
            if recorded_flights:
                return True
        return False

    @property
    def has_flown(self) -> bool:
        """Whether the vehicle operated, and its motion does not show that it stayed on the ground."""
        return self.has_operated and self.not_flown is None

    @property
    def was_in_air(self) -> bool:
        """Whether the vehicle flew, or fell after a restart of the autopilot in flight."""
        return self.has_flown or bool(self.restarts_in_flight)

    @property
    def restarts_in_flight(self) -> Facts:
        """The events that the autopilot restarted in flight, in order of boot and time."""
        restart_code = ReportedEvent.RESTARTED_IN_FLIGHT
        return tuple(event for event in self.events if event.code is restart_code)

    @cached_property
    def trust(self) -> tuple[SensorTrust, ...]:
        """Which sensors can be trusted in each boot: each is checked by others.

        A drift of the barometer, which is an event of a flight, is added to the checks of its boot.
        """
        drift_of_boot: dict[int, Fact] = {}
        for event in self.events:
            if event.code in (MotionEvent.BAROMETER_DRIFTED, MotionEvent.HEIGHTS_DISAGREE):
                # The first drift of a boot counts.
                drift_of_boot.setdefault(event.figures["boot"], event)
        checked_boots = []
        for trust in trust_of_boots(self.signals):
            checked_boots.append(replace(trust, height_drift=drift_of_boot.get(trust.boot)))
        return tuple(checked_boots)

    @cached_property
    def margins(self) -> tuple[AxisMargins, ...]:
        """The stability margins of roll, pitch and yaw, without flight in the modes that excite the vehicle."""
        return stability_margins_by_axis(
            self.signals, self.settled_segments(EXCITATION_MODES), self.loops
        )

    @property
    def axes_with_doubtful_loop(self) -> frozenset[str]:
        """The axes whose identified loop a measured response contradicts."""
        return axes_with_doubtful_loop(self.margins, self.loops)

    @cached_property
    def tracking(self) -> NamedFacts:
        """How roll, pitch and yaw follow their setpoints, by axis, in modes that have setpoints of the angles."""
        return tracking_of_axes(self.signals, self._segments_with_angle_setpoint)

    @cached_property
    def _segments_with_angle_setpoint(self) -> Segments:
        """Settled flight in modes that have setpoints of the angles, and in which the autopilot excites nothing."""
        return self.settled_segments(EXCITATION_MODES | MODES_WITHOUT_ANGLE_SETPOINT)

    def amplifying_attitude_gain(self, axis: str) -> AttitudeGain | None:
        """Returns the measured gain |T| from setpoint to angle of an axis that moves further than it is commanded.

        Args:
            axis: "roll" or "pitch".

        Returns:
            The gain; None if the light on tracking does not say that the axis amplifies its setpoint.
        """
        tracking = self.tracking.get(axis)
        if tracking is None or tracking.code is not TrackingLight.AMPLIFIES_SETPOINT:
            return None
        signals = self.signals.for_axis(axis)
        # Only angles with a setpoint are compared with it.
        assert signals.angle_setpoint is not None
        assert signals.attitude is not None
        return attitude_gain(
            signals.angle_setpoint,
            signals.attitude.angle_series,
            self._segments_with_angle_setpoint,
        )

    @cached_property
    def identified_loops(self) -> LoopsByAxis:
        """The control loops by axis, for each axis whose loop is known."""
        return identified_loops(self.loops)

    @cached_property
    def time_history(self) -> TimeHistory | None:
        """The signals of the boot that was analysed, over time; None with less than two samples of the attitude."""
        return time_history(self.signals, self.learnability.segments, self.wind, self.events)

    @cached_property
    def history_of_all_flights(self) -> TimeHistory | None:
        """The signals over time that plots show: of the boot that was analysed, and of the flights of other boots.

        None if the boot that was analysed has less than two samples of the attitude.
        """
        has_one_boot = len(recorded_spans(self.signals)) == 1
        if has_one_boot:
            return self.time_history
        return time_history(
            self.signals, self.learnability.segments, self.wind, self.events, has_all_flights=True
        )

    @cached_property
    def reasons_not_to_fly(self) -> Facts:
        """Why the vehicle must not fly again before it is repaired or tuned, as facts; empty if it may.

        The reasons are, the most urgent first:

        1. The vehicle was lost.
        2. It oscillates, or else a motor is at its limit for much of the hover.
        3. A motor was at its limit at any moment, if no hover was measured.

        A vehicle that never flew has no reasons. If there are any, facts about the vehicle are shown without advice to
        fly (:attr:`mavdem.facts.Fact.without_flight_advice`).
        """
        if self.not_flown is not None:
            return ()
        reasons: list[Fact] = []
        if self.ending is not None:
            reasons.append(self.ending)
        # Alarms of motors that lost thrust are left out here, since they are among the events.
        reasons += flight_overrides(self.condition, alarms=())
        if self.condition.hover is None:
            reasons += self.warnings_in_flight([MotionEvent.MOTOR_AT_ITS_STOP])
        return tuple(reasons)

    @cached_property
    def gain_reduction(self) -> Fact | None:
        """The advice to lower some gains against a limit cycle, a fact (coded finding); None if nothing oscillates.

        It rests on the values that the gains had during the oscillation, which the pilot may have changed since.
        """
        oscillation = self.condition.oscillation
        if oscillation is None:
            return None
        times_of_oscillation = [oscillation.span]
        for oscillation_of_other_axis in oscillation.other_axes:
            times_of_oscillation.append(oscillation_of_other_axis.span)
        parameters_then = parameter_history(self.signals).during(times_of_oscillation)
        return gain_reduction_advice(oscillation, parameters_then)

    @cached_property
    def parameters_in_flight(self) -> ParametersInFlight:
        """The autopilot's parameters in the flight by which margins and tracking are judged."""
        return parameter_history(self.signals).during(self.settled_segments(EXCITATION_MODES))

    @cached_property
    def flown_parameters(self) -> Parameters:
        """The autopilot's parameters while the vehicle was in the air, by name.

        One that had several values meanwhile has the last one of the recording, and so have all of a vehicle that did
        not fly.
        """
        boots = np.array([span.boot for span in recorded_spans(self.signals)], dtype=int)
        return parameter_history(self.signals).during(self.flight_segments(boots)).any_values

    @property
    def command_arguments(self) -> list[str]:
        """The arguments with which another mavdem command, which a fact advises, reads the same vehicle.

        They are the name of the log, ``--vehicle`` if the log has several, and ``--params`` for each file whose
        parameters were added.
        """
        telemetry = self.signals.telemetry
        arguments = [self.log.source]
        if len(self.log.vehicles) > 1:
            arguments += ["--vehicle", f"{telemetry.system}:{telemetry.component}"]
        for repair in telemetry.repairs:
            if repair.code is Repair.PARAMETERS_ADDED:
                arguments += ["--params", repair.figures["path"]]
        return arguments

    @cached_property
    def not_flown(self) -> Fact | None:
        """The fact that the vehicle did not fly in any boot in which its motors ran; None if it may have flown."""
        facts = [event for event in self.events if event.code is MotionEvent.NOT_FLOWN]
        if not facts:
            return None
        # Each fact is of one boot only: the vehicle may have flown in another one.
        for boot in np.unique(self.signals.tilts[0].boot).tolist():
            if self.flights(boot):
                return None
        return facts[0]

    def flights(self, boot: int) -> Intervals:
        """Returns the intervals of a boot in free flight until the vehicle was lost.

        Of a vehicle that is not a multirotor they are those in which it operates
        (``flight_states.airborne_intervals``).

        Args:
            boot: number of the boot; a boot lasts from one start of the autopilot to the next.

        Returns:
            The intervals, s since boot; none if the vehicle did not fly in this boot.
        """
        for event in self.events:
            if event.code is MotionEvent.NOT_FLOWN and event.figures["boot"] == boot:
                return []
        free_flight = phases.free_flight_intervals(self.signals, boot)
        return intersection(free_flight, self._intervals_before_loss(boot))

    def flight_segments(self, boots: Integers) -> Segments:
        """Returns the flights of some boots until the vehicle was lost, as segments in order of boot and time.

        Args:
            boots: (N,) numbers of these boots, such as the boot of each sample of a series; each counts once.
        """
        segments = []
        for boot in np.unique(boots).tolist():
            segments += [Segment(boot, start, end) for start, end in self.flights(boot)]
        return tuple(segments)

    def in_flight(self, series: TimeSeries | None) -> Iterator[TimeSeries]:
        """Yields the samples of a series in each flight, for flights with at least one sample.

        A flight here ends when the vehicle was lost: what sensors measure after an impact does not show the
        vehicle.

        Args:
            series: (N,) or (N, k) samples of one or several boots; None, for a message that was not recorded, yields
                nothing.
        """
        if series is None:
            return
        for boot in np.unique(series.boot).tolist():
            series_of_boot = series.of_boot(boot)
            for flight in self.flights(boot):
                samples = series_of_boot.within(flight)
                if len(samples.time):
                    yield samples

    def values_in_flight(self, series: TimeSeries | None) -> Array:
        """Returns the samples (N,) or (N, k) of a series in flight, one flight after another; (0,) without any."""
        values_by_flight = [flight.values for flight in self.in_flight(series)]
        return np.concatenate(values_by_flight) if values_by_flight else np.zeros(0)

    def averages_in_flight(self, series: TimeSeries | None) -> Array:
        """Returns the moving average of a signal over 2 s at each of its samples in flight.

        Args:
            series: (N,) samples of the signal; None if it was not recorded.

        Returns:
            (n,) averages, in the unit of the signal, one flight after the other; empty without samples in flight.
        """
        # An empty array comes first, since without any array there is nothing to join.
        averages_by_flight = [np.zeros(0)]
        for samples_of_flight in self.in_flight(series):
            averages_by_flight.append(time_series.moving_average(samples_of_flight))
        return np.concatenate(averages_by_flight)

    def settled_segments(self, excluded_modes: frozenset[str]) -> Segments:
        """Returns the segments of settled flight until the vehicle was lost, without some flight modes.

        Settled flight is flight without take-off, landing and large manoeuvres. In some modes the autopilot excites the
        vehicle itself, or has no setpoint of the angle. There the motion does not show how well the vehicle follows its
        setpoints.

        Args:
            excluded_modes: names of ArduPilot's flight modes.
        """
        all_segments = settled_flight(self.signals)
        segments = []
        for segment in segments_without_modes(self.signals, all_segments, excluded_modes):
            before_loss = self._intervals_before_loss(segment.boot)
            for start, end in intersection([(segment.start, segment.end)], before_loss):
                segments.append(Segment(segment.boot, start, end))
        return tuple(segments)

    def warnings_in_flight(self, codes: Container[Code]) -> Iterator[Fact]:
        """Yields the events with certain codes that warn of something and happened in flight.

        On the ground, and after the vehicle was lost, the same events show nothing about the state of the vehicle.

        Args:
            codes: codes of the events to yield.

        Yields:
            Facts whose level is bad or to be watched, in the order of time.
        """
        for event in self.events:
            if event.code not in codes or not event.is_watch_or_bad:
                continue
            if in_intervals(event.start_time, self.flights(event.figures["boot"])):
                yield event

    def warnings_before_loss(self, codes: Container[Code]) -> Iterator[Fact]:
        """Yields the events with certain codes that warn of something, until the vehicle was lost.

        What the autopilot reports counts in flight only. What the motion shows is of a vehicle off the ground anyway,
        so that it counts in hops too, which are hardly any free flight.

        Args:
            codes: codes of the events to yield.

        Yields:
            Facts whose level is bad or to be watched, in the order of time.
        """
        for event in self.events:
            if event.code not in codes or not event.is_watch_or_bad:
                continue
            boot = event.figures["boot"]
            counted_intervals = self.flights(boot)
            if counted_intervals and isinstance(event.code, MotionEvent):
                counted_intervals = self._intervals_before_loss(boot)
            if in_intervals(event.start_time, counted_intervals):
                yield event

    def _intervals_before_loss(self, boot: int) -> Intervals:
        """Returns the time of a boot before the vehicle lost its attitude, fell or crashed, if it did.

        Args:
            boot: number of the boot, from 0.

        Returns:
            One interval, s on the clock of the boot. It is unbounded if no flight was lost, if the loss was in another
            boot, or if its time is not known.
        """
        all_time = [(-inf, inf)]
        loss = self.ending
        if loss is None:
            return all_time
        # A loss whose boot is not known applies to each.
        is_of_boot = loss.figures.get("boot", boot) == boot
        onset = loss_onset(loss)
        if not is_of_boot or not onset:
            return all_time
        return [(-inf, onset)]
