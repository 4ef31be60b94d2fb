"""Milestones of a live flight, reported once each: the first model, its parameters, and after landing all results.

The first estimate of the wind is reported by ``mavdem.live.wind``.
"""

from collections.abc import Callable
from math import isfinite
from typing import Any

import numpy as np

from mavdem.assessment.flight_verdict import FlightVerdict, worst_first
from mavdem.dem import Learned
from mavdem.facts import Fact
from mavdem.facts.lights import Light
from mavdem.facts.margins import MarginsLight
from mavdem.facts.session import SessionFact
from mavdem.live.learning import FlightLearning
from mavdem.live.session_status import SessionStatus
from mavdem.live.unseen_end import judgement_with_unseen_end
from mavdem.live.wind import WindEstimate
from mavdem.plant.parameters import Physical

MAX_VERDICTS = 100
"""Verdicts on earlier flights that are kept, at most: a choice. It bounds the memory for a landed state that flaps."""

MARGIN_FIGURES = ("phase_margin", "phase_margin_interval", "gain_margin", "gain_margin_interval")
"""Figures of the fact on the control loop's stability margins that are reported after a landing."""


class Milestones:
    """Reports when results of a live session become known, as facts (coded findings with figures).

    Attributes:
        margins_follow: whether the recording will be judged, so that neither margins by the model alone nor an
            all-clear are reported.
    """

    def __init__(self, axis: str, log: Callable[[Fact], None]) -> None:
        """Prepares the reports; no milestone has been reached yet.

        Args:
            axis: "roll" or "pitch".
            log: function that is called with each fact.
        """
        self._axis = axis
        self._log = log
        self.margins_follow = False
        self._has_model = False
        self._has_parameters = False
        # Number of the boot at the latest update.
        self._boot = 0
        # Whether the vehicle has flown since a flight was reported last, and why there was no wind in that flight.
        self._has_flown = False
        self._no_wind_reason: Fact | None = None
        # The mean wind of the latest flight; None without an estimate.
        self._mean_wind: WindEstimate | None = None
        # Whether the vehicle flew at the latest update.
        self._was_flying = False
        # Number of the latest flight whose verdict was reported before the next flight: at the end of a lost flight, or
        # when the recording was judged. None for none.
        self._reported_verdict: int | None = None
        # When the flight ended that is not reported yet, s of the boot clock; None without one.
        self._landing_to_report: float | None = None
        # How many rows had been learned from at the last report of a flight.
        self._reported_rows = 0
        # The verdicts on the flights before the latest one, and on that one; None before any.
        self._earlier_verdicts: list[FlightVerdict] = []
        self._latest_verdict: FlightVerdict | None = None

    @property
    def verdicts(self) -> tuple[FlightVerdict, ...]:
        """The verdicts on all flights of the session, in their order."""
        if self._latest_verdict is None:
            return ()
        return (*self._earlier_verdicts, self._latest_verdict)

    def note_first_model(
        self, learning: FlightLearning, now: float, takeoff_time: float, *, is_flying: bool
    ) -> None:
        """Reports the first model with its time, and how long after the take-off it was learned.

        Nothing is reported before there is a model, and after the first report. A first model that a slow computer has
        only after the landing is no news either: the report on the flight has what it shows.

        Args:
            learning: learning that has the latest model.
            now: present time on the boot clock, s.
            takeoff_time: time when the vehicle left the ground, s of that clock; minus infinity where that was not
                seen.
            is_flying: whether the vehicle is in the air now.
        """
        learner = learning.learner
        has_model = learner is not None and learner.learned is not None
        if self._has_model or not has_model or not is_flying:
            return
        self._has_model = True
        seconds_since_takeoff = now - takeoff_time
        # The report has no duration if the take-off was not seen.
        duration = seconds_since_takeoff if isfinite(seconds_since_takeoff) else None
        self._log(Fact(SessionFact.FIRST_MODEL, clock=now, axis=self._axis, duration=duration))

    def update(
        self, learning: FlightLearning, status: SessionStatus, now: float, boot: int = 0
    ) -> None:
        """Reports what has become known since the last call, about a second ago.

        Once for each flight it reports that the physical parameters are known and, when the vehicle has landed or is
        lost, what the flight has shown. The verdict on each flight, which says how it is judged and whether the vehicle
        was lost in the air, is kept until the end of the session.

        A restart is noted first, since it says that the flight before it was lost, and a new flight before its verdict
        replaces that of the former one. A landing is noted before it is reported.

        Args:
            learning: the learning of the flight, with the latest physical parameters.
            status: status of the session, with the judgement of the flight so far.
            now: present time on the boot clock, s.
            boot: number of the present boot.
        """
        if boot != self._boot:
            self._note_restart(boot)
        former_verdict = self._latest_verdict
        if former_verdict is not None and status.is_flying:
            has_new_flight_begun = former_verdict.number != status.flight_number
            if has_new_flight_begun:
                self._end_former_flight(former_verdict)
        self._update_verdict(status)
        self._report_parameters(learning)
        self._store_wind_or_landing(status, now)
        self._report_landing(learning, status)
        self._report_verdict(status)

    def _report_parameters(self, learning: FlightLearning) -> None:
        """Reports the physical parameters once in each flight, as soon as they are identifiable.

        Later fits only change the figures.

        Args:
            learning: learning that has the latest fit of the physical parameters.
        """
        physical = _latest_physical(learning)
        if self._has_parameters or physical is None or not physical.identifiable:
            return
        self._has_parameters = True
        parameter_figures = _parameter_figures(learning, physical)
        self._log(Fact(SessionFact.PARAMETERS_KNOWN, axis=self._axis, **parameter_figures))

    def _report_landing(self, learning: FlightLearning, status: SessionStatus) -> None:
        """Reports what a flight has shown, once it is over and it is known how it ended.

        A vehicle whose motors were stopped in the air is still falling: it has neither landed nor is it lost yet.

        Args:
            learning: learning that has the latest estimates of the flight.
            status: status of the session, with how the flight ended.
        """
        landing_time = self._landing_to_report
        is_end_known = status.has_landed or status.loss is not None
        if landing_time is None or not is_end_known:
            return
        self._report_flight(learning, status, landing_time, _latest_physical(learning))
        self._landing_to_report = None

    def _report_verdict(self, status: SessionStatus) -> None:
        """Reports the verdict on the latest flight after its end, once, if it is final or the vehicle was lost.

        The verdict is final when the recording of the flight has been judged. The verdict on a lost flight does not
        wait for that: it is reported when the vehicle no longer flies or its messages end. Any other verdict is
        reported at the next take-off (:meth:`_end_former_flight`).

        Args:
            status: status of the session.
        """
        verdict = self._latest_verdict
        if verdict is None or verdict.number == self._reported_verdict:
            return
        has_ended = not status.is_flying or status.is_silent
        is_lost = status.loss is not None and has_ended
        is_judged = status.is_recording_judged and not status.is_flying
        if is_lost or is_judged:
            self._reported_verdict = verdict.number
            self._log(verdict.fact_in_next_flight)

    def _note_restart(self, boot: int) -> None:
        """Notes that the autopilot has restarted. If the vehicle flew, the judgement of that flight says it was lost.

        How the flight ended is not known then: the messages of the new boot begin some time after the restart.

        Args:
            boot: number of the new boot, which counts from 0 for the first one that the session received.
        """
        self._boot = boot
        if self._was_flying and self._latest_verdict is not None:
            former_verdict = self._latest_verdict
            self._latest_verdict = former_verdict._replace(
                judgement=judgement_with_unseen_end(former_verdict.judgement), is_lost_in_air=True
            )
        # Just after a restart it is not known whether the vehicle flies. Without this reset the next update would take
        # the change from flying to not flying for a landing.
        self._was_flying = False

    def _update_verdict(self, status: SessionStatus) -> None:
        """Keeps the verdict on the latest flight up to date: how it is judged, and whether it was lost in the air.

        Args:
            status: status of the session, with the judgement of the latest flight.
        """
        former_verdict = self._latest_verdict
        if status.is_flying:
            # In flight the verdict is that of the moment. This holds too if the flight goes on after a restart of the
            # autopilot in the air, by which it seemed to be lost.
            self._latest_verdict = status.verdict
        elif former_verdict is not None and not former_verdict.is_lost_in_air:
            # After the landing the duration stays, and the judgement may become that of the recording.
            self._latest_verdict = former_verdict._replace(judgement=status.verdict.judgement)
        elif former_verdict is None and status.loss is not None:
            # The session began after a crash, in whose flight it saw nothing.
            self._latest_verdict = status.verdict

    def _end_former_flight(self, verdict: FlightVerdict) -> None:
        """Reports and keeps the verdict on a flight when the next one has begun, whose milestones are reported anew.

        From the new take-off on, lights and headline of the session are about the new flight. Until the end of the
        session, when the verdicts on all flights are reported, only this report states the verdict on the old one.

        Args:
            verdict: how the flight before the one that begins is judged, which may have been reported already.
        """
        self._keep_verdict(verdict)
        if verdict.number != self._reported_verdict:
            self._log(verdict.fact_in_next_flight)
        self._forget_milestones()

    def _keep_verdict(self, verdict: FlightVerdict) -> None:
        """Keeps the verdict on a flight that is over; of more than ``MAX_VERDICTS`` the least severe is forgotten.

        Args:
            verdict: the judgement of the flight before the one that begins, with its headline and next step.
        """
        self._earlier_verdicts.append(verdict)
        if len(self._earlier_verdicts) > MAX_VERDICTS:
            least_severe = worst_first(self._earlier_verdicts)[-1]
            self._earlier_verdicts.remove(least_severe)

    def _forget_milestones(self) -> None:
        """Resets what was reported of a flight: its first model, its physical parameters and its learned rows.

        Each is reported once in a flight, so that the next flight reports them again.
        """
        self._has_model = False
        self._has_parameters = False
        self._reported_rows = 0

    def _store_wind_or_landing(self, status: SessionStatus, now: float) -> None:
        """Stores the wind so far while the vehicle flies, and the time of its landing when it has just landed.

        Both are needed until the results of the flight are reported.

        Args:
            status: status of the session, with the estimated wind and whether the vehicle flies.
            now: present time on the boot clock, s.
        """
        has_just_landed = self._was_flying and not status.is_flying
        self._was_flying = status.is_flying
        if status.is_flying:
            self._landing_to_report = None
            self._has_flown = True
            # The wind is kept here, since a restart of the autopilot after the landing resets that of the status.
            self._no_wind_reason = status.no_wind_reason
            self._mean_wind = status.mean_wind
        elif has_just_landed:
            # The landing is recognised some time after it.
            self._landing_to_report = now if status.landing_time is None else status.landing_time

    def report_end(
        self, learning: FlightLearning, status: SessionStatus, now: float, model: Learned | None
    ) -> None:
        """Reports what the latest flight has shown when the session ends, unless its landing was reported before.

        Args:
            learning: what was learned in the flight, with the latest estimate of the physical parameters.
            status: status of the session, with the judgement of the final model and the wind.
            now: present time on the boot clock, s.
            model: the model that was learned when the session ended; None without one.
        """
        physical = _latest_physical(learning)
        if physical is None and model is not None:
            # The flight was too short for a fit of the physical parameters before its end.
            physical = model.physical
        self._report_flight(learning, status, now, physical)

    def _report_flight(
        self,
        learning: FlightLearning,
        status: SessionStatus,
        now: float,
        physical: Physical | None,
    ) -> None:
        """Reports what the latest flight has shown, unless this was reported already.

        Args:
            learning: counts the rows (samples of the flight) that the model has learned from.
            status: status of the session, with the judgement of the model and the wind.
            now: present time on the boot clock, s.
            physical: the latest physical parameters; None without any.
        """
        has_learned_more = learning.learned_rows > self._reported_rows
        if not self._has_flown and not has_learned_more:
            return
        self._has_flown = False
        self._reported_rows = learning.learned_rows
        if status.loss is not None and physical is None:
            # The loss of the vehicle was an alarm. A flight that ended before any result was known has shown no more.
            return
        self._log(self._flight_fact(learning, status, now, physical))

    def _flight_fact(
        self,
        learning: FlightLearning,
        status: SessionStatus,
        now: float,
        physical: Physical | None,
    ) -> Fact:
        """Returns what the latest flight has shown as a fact: how it ended, wind, physical parameters and margins.

        Args:
            learning: learning that has the unit of the inputs.
            status: status of the session, with the judgement of the model and the wind.
            now: present time on the boot clock, s.
            physical: the latest physical parameters, such as the rate damping; None without any.

        Returns:
            The fact, with a figure for each result. What is not known is None, with the reason if there is one: the
            ``shortfall`` is why no parameters were fitted. If ``margins_follow``, the recording of the flight will give
            its margins. The ``delay``, s, is the longest one of an estimate behind its measurements.
        """
        margins = status.overall_judgement.lights.get(Light.MARGINS)
        longest_delay = status.latency.longest
        return Fact(
            SessionFact.FLIGHT_LEARNED,
            clock=now,
            axis=self._axis,
            is_flying=status.is_flying or not status.has_landed,
            is_lost=status.loss is not None,
            is_lost_in_air=self._is_lost_in_air(status),
            verdict=self._headline_at_landing(status),
            is_fitted=physical is not None,
            margins_follow=self.margins_follow,
            **_margin_figures(margins),
            **self._wind_figures(status),
            shortfall=status.shortfall if physical is None else None,
            delay=longest_delay if isfinite(longest_delay) else None,
            **_parameter_figures(learning, physical),
        )

    def _is_lost_in_air(self, status: SessionStatus) -> bool:
        """Returns whether the latest flight counts as lost in the air, since the autopilot restarted in it.

        The verdict on the flight says so from the restart on (:meth:`_note_restart`). If the vehicle is seen to fly
        after the restart, it was not lost.

        Args:
            status: status of the session, with whether the vehicle flies now.
        """
        verdict = self._latest_verdict
        return verdict is not None and verdict.is_lost_in_air and not status.is_flying

    def _headline_at_landing(self, status: SessionStatus) -> Fact | None:
        """Returns the headline of the latest flight (its worst problem, or that there was none) if it has just landed.

        Returns:
            The headline; None where others report it: an alarm reports the loss of the vehicle, and the end of the
            session the headlines of all flights.
        """
        has_landed_in_session = status.has_landed and not status.is_over
        is_lost = status.loss is not None or self._is_lost_in_air(status)
        if self._latest_verdict is None or is_lost or not has_landed_in_session:
            return None
        return self._latest_verdict.judgement.headline

    def _wind_figures(self, status: SessionStatus) -> dict[str, Any]:
        """Returns the wind of the flight as figures of a fact: its mean, or why it is not known.

        Args:
            status: status of the session, which has the wind unless the autopilot has restarted after the landing.

        Returns:
            "reason": facts on the speed and the direction of the mean wind, empty if it is not known;
            "wind_obstacle": why it is not known, if there is a reason.
        """
        mean_wind = status.mean_wind or self._mean_wind
        if mean_wind is None:
            return {"reason": (), "wind_obstacle": self._no_wind_reason}
        return {"reason": mean_wind.facts, "wind_obstacle": None}


