"""Learning of models in a live flight, from rows: samples of motor outputs, angle and body rate at equal steps."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from math import inf
from typing import NamedTuple

from mavdem.dataset.axes import model_outputs
from mavdem.dataset.flight_states import min_airborne_collective
from mavdem.dataset.intervals import Intervals, TimeInterval
from mavdem.dem import Estimate, Learned, OnlineLearner, Settings
from mavdem.errors import NotLearnable, fact_from_error, failure_fact
from mavdem.facts import Fact
from mavdem.facts.session import SessionFact
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.live.gusts import GustDetector, ResolvedTorque
from mavdem.live.history import horizon_steps
from mavdem.live.rows import AlignedRow, RowFormat
from mavdem.plant.parameters import Physical

MAX_MODELS = 16
"""Models that are kept: several times the seconds that a landing withdraws, so that one from before is among them."""

HELD_MOTION_SECONDS = 5.0
"""Time for which a report of unexpected motion is held back, s, since a loss of thrust may be its cause.

Most losses of thrust are found within 5 s (docs/evidence/motors.md), and their alarm then states the cause. Nobody need
act on unexpected motion sooner.
"""

FIT_SECONDS = 3.0
"""Time limit of the last fit, s: a choice. Where it takes longer, the model before is kept.

Without a model before it, the fit may take twice as long.
"""


class _KeptModel(NamedTuple):
    """A model that was learned in flight."""

    time: float
    """Time of the row that it came with, s of the boot clock; minus infinity for a model of an earlier boot."""

    learned: Learned
    """The model."""


class _HeldReport(NamedTuple):
    """A report that is held back."""

    time: float
    """Time of the row that it is about, s of the boot clock."""

    fact: Fact
    """The report."""


class FlightLearning:
    """Learns a model in free flight, and keeps the latest ones, so that those learned from a landing can be withdrawn.

    In free flight the vehicle is in the air and nothing holds it; settled flight is without take-off and landing, too.
    A landing is recognised only after it, so that models were learned from its rows as if they were settled flight.

    Attributes:
        learner: online learner of the latest rows; None before any row.
        estimate: estimates as of the latest row that was learned from; None before any.
        newest_model: latest model of settled flight; None before any.
        is_free_flight: whether the latest row is of free flight, and the vehicle has been flying since.
        has_landed: whether the vehicle has landed and no newer model has come since.
        has_settled: whether any row was of settled flight.
        learned_rows: number of rows that the learner used.
        unlearned_rows: number of the other rows.
    """

    def __init__(
        self,
        axis: str,
        settings: Settings,
        executor: Executor | None,
        prior: Learned | None,
        log: Callable[[Fact], None],
    ) -> None:
        """Prepares the learning; the learner is made when :meth:`begin` gets the format of the first rows.

        Args:
            axis: "roll" or "pitch".
            settings: settings of the fits.
            executor: executor in which models are learned; None to learn them in this thread.
            prior: model of an earlier flight of the vehicle; None without one.
            log: function that is called with each fact about learning.
        """
        self.learner: OnlineLearner | None = None
        self.estimate: Estimate | None = None
        self.newest_model: Learned | None = None
        self.is_free_flight = False
        self.has_landed = False
        self.has_settled = False
        self.learned_rows = 0
        self.unlearned_rows = 0
        self._axis = axis
        self._settings = settings
        self._executor = executor
        self._prior = prior
        self._log = log
        self._row_format: RowFormat | None = None
        self._gusts: GustDetector | None = None
        self._torque: ResolvedTorque | None = None
        # Time of the latest landing, s of the boot clock.
        self._landing_time = -inf
        # Whether a motor had lost thrust at the latest row.
        self._is_motor_weak = False
        # The report of the latest unexpected motion, until it is made or dropped; None for none.
        self._held_report: _HeldReport | None = None
        self._models: deque[_KeptModel] = deque(maxlen=MAX_MODELS)
        # The latest model of a climb after take-off, which is not kept.
        self._climb_model: Learned | None = None
        # First and last time of the climb, s of the boot clock, by the number of the segment that the climb is part of.
        self._climb_by_segment: dict[int, TimeInterval] = {}

    @property
    def row_format(self) -> RowFormat | None:
        """What the latest rows are; None before any."""
        return self._row_format

    @property
    def climbs(self) -> Intervals:
        """The times of climbs after take-off that the learner has rows of, s of the boot clock; empty without any."""
        return list(self._climb_by_segment.values())

    def begin(self, row_format: RowFormat) -> None:
        """Prepares for the rows of another segment: those after a gap, or with other motors or another time step.

        If motors and time step are the same, the learner continues across the gap between the segments. Otherwise its
        matrices no longer fit, and a new learner begins.

        Args:
            row_format: names of motors and outputs, units and time step of the next rows.
        """
        # The format of the rows of the segment before; None before the first one.
        former_format = self._row_format
        self._row_format = row_format
        if former_format is not None:
            if former_format.boot != row_format.boot:
                self._date_models_of_other_boot()
            has_same_motors = former_format.geometry.names == row_format.geometry.names
            has_same_step = former_format.dt == row_format.dt
            if has_same_motors and has_same_step:
                return
        self._begin_learner(row_format)

    def forget_prior(self) -> None:
        """Begins a learner without the model of an earlier flight: that was of another vehicle."""
        self._prior = None
        if self._row_format is not None:
            self._begin_learner(self._row_format)

    def _begin_learner(self, row_format: RowFormat) -> None:
        """Begins a new learner, with what depends on the time step of its rows.

        Args:
            row_format: names of motors and outputs, units and time step of the next rows.
        """
        self.learner = self._new_learner(row_format)
        self._gusts = GustDetector(row_format.dt)
        self._torque = ResolvedTorque(row_format.dt)
        self.estimate = None

    def _new_learner(self, row_format: RowFormat) -> OnlineLearner:
        """Returns a learner for rows of a format, which starts from the model of an earlier flight if that fits.

        Args:
            row_format: names of motors and outputs, units and time step of the rows.
        """
        geometry = row_format.geometry
        # The signs in which each motor turns the vehicle about the axis; None where the motors' places are guessed.
        effect_directions = None
        if not geometry.positions_assumed:
            effect_directions = geometry.mixer_row(self._axis)
        return OnlineLearner(
            self._settings,
            row_format.dt,
            len(geometry.names),
            len(model_outputs(self._axis)),
            executor=self._executor,
            horizons=horizon_steps(row_format.dt),
            effect_directions=effect_directions,
            prior=self._prior_parameters(row_format),
        )

    def _prior_parameters(self, row_format: RowFormat) -> Physical | None:
        """Returns the physical parameters by an earlier flight, from which learning starts; None if there are none.

        Those of motor outputs in another unit are not used, which is reported.

        Args:
            row_format: names of motors and outputs, units and time step of the rows.
        """
        if self._prior is None:
            return None
        if self._prior.record.input_units != row_format.input_units:
            # Thrust per output is not comparable between outputs of different units.
            self._log(Fact(SessionFact.PRIOR_NOT_USED))
            return None
        return self._prior.physical

    def _date_models_of_other_boot(self) -> None:
        """Sets the time of all models so far to minus infinity, at the first rows after a restart of the autopilot.

        Their times are on the clock of the former boot. A landing withdraws the models that are later than its
        beginning, and must not withdraw any of these.
        """
        redated_models = [_KeptModel(-inf, model.learned) for model in self._models]
        self._models = deque(redated_models, MAX_MODELS)

    def allow_fits(self, *, physical_fits: bool, model_refits: bool) -> None:
        """Sets which fits the learner may start from now on; a busy computer has no time for them.

        Estimates continue with the latest model. Before the first row there is no learner, and nothing is set.

        Args:
            physical_fits: whether the physical parameters may be fitted again.
            model_refits: whether the model may be learned again. A first model is learned in any case, since there are
                no estimates without one.
        """
        if self.learner is None:
            return
        has_model = self.learner.learned is not None
        self.learner.fits_physical = physical_fits
        self.learner.refits = model_refits or not has_model

    def learn_row(self, row: AlignedRow, weak_since: float | None) -> Estimate | None:
        """Passes a row, the sample of one time in free flight, to the learner of the model, and keeps a new model.

        A row that the learner refuses, for example with values that are not finite, is reported and skipped. Before the
        first row of a segment :meth:`begin` must be called, which creates the learner.

        Args:
            row: motor outputs and motion of the vehicle at one time.
            weak_since: time since which a motor has lost thrust, s of the boot clock; None if all are sound.

        Returns:
            The learner's estimate; None if it cannot use the row.
        """
        learner = self.learner
        assert learner is not None
        # Free flight that is not settled is the climb after take-off. The model is learned from it, too, but the wind
        # torque is estimated in settled flight only.
        learner.follows_torque = row.is_settled
        if not row.is_settled:
            climb_start, _ = self._climb_by_segment.get(row.segment, (row.time, row.time))
            self._climb_by_segment[row.segment] = (climb_start, row.time)
        self._is_motor_weak = weak_since is not None
        estimate = None
        try:
            estimate = learner.update(row.time, row.outputs, row.inputs, weak_since)
        except ValueError as error:
            self._log(failure_fact(SessionFact.SAMPLE_SKIPPED, error))
        self._keep_model(row, learner.learned)
        if estimate is None or self._torque is None:
            return estimate
        # A wind torque that is smaller than its error is left out.
        return self._torque.resolved(estimate)

    def _keep_model(self, row: AlignedRow, model: Learned | None) -> None:
        """Keeps the learner's model, if it is new and of settled flight, with the time at which it was learned.

        After a landing, these times show which models were learned from the landing itself: :meth:`withdraw_since`
        removes those. A model of the climb after take-off is not kept. It is stored in ``_climb_model`` only because
        the learner still returns it when settled flight begins, when it must not count as a new one.

        Args:
            row: the sample, of one time, that the learner was updated with.
            model: the learner's latest model; None before any.
        """
        if not row.is_settled:
            self._climb_model = model
            return
        self.has_settled = True
        is_known_model = model in (self.newest_model, self._climb_model)
        if model is not None and not is_known_model:
            self.newest_model = model
            # A model that is newer than the last landing is of another flight.
            self.has_landed = False
            self._models.append(_KeptModel(row.time, model))

    def note_estimate(
        self,
        estimate: Estimate | None,
        row: AlignedRow,
        parameters: Parameters,
        *,
        is_late: bool = False,
    ) -> None:
        """Takes the estimate of a row: counts the row, and reports unexpected motion and gusts that begin with it.

        The row's segment must have begun, as for :meth:`learn_row`.

        Args:
            estimate: estimate of the row; None if it was not learned from.
            row: motor outputs and motion of the vehicle at one time.
            parameters: parameters of the vehicle; some of them state the idle output of the motors.
            is_late: whether this computer is late now. Then the model is old and samples were left out, so that
                unexpected motion says nothing about the vehicle.
        """
        if estimate is None:
            self.unlearned_rows += 1
            return
        self.learned_rows += 1
        was_unexpected = self.estimate is not None and self.estimate.unusual
        # A vehicle falls while its motors idle, which has an alarm of its own. No gust need have moved it.
        is_new = estimate.unusual and not was_unexpected and not is_late
        if is_new and self._held_report is None and not self._are_motors_at_idle(row, parameters):
            self._held_report = _HeldReport(row.time, _unexpected_motion(estimate))
        self._report_unexpected_motion(row.time)
        self.estimate = estimate
        # ``begin`` has made the detector together with the learner that gave the estimate.
        assert self._gusts is not None
        for gust in self._gusts.add(estimate):
            self._log(gust)

    def _are_motors_at_idle(self, row: AlignedRow, parameters: Parameters) -> bool:
        """Returns whether the motors turn too slowly to carry the vehicle.

        Args:
            row: motor outputs of the vehicle at one time.
            parameters: parameters of the vehicle; some of them state the idle output of the motors.
        """
        assert self.row_format is not None
        collective = self.row_format.scale.fraction(row.inputs).mean()
        return bool(collective <= min_airborne_collective(parameters))

    def _report_unexpected_motion(self, now: float) -> None:
        """Reports unexpected motion ``HELD_MOTION_SECONDS`` after it began, unless a motor is found to be weak by then.

        :meth:`note_estimate` holds the report back in ``_held_report``. The alarm of a weak motor says what moved the
        vehicle, so that the report, which has other advice, is dropped.

        Args:
            now: time of the latest row, s of the boot clock.
        """
        held_report = self._held_report
        if held_report is None:
            return
        if self._is_motor_weak:
            self._held_report = None
            return
        # The clock begins again when the autopilot restarts, so that the age may be negative.
        age = now - held_report.time
        if not 0.0 <= age < HELD_MOTION_SECONDS:
            self._held_report = None
            self._log(held_report.fact)

    def withdraw_since(self, landing_time: float) -> None:
        """Removes the samples of a landing or of a loss of control, and the models that were learned from them.

        Ground contact, ground effect and a tumble would spoil the model. The learner then fits a model to the samples
        from before the landing. Until that fit has ended, the last model from before the landing is the one to keep at
        the end of the session (:meth:`final_model`). There must be a learner, which has the samples.

        Args:
            landing_time: time when the landing or the loss of control began, s of the boot clock.
        """
        assert self.learner is not None
        self.learner.forget_since(landing_time)
        # Models are kept in the order of their times, so that those to withdraw are the last ones.
        while self._models and self._models[-1].time > landing_time:
            self._models.pop()
        self.has_landed = True
        self._landing_time = landing_time

    def adopt_model_before_landing(self, timeout: float = 0.0) -> None:
        """Adds the model from the samples before a landing to the models of the flight, once its fit has finished.

        In flight the learner adopts a finished fit with the next row. After a landing no rows come, so that this method
        makes the learner adopt it. Without a finished fit nothing changes.

        Args:
            timeout: longest time to wait for the model, s.
        """
        if not self.has_landed or self.learner is None:
            return
        former_model = self.learner.learned
        self.learner.adopt_finished_fit(timeout)
        model = self.learner.learned
        if model is None or model is former_model:
            # No fit has finished.
            return
        # A model of the climb alone is not kept: the flight must have been settled, which it is after the climb.
        if self.has_settled:
            self.newest_model = model
            self._models.append(_KeptModel(self._landing_time, model))

    def final_model(self, parameters: Parameters) -> Learned:
        """Returns the model to keep at the end of the session.

        After a landing it is the model that was learned from the samples before the landing. In flight, or if there is
        no such model, one is learned now from the samples that the learner has. If that fails, the latest model of the
        flight is kept, and a fact says why.

        Args:
            parameters: parameters of the autopilot, whose gains are kept in the model.

        Returns:
            The model.

        Raises:
            NotLearnable: there is no model; the error states why.
        """
        has_only_climbed = self.learned_rows > 0 and not self.has_settled
        if self.learner is None or has_only_climbed:
            # A model of the climb after take-off may have been shown as the first one, but is not kept.
            climb_only = self._climb_model is not None
            raise NotLearnable(SessionFact.NO_LIVE_FLIGHT, climb_only=climb_only)
        self.adopt_model_before_landing(FIT_SECONDS)
        latest_model = self.latest_model(parameters)
        if self.has_landed and latest_model is not None:
            return latest_model
        max_seconds = FIT_SECONDS
        if latest_model is None:
            # Without a model to fall back on, the fit may take longer.
            max_seconds = 2 * FIT_SECONDS
        try:
            return self.named_model(_model_learned_now(self.learner, max_seconds), parameters)
        except NotLearnable as error:
            if latest_model is None:
                raise
            self._log(Fact(SessionFact.FORMER_MODEL_KEPT, reason=error.fact))
            return latest_model

    def latest_model(self, parameters: Parameters) -> Learned | None:
        """Returns the newest of the models that were learned so far, complete with names and units; None before any.

        Nothing is learned by this call, so that it is quick.

        Args:
            parameters: all parameters of the autopilot, by name; the gains among them are kept in the model.
        """
        if not self._models:
            return None
        newest_model = self._models[-1].learned
        return self.named_model(newest_model, parameters)

    def named_model(self, learned: Learned, parameters: Parameters) -> Learned:
        """Returns a learner's model with what it needs to be judged, and written to a file.

        A learner knows columns of numbers only. The completed model has the names and units of inputs and outputs, the
        range of the inputs, the gains of the autopilot, and the latest physical parameters, which are fitted
        separately.

        Args:
            learned: model of the motors' effect on the motion. One with another number of motors than the latest rows
                is returned unchanged.
            parameters: all parameters of the autopilot, by name; the control parameters among them are kept.
        """
        row_format = self._row_format
        if row_format is None:
            return learned
        motor_names = row_format.geometry.names
        input_count = learned.record.inputs.shape[1]
        if input_count != len(motor_names):
            # The model is of other motors than the latest rows: their names would be wrong.
            return learned
        outputs = model_outputs(self._axis)
        record = replace(
            learned.record,
            input_names=motor_names,
            output_names=tuple(output.name for output in outputs),
            input_units=row_format.input_units,
            output_units=tuple(output.unit for output in outputs),
            parameters=_control_parameters(parameters),
            input_range=(row_format.scale.low, row_format.scale.high),
        )
        named_model = replace(learned, record=record)
        if self.estimate is None or self.estimate.physical is None:
            return named_model
        return named_model.with_physical(self.estimate.physical)


def _control_parameters(parameters: Parameters) -> dict[str, float]:
    """Returns the parameters of the autopilot that its control loops depend on, such as their gains.

    Args:
        parameters: all parameters of the autopilot, by name.
    """
    control_parameters = {}
    for name, value in parameters.items():
        if CONTROL_PARAMETERS.match(name):
            control_parameters[name] = value
    return control_parameters


def _model_learned_now(learner: OnlineLearner, max_seconds: float) -> Learned:
    """Returns a model of the learner's latest samples.

    Args:
        learner: the learner, which has had samples.
        max_seconds: time limit of the fit, s.

    Returns:
        The model.

    Raises:
        NotLearnable: the fit failed, took too long, or its process is gone; the error states which.
    """
    try:
        return learner.learn_now(max_seconds)
    except TimeoutError as error:
        reason = Fact(SessionFact.NOT_LEARNED_IN_TIME, duration=max_seconds)
        raise NotLearnable(reason) from error
    except (ValueError, RuntimeError) as error:
        raise NotLearnable(fact_from_error(error)) from error


def _unexpected_motion(estimate: Estimate) -> Fact:
    """Returns the report that the motion has become improbable for the model, with the cause if that is known.

    Args:
        estimate: the first estimate with unexpected motion.
    """
    # The latest mark is the one that begins with this estimate.
    mark = estimate.latest_mark
    cause = None if mark is None else mark.cause
    return Fact(SessionFact.MOTION_UNEXPECTED, clock=estimate.window_center, cause=cause)
