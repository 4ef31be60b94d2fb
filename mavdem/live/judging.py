"""Judging in a live session: what the latest model is good for, again and again in flight, and at the end."""

from collections.abc import Sequence
from concurrent.futures import CancelledError, Executor, Future
from contextlib import suppress
from dataclasses import replace

from mavdem.assessment.axis.findings import (
    Findings,
    model_findings,
    with_vehicle_made_torque_marked,
)
from mavdem.assessment.headline import headline_by_lights
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.next_step import choose_next_step
from mavdem.dataset.intervals import Intervals
from mavdem.dem import Learned
from mavdem.facts import Fact
from mavdem.facts.assessment import Override
from mavdem.facts.lights import Light, Unjudged
from mavdem.live.learning import FlightLearning
from mavdem.live.margin_confirmation import MarginConfirmation
from mavdem.live.margin_review import MARGINS_AWAITED
from mavdem.live.model_judgement import JudgedModel, judge_model
from mavdem.live.rows import RowFormat
from mavdem.live.stream import LiveStream
from mavdem.motors.motor_changes import MotorChange

JUDGING_PERIOD = 10.0
"""Time between the beginnings of two judgements, s: a choice of computing time."""

OWN_TORQUE_OVERRIDES = (Override.OSCILLATION, Override.MOTORS)
"""Findings with which the torque that was estimated as the wind's is the vehicle's own: a limit cycle, a weak motor."""