def _margin_figures(margins: Fact | None) -> dict[str, Any]:
    """Returns the margins of a control loop that are to be reported after a flight.

    Args:
        margins: the fact (coded finding) on the margins: the margins themselves, or why there are none; None if they
            were not judged.

    Returns:
        Phase margin, degrees, and gain margin, dB, with their intervals (``MARGIN_FIGURES``), by name. All are None if
        the margins are not known, or contradicted by the measured response of the vehicle.
    """
    unknown_figures = dict.fromkeys(MARGIN_FIGURES)
    if margins is None or margins.code is not MarginsLight.LOOP_MARGINS:
        return unknown_figures
    # A measured response that contradicts the margins is the reason to doubt them.
    reason_to_doubt = margins.figures["reason"]
    if reason_to_doubt is not None:
        return unknown_figures
    return {name: margins.figures[name] for name in MARGIN_FIGURES}


def _latest_physical(learning: FlightLearning) -> Physical | None:
    """Returns the physical parameters of the latest estimate; None without any."""
    return None if learning.estimate is None else learning.estimate.physical


def _parameter_figures(learning: FlightLearning, physical: Physical | None) -> dict[str, Any]:
    """Returns the physical parameters as figures of a fact, each with the half width of its 90 % interval.

    Args:
        learning: learning that has the unit of the inputs.
        physical: the physical parameters; None without any.

    Returns:
        Mean effect of the motors, rad/s² per unit of input, and rate damping, 1/s; None for what is not identifiable.
    """
    figures: dict[str, Any] = {
        "effect": None,
        "effect_error": None,
        "damping": None,
        "damping_error": None,
        "input_unit": "",
    }
    if learning.row_format is not None and learning.row_format.input_units:
        # All inputs have the same unit.
        figures["input_unit"] = learning.row_format.input_units[0]
    if physical is None:
        return figures
    # The half width of an interval is infinite for a parameter that is not identifiable.
    effect, effect_error = physical.mean_effect()
    if np.isfinite(effect_error):
        figures["effect"] = effect
        figures["effect_error"] = effect_error
    damping_error = physical.interval().damping
    if np.isfinite(damping_error):
        figures["damping"] = physical.damping
        figures["damping_error"] = damping_error
    return figures
