"""The result of ``learn``: a learned model in physical units, with its posterior, forecasts and analyses."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike
from pydantic import PlainSerializer, PlainValidator, WithJsonSchema

from mavdem.arrays import Array, Flags, Indices
from mavdem.confidence import CONFIDENCE_LEVEL, half_width
from mavdem.dem.document import from_text, to_text
from mavdem.dem.engine.ascent import FreeEnergy, Learning
from mavdem.dem.engine.free_energy import SampleFreeEnergy, Term
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, may_overflow
from mavdem.dem.engine.model import LinearModel, unpack
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.fitting import generalized_data
from mavdem.dem.forecast.forecasting import ForecasterBase
from mavdem.dem.forecast.joint import JointModel
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.plant_forecasts import FORECAST_HORIZON_SECONDS, PlantForecasts
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import CompleteSettings
from mavdem.errors import NotLearnable
from mavdem.extras import require_extra
from mavdem.facts import Fact
from mavdem.facts.model import ModelCaution, ModelName, NoPhysical
from mavdem.immutable import ImmutableResult

if TYPE_CHECKING:
    from mavdem.loops.axis_loops import Loop
    from mavdem.loops.controllers import Controller
    from mavdem.plant import NotIdentifiable, Physical, WindTorque
    from mavdem.report.figures import Plots


USEFUL_VARIANCE_FRACTION = 0.5
"""Squared error of a prediction, relative to the variance of the output, below which it is useful; a choice."""


def _fact_from_document(text: object) -> Fact:
    """Returns the fact for a caution in a document, where only its sentence is recorded."""
    if not isinstance(text, str):
        raise ValueError("must be a sentence")
    return Fact(ModelCaution.RECORDED, text=text)


CautionField = Annotated[
    Fact,
    PlainValidator(_fact_from_document),
    PlainSerializer(lambda fact: fact.sentence_and_remedy),
    WithJsonSchema({"type": "string"}),
]
"""A fact that stands in documents as its sentence."""

SettingsField = Annotated[
    CompleteSettings,
    PlainValidator(CompleteSettings.from_dict),
    PlainSerializer(CompleteSettings.to_dict),
]
"""Settings that stand in documents as an object of plain values."""


class ProcessNoise(NamedTuple):
    """The estimated process noise of a flight: the wind and everything else outside the model."""

    samples: Indices
    """(T′,) indices of the samples, :attr:`Learned.window_center_samples`."""

    noise: Array
    """(T′, n) process noise there, in units of the states per second."""


@dataclass(frozen=True, eq=False, repr=False)
class Learned(ImmutableResult, ForecasterBase):
    """A learned linear model of a vehicle's motion, with its posterior, its free energy and its forecasts.

    All is in physical units, unless it says otherwise.

    The shapes have n states, r inputs (motor outputs), m outputs (angle and rate), T training samples, T′ of them with
    a whole embedding window, and H forecast samples. The names of the fields are keys of the JSON document.

    Attributes:
        settings: Settings of the fit, with nothing left open.
        model: Posterior means of A, B and C, with offset and trims.
        theta_covariance: (k, k) posterior covariance of θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], physical units: by the
            simulation-error fit or, where there was none, by DEM, which counts neighbouring samples as
            independent.
        known: (k,) which parameters the prior fixes: that a rate is the derivative of its angle, that C = [I 0].
        free_energy: Free energy action F̄ by iteration, with its named terms, in nats.
        free_energy_of_samples: (T′,) F(t) of the samples at :attr:`window_center_samples`, in nats: how well each
            sample agrees with DEM's model. Their sum is F̄ of the last iteration.
        learning: Parameters and hyperparameters by iteration.
        converged: Whether the last fit converged; if not, its parameters may still change with more iterations.
        record: The training data, physical.
        cautions: Limits of the model that a user must know.
        scaling: Conversion between physical units and the engine's.
        predictor: The plant with its Kalman filter, in the engine's units.
        state_map: Map from generalized data [ỹ; η̃] to posterior means [x̃; ṽ], in the engine's units.
        theta: Posterior mean of θ in the engine's units.
        simulation_fit: The simulation-error fit of θ, in the engine's units; ``None`` if there was none.
        sample_free_energy: F(t) and its terms as a function of generalized data, in the engine's units; ``None`` in
            models that were written to a file before it was kept.

    Raises:
        ValueError: From every method, for arguments of another shape or not finite, fewer steps than 1, or a level that
            is no probability between 0 and 1.
    """

    settings: SettingsField
    model: LinearModel
    theta_covariance: Array
    known: Flags
    free_energy: FreeEnergy
    free_energy_of_samples: Array
    learning: Learning
    converged: bool
    record: Record
    cautions: tuple[CautionField, ...]
    scaling: Scaling
    predictor: StateSpace
    state_map: Array
    theta: Array
    simulation_fit: SimulationFit | None
    sample_free_energy: SampleFreeEnergy | None = None

    def __repr__(self) -> str:
        n, r = self.model.B.shape
        m = len(self.model.C)
        return (
            f"<Learned: {n} states, {r} inputs, {m} outputs from {len(self.record)} samples at {1 / self.dt:.6g} Hz, "
            f"F̄ {self.free_energy[-1]:,.0f}>"
        )

    @property
    def dt(self) -> float:
        """Sampling step, s."""
        return self.record.dt

    def model_interval(self, level: float = CONFIDENCE_LEVEL) -> LinearModel:
        """Returns the uncertainty of the model's parameters, as half widths of their posterior intervals.

        They follow from the posterior covariance of the simulation-error fit, with its degrees of freedom. The bias of
        closed loop, where the inputs are correlated with the disturbance, is not included.

        Args:
            level: Probability that an interval contains the parameter, between 0 and 1.

        Returns:
            Half widths of the intervals, arranged like A, B and C. NaN for offset and trims, and for all without a
            simulation-error fit.
        """
        n, r = self.model.B.shape
        m = len(self.model.C)
        # Without a simulation-error fit there are no degrees of freedom, and NaN makes all half widths NaN.
        freedom = np.nan
        if self.simulation_fit is not None:
            freedom = self.simulation_fit.degrees_of_freedom
        half_widths = half_width(self.theta_covariance.diagonal(), level, freedom)
        A, B, C = unpack(half_widths, n, r, m)
        return LinearModel(A, B, C, np.full(n, np.nan), np.full(r, np.nan), np.full(m, np.nan))

    @property
    def physical(self) -> Physical | None:
        """Physical parameters of the vehicle (gray-box model, ``mavdem.plant.physical``) from the training data.

        They are fitted at the first access. ``None`` if they cannot be fitted; :attr:`physical_reason` says why.
        """
        from mavdem.plant import Physical

        return self._physical_fit if isinstance(self._physical_fit, Physical) else None

    @property
    def physical_reason(self) -> Fact | None:
        """Why the training data have no :attr:`physical` parameters; ``None`` if they have."""
        from mavdem.plant import NotIdentifiable

        if isinstance(self._physical_fit, NotIdentifiable):
            return self._physical_fit.reason
        return None

    @cached_property
    def _physical_fit(self) -> Physical | NotIdentifiable:
        """The physical parameters, or the reason why there are none."""
        from mavdem.plant import physical

        return physical(self.record)

    @property
    def wind(self) -> WindTorque | None:
        """The same as :attr:`wind_torque`, by its former name."""
        return self.wind_torque

    @cached_property
    def wind_torque(self) -> WindTorque | None:
        """Torque of the wind in the training data, rad/s² (docs/wind.md).

        ``None`` if there are no physical parameters, or no filter can be found for them.
        """
        from mavdem.plant.wind_torque import estimate_wind_torque

        try:
            if self.physical is None:
                return None
            return estimate_wind_torque(self.physical, self.record)
        except ValueError:
            # LinAlgError is a ValueError too.
            return None

    @property
    def resolved_wind_torque(self) -> WindTorque | None:
        """The estimated wind torque, if it is accurate enough to be shown as the torque of the wind.

        ``None`` if there is no estimate, if the effectiveness of the motors is not identifiable, or if the wind torque
        is not larger than its errors.
        """
        from mavdem.plant.wind_torque import resolved_wind_torque

        return resolved_wind_torque(self.wind_torque, self.physical)

    def with_physical(self, physical: Physical | NotIdentifiable) -> Learned:
        """Returns a copy with other physical parameters, such as parameters that were estimated elsewhere.

        The wind torque of the copy will be estimated with them; everything else that has been computed is kept.

        Args:
            physical: The physical parameters, or the reason why there are none.
        """
        # Computed properties are stored in the instance's dictionary. The wind torque of the former parameters is
        # removed from it. The dataclass is frozen, so its field is set by object.__setattr__.
        copied_model = copy(self)
        object.__setattr__(copied_model, "_physical_fit", physical)
        vars(copied_model).pop("wind_torque", None)
        return copied_model

    def with_wind_torque(self, wind_torque: WindTorque | None) -> Learned:
        """Returns a copy with another :attr:`wind_torque`; all else that has been computed is kept."""
        copied_model = copy(self)
        object.__setattr__(copied_model, "wind_torque", wind_torque)
        return copied_model

    @cached_property
    def joint(self) -> JointModel:
        """The joint model of outputs and motors, by which the flight is forecast (``mavdem.dem.forecast.joint``)."""
        return JointModel.learn(self.record)

    @cached_property
    def plant(self) -> PlantForecasts:
        """Forecasts by A, B and C alone."""
        return PlantForecasts(self.record, self.scaling, self.predictor)

    @property
    def _known_input_forecaster(self) -> JointModel | PlantForecasts:
        """The model of all forecasts in which the inputs of the forecast samples are known.

        This is the joint model of outputs and motors. It is the plant A, B, C if ``Settings.forecasts`` is "plant", or
        if the settings do not use the recorded inputs.
        """
        if self.settings.forecasts == "joint" and self.scaling.known:
            return self.joint
        return self.plant

    @property
    def forecast_model(self) -> ModelName:
        """Name of the model that forecasts with known inputs: the joint VAR, or DEM's own A, B and C."""
        return ModelName.JOINT_VAR if self._known_input_forecaster is self.joint else ModelName.DEM

    @may_overflow
    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Forecasts the outputs after the training data, given the inputs, starting again at every ``steps``-th sample.

        Each forecast uses all samples before it and the inputs of its own samples, but none of their outputs. The
        motors cause the motion and, through the controller, respond to it. The joint model therefore treats their
        commands as measurements of the motion as well. With ``Settings(forecasts="plant")`` they are only causes.

        Args:
            steps: Number of samples of each forecast.
            inputs: Inputs after the training data, (H, r).
            outputs: Outputs of the same samples, (H, m); each forecast uses only the outputs before it.
            smooth: Whether the joint model uses for each sample also the inputs after it.

        Returns:
            Forecast outputs and their expected squared errors, (H, m) each.
        """
        return self._known_input_forecaster.rolling_forecast_known_inputs(
            steps, inputs, outputs, smooth
        )

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Predicts the outputs after the training data from the past alone, with a new start at every ``steps``-th one.

        Each prediction uses the inputs and outputs of all samples before it, and none of its own samples. It is always
        made by the joint model, also if ``Settings.forecasts`` is "plant", because the plant A, B, C needs the inputs
        of the samples that it forecasts.

        Args:
            steps: Number of samples of each prediction.
            inputs: Inputs after the training data, (H, r); each prediction uses only the inputs before it.
            outputs: Outputs of the same samples, (H, m); each prediction uses only the outputs before it.

        Returns:
            Predicted outputs and their expected squared errors, (H, m) each.
        """
        return self.joint.rolling_forecast_unknown_inputs(steps, inputs, outputs)

    @may_overflow
    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Returns the outputs of the plant, (H, m), with ``inputs`` (H, r) from state 0."""
        return self.plant.forecast_from_zero_state(inputs)

    def half_widths(self, variance: Array, level: float, steps: int) -> Array:
        """Returns half widths of the band around the forecasts of :meth:`rolling_forecast_known_inputs`.

        The band of the plant A, B, C is that of normally distributed errors. The joint model uses Student's t: its
        variances were estimated from forecasts within the training data, of which fewer are independent, the longer a
        forecast is. So the band of the same variance is wider for samples further ahead.

        Args:
            variance: Expected squared errors of the forecasts, (H, m).
            level: Probability that a sample lies in the band.
            steps: Number of samples of each forecast, as it was given for the forecasts. A new one begins at the rows
                0, ``steps``, 2 ``steps``, …, so that row i is forecast i mod ``steps`` + 1 samples ahead.

        Returns:
            Half widths, (H, m), in the units of the outputs.
        """
        return self._known_input_forecaster.half_widths(variance, level, steps)

    @may_overflow
    def one_step(self) -> Array:
        """Predicts each training sample from those before it; the joint model also uses the inputs of that sample.

        Returns:
            Predicted outputs, (T, m).
        """
        return self._one_step.copy()

    @cached_property
    def _one_step(self) -> Array:
        """The one-step predictions (T, m), of which callers get a copy that they may change."""
        return self._known_input_forecaster.one_step_predictions(self.record)

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of the eigenvalues of the transition to the next sample.

        It is that of the model that forecasts with known inputs (:attr:`forecast_model`).
        """
        return self._known_input_forecaster.process.spectral_radius

    @property
    def stable(self) -> bool:
        """Whether no mode of the model that forecasts with known inputs grows, apart from rounding."""
        return self.spectral_radius <= 1 + ROUNDING_TOLERANCE

    def predict_band(self, steps: int, level: float = CONFIDENCE_LEVEL) -> Array:
        """Returns half widths of the band around :meth:`predict`, from the noise and posterior of the joint model.

        Args:
            steps: Number of predicted samples.
            level: Probability that a sample lies in the band.

        Returns:
            Half widths, (steps, m), in the units of the outputs.
        """
        return self.joint.half_widths(self.predict_with_variance(steps).variance, level, steps)

    @property
    def useful_steps(self) -> Indices:
        """Longest useful horizon of predictions for each output, (m,), in samples, up to 1.5 s.

        A prediction is useful where its expected squared error is below ``USEFUL_VARIANCE_FRACTION`` of the output's
        variance, the squared error of always predicting the mean.
        """
        max_steps = max(1, round(FORECAST_HORIZON_SECONDS / self.dt))
        squared_errors = self.predict_with_variance(max_steps).variance
        # The error of a longer horizon is taken to be at least as large as of each shorter one. If a horizon is useful,
        # all shorter ones then are as well.
        rising_errors = np.maximum.accumulate(squared_errors)
        useful_error = USEFUL_VARIANCE_FRACTION * self.record.outputs.var(axis=0)
        is_useful = rising_errors < useful_error
        # The useful horizons are 1, 2, …, so that their number is the longest one.
        return is_useful.sum(axis=0)

    def forecast_variance(self, inputs: ArrayLike) -> Array:
        """Returns the expected squared errors of :meth:`forecast`, from which its band follows.

        Args:
            inputs: Inputs after the training data, (H, r).

        Returns:
            Expected squared errors, (H, m), in rad² and (rad/s)².
        """
        return self.forecast_with_variance(self.record.validated_inputs(inputs)).variance

    def forecast_band(self, inputs: ArrayLike, level: float = CONFIDENCE_LEVEL) -> Array:
        """Returns half widths of the band around :meth:`forecast`.

        Args:
            inputs: The r inputs of the H samples after the training data, (H, r).
            level: Probability that a sample lies in the band.

        Returns:
            Half widths, (H, m), in the units of the m outputs.
        """
        variance = self.forecast_variance(inputs)
        # All samples belong to a single forecast.
        return self.half_widths(variance, level, steps=len(variance))

    def simulate(self, inputs: ArrayLike) -> Array:
        """Simulates the vehicle's response to given inputs by the :attr:`physical` plant, without an autopilot.

        The simulation begins at the last training sample, and the steady disturbance of the training data is the only
        disturbance. A ``UserWarning`` is issued if the physical parameters are not identifiable.

        >>> learned.simulate(learned.record.inputs[:50]).shape
        (50, 2)

        Args:
            inputs: Commanded inputs, (H, r), in the unit of the training inputs.

        Returns:
            Simulated outputs, (H, m).

        Raises:
            ValueError: No physical parameters can be fitted, or the outputs are not an angle and its rate.
        """
        from mavdem.plant.simulation import simulate_response

        physical = self.require_physical()
        if physical.caution is not None:
            unreliable = Fact(NoPhysical.SIMULATION_FAR_OFF, reason=physical.caution)
            warn(unreliable.sentence_and_remedy, stacklevel=2)
        return simulate_response(physical, self.record, inputs).mean

    def simulate_band(self, inputs: ArrayLike, level: float = CONFIDENCE_LEVEL) -> Array:
        """Returns half widths of the band around :meth:`simulate`.

        The band includes the uncertainty of the physical parameters and the effect of the wind, which no controller
        counteracts in the simulation.

        Args:
            inputs: Commanded inputs, (H, r), in the unit of the training inputs.
            level: Probability that a sample lies in the band.

        Returns:
            Half widths, (H, m), in the units of the outputs.

        Raises:
            ValueError: The physical parameters are not identifiable.
        """
        from mavdem.plant.simulation import simulate_response

        physical = self.require_physical()
        if physical.caution is not None:
            raise NotLearnable(NoPhysical.NO_SIMULATION_BAND, reason=physical.caution)
        return half_width(simulate_response(physical, self.record, inputs).variance, level)

    def require_physical(self) -> Physical:
        """Returns :attr:`physical`; raises ``NotLearnable``, with the reason, if there are no such parameters."""
        from mavdem.plant import NotIdentifiable

        if isinstance(self._physical_fit, NotIdentifiable):
            raise NotLearnable(self._physical_fit.reason)
        return self._physical_fit

    @property
    def window_center_samples(self) -> Indices:
        """Indices (T′,) of the training samples whose whole embedding window lies in their segment.

        The generalized data and ``free_energy_of_samples`` are values at these samples.
        """
        window_length = self.settings.window
        centers = []
        for start, length in zip(self.record.segment_starts, self.record.lengths, strict=True):
            # A window begins at each sample of the segment after which enough samples follow.
            window_count = max(0, length - window_length + 1)
            first_center = start + window_length // 2
            centers.append(first_center + np.arange(window_count))
        return np.concatenate(centers)

    def free_energy_terms_of_samples(self) -> dict[str, Array]:
        """Returns the terms of the free energy of each training sample, such as its squared prediction error.

        The sum of the terms is :attr:`free_energy_of_samples`. Priors and entropies of the parameters θ and of the
        noise precisions λ belong to the model as a whole; these terms are shared evenly between the samples.

        Returns:
            (T′,) values of each term by its name, nats, at the samples :attr:`window_center_samples`. Summed over the
            samples they are the terms of the free energy action in the last iteration of :attr:`free_energy`. The
            mean-field term is 0, as it is wherever the covariances are optimal. Empty for a model without
            :attr:`sample_free_energy`.
        """
        if self.sample_free_energy is None:
            return {}
        data = np.concatenate(generalized_data(self.settings, self.scaling, self.record))
        terms_of_samples = self.sample_free_energy.terms(data)
        return dict(zip(Term, terms_of_samples.T, strict=True))

    def process_noise(self) -> ProcessNoise:
        """Estimates the process noise w = x′ − A x − B v: the wind and everything else outside the model.

        The states x, their rates x′ and the inputs v are DEM's posterior means at each sample.

        Returns:
            The noise (T′, n) in the units of the states' rates, at the samples :attr:`window_center_samples`.
        """
        n, r = self.model.B.shape
        A, B, _ = unpack(self.theta, n, r + self.scaling.constant, len(self.model.C))
        # The posterior means are [x; x′; …; v; v′; …], and w is a linear function of them.
        noise_map = np.zeros((n, len(self.state_map)))
        if self.settings.p > 0:
            noise_map = np.eye(n, len(self.state_map), k=n)
        # The inputs follow the p + 1 derivatives of the n states.
        first_input = n * (self.settings.p + 1)
        noise_map[:, :n] -= A
        noise_map[:, first_input : first_input + B.shape[1]] -= B
        data = np.concatenate(generalized_data(self.settings, self.scaling, self.record))
        noise = data @ self.state_map.T @ noise_map.T * self.scaling.state_scale(n)
        return ProcessNoise(self.window_center_samples, noise)

    @property
    def plot(self) -> Plots:
        """Figures of the model: ``plot.bode()`` and others return a ``matplotlib`` figure (``report.figures.Plots``).

        Raises:
            ImportError: The package ``matplotlib`` is not installed.
        """
        require_extra("plot", "Learned.plot")
        from mavdem.report.figures import Plots

        return Plots(self)

    def summary(self) -> str:
        """Returns a report that fits on one screen, on how the vehicle moves in wind.

        It does not contain the errors on windows that the model was not learned from, which
        ``mavdem.evaluate.held_out_windows`` computes.
        """
        from mavdem.report.screen import summary

        return summary(self)

    def to_control(self, model: str = "physical") -> Any:
        """Converts the model to a ``control.StateSpace`` of deviations from the trim, with names of inputs and outputs.

        Its ``name`` says which model it is. The physical plant also has the attributes ``delay``, in s, and ``draws``,
        plants that were drawn from the posterior.

        Args:
            model: ``"physical"`` for the physical plant with its delay, ``"dem"`` for DEM's A, B and C.

        Returns:
            The model, a ``control.StateSpace``.

        Raises:
            ImportError: The package ``control`` is not installed.
            ValueError: There is no physical plant; the message says why.
        """
        require_extra("control", "Learned.to_control()")
        from mavdem.export.control_systems import to_control

        return to_control(self, model)

    def loop(self, controller: Controller | None = None) -> Loop:
        """Returns the rate and attitude loop of the axis: the physical plant with a controller.

        >>> loop = learned.loop()
        >>> loop.phase_margin, loop.phase_margin_interval, loop.gain_margin, loop.crossover  # degrees, dB, Hz

        Args:
            controller: The controller; None for the controller with the parameters in the log.

        Returns:
            The loop, with its margins and their intervals.

        Raises:
            NotLearnable: The plant is not identifiable, or the controller is not known.
        """
        from mavdem.loops.loop_construction import loop_from_learned

        return loop_from_learned(self, controller)

    def _repr_html_(self) -> str:
        """Returns the HTML that a notebook shows."""
        from mavdem.report.pages.page import learned_html

        return learned_html(self)

    def to_json(self) -> str:
        """Returns everything as a JSON document, the training data included; :meth:`from_json` is the inverse."""
        return to_text(self)

    @classmethod
    def from_json(cls, text: str) -> Learned:
        """Creates a result from the text of a JSON document that :meth:`to_json` returned.

        Args:
            text: Text of the document, not the name of a file.

        Returns:
            The result.

        Raises:
            Unreadable: The text is no such document; the message says what is wrong in it.
        """
        return from_text(cls, text)