class ModelJudging:
    """Judges the latest model of a live session: in flight in another process, so that no row waits, and at the end.

    Attributes:
        findings: what the model is good for; None before it is judged.
        judgement: headline, lights and next step by the model; None before, and where it cannot be judged.
        is_of_recording: whether the judgement is that of the recording.
    """

    def __init__(self, executor: Executor | None, recording_name: str | None) -> None:
        """Prepares the judging of models; none is judged yet.

        Args:
            executor: executor in which models are judged in flight; None to judge at the end only.
            recording_name: the log that shows more; empty if it is known later, None without one.
        """
        self.findings: Findings | None = None
        self.judgement: Judgement | None = None
        self.is_of_recording = False
        self._executor = executor
        self._recording_name = recording_name
        self._pending: Future[JudgedModel] | None = None
        self._margin_confirmation = MarginConfirmation()
        self._next_judging_time = 0.0

    def update(
        self,
        now: float,
        learning: FlightLearning,
        stream: LiveStream,
        *,
        is_busy: bool,
        has_rate_setpoint: bool,
    ) -> None:
        """Stores a judgement that is done, or starts to judge the newest model if that is due.

        It is called once a second and never waits: a judgement takes seconds and is made in the executor. Only one is
        under way at a time, and two start at least ``JUDGING_PERIOD`` apart. A model is judged only once its physical
        parameters are known, since the judgement is about those, and only if it was learned with the inputs of the
        latest rows.

        Args:
            now: present time, s of the monotonic clock.
            learning: learning that has the newest model.
            stream: stream that has the autopilot's parameters, and changes of the motors' balance.
            is_busy: whether this computer has no time to judge.
            has_rate_setpoint: whether the margins are reviewed by setpoints of the body rate.
        """
        if self._pending is not None:
            self._take_result(self._pending)
            return
        is_due = now >= self._next_judging_time
        if self._executor is None or is_busy or not is_due:
            return
        model = learning.newest_model
        row_format = learning.row_format
        if model is None or row_format is None or not _has_physical_parameters(learning):
            return
        self._next_judging_time = now + JUDGING_PERIOD
        named_model = learning.named_model(model, stream.parameters)
        if not _has_same_motors(row_format, named_model):
            return
        alarms = stream.motor_alarms.changes_in_latest_flight
        # The executor raises RuntimeError when its processes are gone.
        with suppress(RuntimeError):
            self._pending = self._executor.submit(
                judge_model,
                named_model,
                row_format,
                alarms,
                self._recording_name,
                climbs=learning.climbs,
                provisional_margins=MARGINS_AWAITED if has_rate_setpoint else None,
            )

    def _take_result(self, pending: Future[JudgedModel]) -> None:
        """Stores the result of a judgement that the executor has finished.

        A judgement that failed is dropped, and the one before it stays: the next one may succeed.

        Args:
            pending: the judgement that an executor computes, with the findings on the model.
        """
        if not pending.done():
            return
        with suppress(ValueError, RuntimeError, CancelledError):
            judged_model = pending.result()
            margins = judged_model.judgement.lights[Light.MARGINS]
            confirmed_margins = self._margin_confirmation.confirmed_light(margins)
            self.findings = judged_model.findings
            self.judgement = _with_margins(judged_model.judgement, confirmed_margins)
            self.is_of_recording = False
        self._pending = None

    def judge_final_model(
        self,
        model: Learned | None,
        row_format: RowFormat | None,
        alarms: Sequence[MotorChange],
        *,
        climbs: Intervals,
        has_rate_setpoint: bool,
    ) -> Learned | None:
        """Judges the model at the end of the session, in this thread, and sets ``findings`` and ``judgement``.

        Without a model, or with a model of other motors than the latest rows have, only the alarms remain to be judged.
        If the judgement fails, the one before it stays.

        Args:
            model: the final model; None without one.
            row_format: format of the latest rows; None without any.
            alarms: changes of the motors' balance in the flight of the model.
            climbs: times of climbs after take-off, s of the boot clock, whose samples are not of settled flight.
            has_rate_setpoint: whether the stream has a setpoint of the body rate by which a log identifies the loop.

        Returns:
            The model to show. If a limit cycle or a weak motor caused the torque that was estimated as the wind's, the
            model is marked so.
        """
        self.is_of_recording = False
        provisional_margins = None
        if has_rate_setpoint:
            # The recording shows the margins better than the model.
            provisional_margins = Fact(
                Unjudged.JUDGED_LATER, path=self._recording_name, reason=None
            )
        try:
            if model is None or row_format is None or not _has_same_motors(row_format, model):
                self.findings = model_findings(model, alarms=alarms)
                self.judgement = None
                return model
            self.findings, self.judgement = judge_model(
                model,
                row_format,
                alarms,
                self._recording_name,
                climbs=climbs,
                provisional_margins=provisional_margins,
            )
            # Faults that override the findings, such as a limit cycle.
            faults = [fault for fault in self.findings.overrides if fault.is_bad]
            vehicle_made_torque = any(fault.code in OWN_TORQUE_OVERRIDES for fault in faults)
            return with_vehicle_made_torque_marked(model, vehicle_made_torque=vehicle_made_torque)
        except ValueError:
            return model

    def use_judgement_of_recording(self, judgement: Judgement) -> None:
        """Replaces the judgement of the live model by the judgement of the session's recording, which knows more.

        The recording contains the setpoints and all axes. So its stability margins count, and if it does not show them,
        they are unknown: margins that were computed from the live model alone are no longer shown.

        Args:
            judgement: headline, next step and status lights that the recording shows.
        """
        self.judgement = judgement
        self.is_of_recording = True


def _has_physical_parameters(learning: FlightLearning) -> bool:
    """Returns whether the physical parameters of a model, such as the motor lag, are known, which are judged.

    Args:
        learning: learning that has the model.
    """
    return learning.estimate is not None and learning.estimate.physical is not None


def _with_margins(judgement: Judgement, margins: Fact) -> Judgement:
    """Returns a judgement with another light of the margins.

    Args:
        judgement: the judgement by a model: headline, next step, and the status light of each part of the vehicle.
        margins: the new status light of the margins. If the headline was the former one, headline and next step are
            chosen again by all lights.
    """
    former_margins = judgement.lights[Light.MARGINS]
    lights = {**judgement.lights, Light.MARGINS: margins}
    if margins == former_margins or judgement.headline != former_margins:
        return replace(judgement, lights=lights)
    headline = headline_by_lights(lights)
    next_step = choose_next_step(headline, lights)
    return replace(judgement, headline=headline, next_step=next_step, lights=lights)


def _has_same_motors(row_format: RowFormat, model: Learned) -> bool:
    """Returns whether a model was learned from the same motors as the live samples (rows) contain.

    Args:
        row_format: format of the rows, with the names of their motors.
        model: learned model, with the names of its inputs.
    """
    return model.record.input_names == row_format.geometry.names
