"""Learned: what DEM made of a flight, in physical units."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from mavdem.dem.believed import believed, expected_error, sizes
from mavdem.dem.choice import Candidate
from mavdem.dem.colour import Colour
from mavdem.dem.determined import Direction, undetermined, without
from mavdem.dem.document import fields_of, values_of
from mavdem.dem.fit import Fit, generalized, held_by_prior, of_vehicle
from mavdem.dem.json_text import json_values
from mavdem.dem.level import require_probability
from mavdem.dem.model import HELD, LinearModel, unpack
from mavdem.dem.physical import Physical, physical
from mavdem.dem.positive import inverse
from mavdem.dem.prediction import Predictor
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.scatter import Certainty, Scatter
from mavdem.dem.settings import Settings
from mavdem.dem.trace import FreeEnergy, Learning
from mavdem.dem.trajectory import Trajectory
from mavdem.dem.trials import Unseen

Array = NDArray[np.float64]

beyond_numbers = np.errstate(over="ignore", invalid="ignore")
"""Around what an unstable model, or inputs without measure, may lead beyond all numbers: infinite or NaN, unwarned."""


@dataclass(frozen=True, eq=False, repr=False)
class Learned:
    """A learnt model with its posterior, its climb and its forecasts, in physical units.

    Attributes:
        settings: as used, with nothing left open.
        model: posterior means.
        theta_covariance: (k, k) posterior covariance of θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)], physical units: along
            trajectories, or in generalized coordinates where θ stayed there.
        scatter: of the estimate of θ, physical units: how far it would fall from here on other data of this kind. It
            does not count neighbouring samples as independent, as the posterior does; see ``model_interval``. ``None``
            where F̄ has no maximum.
        undetermined: combinations of parameters of which the data tell less than the prior.
        prior_sd: (k,) prior standard deviations of θ in generalized coordinates; along trajectories they are wider.
        known: (k,) which parameters the prior holds to what is known beforehand: that a rate is the derivative of its
            angle, that C = [I 0]. The others are left to the data.
        free_energy: by iteration, with its named terms.
        free_energy_of_samples: (T′,) F(t) of the samples at ``places``: how well each agrees with the model.
        learning: parameters and hyperparameters by iteration.
        settled: whether F̄ had stopped rising; where not, a caution says how the climb ended.
        candidates: every choice that was tried.
        dt: sampling step, s.
        smoothness: kernel width s of the noise, s.
        colour: how it was found and how flat F̄ᵒ is about it, where the settings left it to be learnt.
        record: the training data, physical.
        unseen: what forecasts of each half of the training data by a model of the other half tell.
        cautions: one sentence for each thing a user must know before trusting the model.
        trajectory: how θ climbed on along trajectories, in the engine's units; ``None`` where it did not.
        scaling, predictor, state_map, theta: the engine's own, in its units: what :meth:`one_step`, :meth:`forecast`
            and :meth:`process_noise` compute with.
    """

    settings: Settings
    model: LinearModel
    theta_covariance: Array
    scatter: Scatter | None
    undetermined: tuple[Direction, ...]
    prior_sd: Array
    known: NDArray[np.bool_]
    free_energy: FreeEnergy
    free_energy_of_samples: Array
    learning: Learning
    settled: bool
    candidates: tuple[Candidate, ...]
    dt: float
    smoothness: float
    colour: Colour | None
    record: Record
    unseen: Unseen
    cautions: tuple[str, ...]
    scaling: Scaling
    predictor: Predictor
    state_map: Array
    theta: Array
    trajectory: Trajectory | None

    @classmethod
    def of(
        cls,
        fit: Fit,
        record: Record,
        certainty: Certainty,
        free_energy_of_samples: Array,
        unseen: Unseen,
        candidates: tuple[Candidate, ...],
        colour: Colour | None,
        cautions: tuple[str, ...],
    ) -> Learned:
        """The result of a fit to the training data it was made from.

        Args:
            fit: the settled (or given up) fit, in the engine's units.
            record: the training data it was made from, in physical units.
            certainty: of the fit's θ, in the engine's units.
            free_energy_of_samples: F(t) of its generalized samples.
            unseen: forecasts of data that the fit has not seen.
            candidates, colour, cautions: as in :class:`Learned`, found outside the fit.
        """
        order, ascent, scaling = fit.model.n, fit.ascent, fit.scaling
        scale = scaling.parameter_scale(order)
        motors = of_vehicle(order, record.inputs.shape[1], fit.model.m, scaling.constant)
        of_motors = np.ix_(motors, motors)
        precision = fit.model.prior.theta_precision
        prior_covariance = inverse(precision) * np.outer(scale, scale)
        covariance, scatter = ascent.belief.theta_covariance, certainty.scatter
        if fit.trajectory is not None:
            covariance = fit.trajectory.theta_covariance(inverse(precision))
            scatter = Scatter(covariance, fit.trajectory.freedom)
        covariance = covariance * np.outer(scale, scale)
        held = held_by_prior(np.diag(precision)[motors], scale[motors], fit.settings, record)
        information = without(certainty.information, precision, motors)
        return cls(
            settings=fit.settings,
            model=scaling.physical_model(ascent.belief.theta, order),
            theta_covariance=covariance[of_motors],
            scatter=scatter and scatter._replace(covariance=(scatter.covariance * np.outer(scale, scale))[of_motors]),
            undetermined=undetermined(
                information, precision[of_motors], ~held, (order, record.inputs.shape[1], fit.model.m)
            ),
            prior_sd=np.sqrt(np.diag(prior_covariance))[motors],
            known=held,
            free_energy=FreeEnergy(dict(ascent.terms)),
            free_energy_of_samples=free_energy_of_samples,
            learning=Learning(
                (ascent.theta * scale)[:, motors],
                (ascent.theta_sd * scale)[:, motors],
                ascent.lambda_,
                ascent.lambda_sd,
            ),
            settled=fit.settled,
            candidates=candidates,
            dt=record.dt,
            smoothness=fit.smoothness,
            colour=colour,
            record=record,
            unseen=unseen,
            cautions=cautions,
            scaling=scaling,
            predictor=fit.predictor,
            state_map=ascent.state_map,
            theta=ascent.belief.theta,
            trajectory=fit.trajectory,
        )

    def __repr__(self) -> str:
        (n, r), m, told = self.model.B.shape, len(self.model.C), len(self.cautions)
        return (
            f"<Learned: {n} states, {r} inputs, {m} outputs from {len(self.record)} samples at {1 / self.dt:.6g} Hz, "
            f"F̄ {self.free_energy[-1]:,.0f}{'' if self.settled else ' (not settled)'}, "
            f"{told} caution{'' if told == 1 else 's'}>"
        )

    @property
    def model_sd(self) -> LinearModel:
        """DEM's posterior standard deviations in the places of A, B and C; the offset's and trims' are NaN.

        They count neighbouring samples as independent and so are too small; see :meth:`model_interval`.
        """
        return self._in_places(np.sqrt(np.diag(self.theta_covariance)))

    def _in_places(self, values: Array) -> LinearModel:
        (n, r), m = self.model.B.shape, len(self.model.C)
        return LinearModel(*unpack(values, n, r, m), np.full(n, np.nan), np.full(r, np.nan), np.full(m, np.nan))

    def model_interval(self, level: float = 0.9) -> LinearModel:
        """Half widths, in the places of A, B and C, of intervals about the estimates; the offset's and trims' are NaN.

        An interval holds its parameter with probability ``level`` as far as the estimate's :attr:`scatter` tells: that
        the motors answer the very disturbance which is called noise biases the estimate, and is not in it.

        Args:
            level: probability, between 0 and 1.

        Returns:
            NaN throughout where :attr:`scatter` is not known.

        Raises:
            ValueError: a level that is no probability between 0 and 1.
        """
        require_probability(level)
        if self.scatter is None:
            return self._in_places(np.full(len(self.theta_covariance), np.nan))
        return self._in_places(self.scatter.half_width(level))

    @cached_property
    def physical(self) -> Physical | None:
        """What motors, damping and lag are, read off the training data by themselves; ``None`` where they tell nothing.

        See :func:`mavdem.dem.physical`.
        """
        try:
            return physical(self.record)
        except ValueError:
            return None

    @beyond_numbers
    def one_step(self) -> Array:
        """(T, m): each training sample predicted from those before it and the inputs; a segment's first is the trim."""
        predictions = []
        for inputs, outputs in self.scaling.scale_segments(self.record):
            ahead = self.predictor.one_step(outputs, inputs)
            predictions += [self.scaling.output_trim[None], self.scaling.physical_outputs(ahead)]
        return np.concatenate(predictions)

    @property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of the model's step from sample to sample, exp(A dt)."""
        return float(np.exp(self.model.spectral_abscissa * self.dt))

    @property
    def stable(self) -> bool:
        """Whether no mode of the model grows, but for rounding."""
        return self.spectral_radius <= 1 + HELD

    @beyond_numbers
    def forecast(self, inputs: ArrayLike, from_zero: bool = False) -> Array:
        """Outputs after the training data: row 0 is the first sample after it.

        The model runs on from the state at the end of training. With ``shrink_forecasts`` each sample's deviation from
        the trim is believed as far as the posterior of θ is sure of it (``mavdem.dem.believed``): what inputs beyond
        those learnt from ask of uncertain parameters is not, and the less the farther it leads. Where θ climbed along
        no trajectories, it has the weight that forecasts of unseen training data earned one so long.

        Args:
            inputs: (H, r) motor outputs over the forecast, in the unit of the training inputs.
            from_zero: begin with state 0 at row 0 (the outputs at their trim), as the paper's figures do.

        Returns:
            (H, m).

        Raises:
            ValueError: inputs of another width, or not finite.
        """
        ahead = self.record.following_inputs(inputs)
        deviation = self._deviation(ahead, from_zero)
        return self.scaling.physical_outputs(self._believed(deviation, *self._with(ahead)))

    @beyond_numbers
    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """The samples after the training data, by a new forecast from every ``steps``-th of them on.

        Each is as :meth:`forecast`'s, from the state that the filter has of all samples before it; nothing is learnt
        anew.

        Args:
            steps: samples that each forecast is of, at least 1.
            inputs, outputs: (H, r) and (H, m) of the samples, in the units of the training data.

        Returns:
            (H, m); with ``steps`` of H or more what :meth:`forecast` answers.

        Raises:
            ValueError: fewer steps than 1, or inputs and outputs of other shapes, or not finite.
        """
        following = self.record.following(steps, inputs, outputs)
        before = self.record.segments[-1]
        known, measured = (np.vstack(tables) for tables in zip(before, following, strict=True))
        scaled = self.scaling.scale_outputs(measured), self.scaling.scale_inputs(known)
        deviation = self.predictor.forecast_every(steps, *scaled, first=len(before[0]))
        return self.scaling.physical_outputs(self._believed(deviation, steps, *scaled, first=len(before[0])))

    @beyond_numbers
    def forecast_variance(self, inputs: ArrayLike) -> Array:
        """(H, m) squared error that the forecast expects of itself at each sample, rad² and (rad/s)².

        Args:
            inputs: (H, r) as for :meth:`forecast`.

        Raises:
            ValueError: as :meth:`forecast`.
        """
        ahead = self.record.following_inputs(inputs)
        if self.trajectory is None:
            return self._by_horizon(self.unseen.weighted_mse, len(ahead))
        forecast = self._with(ahead)
        spread = self._spread(*forecast)
        if self.settings.shrink_forecasts:
            spread = expected_error(self._deviation(ahead), spread, self._sizes(*forecast))
        return (spread + self._by_horizon(self.trajectory.noise, len(ahead))) * self.scaling.output_scale**2

    def _deviation(self, ahead: Array, from_zero: bool = False) -> Array:
        """(H, m) from the trim, as the model has it with inputs (H, r), in the engine's units."""
        known = self.scaling.scale_inputs(np.vstack([self.record.inputs[-1], ahead]))
        if not from_zero:
            return self.predictor.forecast(self._last_state, known)
        later = self.predictor.forecast(self.predictor.at_rest(known[min(1, len(ahead))]), known[1:])
        return np.vstack([np.zeros((1, len(self.model.C))), later])[: len(ahead)]

    def _with(self, ahead: Array) -> tuple[int, Array, Array, int]:
        """One forecast with inputs (H, r), in the engine's units: its length, outputs, inputs and where it begins."""
        inputs, outputs = self._last_segment
        return len(ahead), outputs, np.vstack([inputs, self.scaling.scale_inputs(ahead)]), len(outputs)

    def _believed(self, deviation: Array, steps: int, outputs: Array, inputs: Array, first: int) -> Array:
        """What is believed of the deviations (T − first, m) that forecasts from every ``steps``-th sample on tell.

        Args:
            deviation: from the trim, in the engine's units.
            steps: that each forecast is long.
            outputs, inputs: (T, m), (T, r) in the engine's units; of the outputs those before each forecast are read.
            first: where the first begins.
        """
        if self.trajectory is None:
            weight = self._by_horizon(self.unseen.weight, len(deviation))
            return np.asarray(deviation * weight[np.arange(len(deviation)) % steps])
        if not self.settings.shrink_forecasts:
            return deviation
        spread = self._spread(steps, outputs, inputs, first)
        return believed(deviation, spread, self._sizes(steps, outputs, inputs, first))

    def _sizes(self, steps: int, outputs: Array, inputs: Array, first: int) -> Array:
        """S of such forecasts, (T − first, 1)."""
        return sizes(inputs[first:, : len(self.model.input_trim)], steps)

    def _spread(self, steps: int, outputs: Array, inputs: Array, first: int) -> Array:
        """(T − first, m) variance that θ's posterior gives such forecasts, in the engine's units."""
        assert self.trajectory is not None
        (n, _), (T, r) = self.model.B.shape, inputs.shape
        if first == T:
            return np.empty((0, outputs.shape[1]))
        before = self.trajectory.horizon + 1
        rows = np.arange(first, T, steps) + np.arange(-before, min(steps, T - first))[:, None]
        variance = self.trajectory.spread(
            (n, r, outputs.shape[1]),
            self.dt,
            inputs[np.clip(rows, 0, T - 1)],
            outputs[np.clip(rows[:before], 0, T - 1)],
        )
        return variance.reshape(-1, outputs.shape[1])[: T - first]

    @beyond_numbers
    def forecast_band(self, inputs: ArrayLike, level: float = 0.9) -> tuple[Array, Array]:
        """The interval in which each sample of the forecast lies with probability ``level``.

        Its width is what forecasts of that length erred inside the training data, as far as θ's own uncertainty, which
        the inputs scale, is not the cause, and that uncertainty; or, where θ climbed along no trajectories, what
        forecasts of unseen training data erred. Beyond the longest such forecast it stays as wide as that.

        Args:
            inputs: (H, r) as for :meth:`forecast`.
            level: probability, between 0 and 1.

        Returns:
            lower and upper bounds, (H, m) each.

        Raises:
            ValueError: as :meth:`forecast`.
        """
        require_probability(level)
        centre = self.forecast(inputs)
        if self.trajectory is None:
            half = norm.ppf(0.5 + level / 2) * np.sqrt(self._by_horizon(self.unseen.weighted_mse, len(centre)))
        else:
            half = self.trajectory.quantile(level) * np.sqrt(self.forecast_variance(inputs))
        return centre - half, centre + half

    @staticmethod
    def _by_horizon(values: Array, length: int) -> Array:
        """The first ``length`` rows; beyond the longest horizon that was tried, its row again."""
        return np.asarray(values[np.minimum(np.arange(length), len(values) - 1)])

    @cached_property
    def _last_state(self) -> Array:
        inputs, outputs = self._last_segment
        return np.asarray(self.predictor.filtered(outputs, inputs)[-1])

    @property
    def _last_segment(self) -> tuple[Array, Array]:
        """Inputs and outputs of the last segment of the training data, in the engine's units."""
        inputs, outputs = self.record.segments[-1]
        return self.scaling.scale_inputs(inputs), self.scaling.scale_outputs(outputs)

    @property
    def places(self) -> NDArray[np.intp]:
        """(T′,) the training samples that have a whole window in their segment."""
        window = self.settings.window
        assert window is not None
        return np.concatenate(
            [
                start + window // 2 + np.arange(max(0, length - window + 1))
                for start, length in zip(self.record.starts, self.record.lengths, strict=True)
            ]
        )

    def process_noise(self) -> tuple[NDArray[np.intp], Array]:
        """The estimated process noise w = x′ − A x − B v: wind and all else the model leaves out.

        Returns:
            places (T′,) of the training samples that have a whole window, and w (T′, n) there, in units of the
            states per second (for the roll rate, rad/s²).
        """
        n, m, r = self.model.A.shape[0], self.model.C.shape[0], self.model.B.shape[1] + self.scaling.constant
        X, p = self._generalized_states, self.settings.p
        A, B, _ = unpack(self.theta, n, r, m)
        slope = X[:, n : 2 * n] if p else np.zeros((len(X), n))
        noise = slope - X[:, :n] @ A.T - X[:, n * (p + 1) :][:, :r] @ B.T
        return self.places, noise * self.scaling.state_scale(n)

    def estimated_inputs(self) -> tuple[NDArray[np.intp], Array]:
        """The inputs as the model has them: those recorded, or, with unknown inputs, what explains the motion.

        Returns:
            places (T′,) of the training samples that have a whole window, and v (T′, r) there; of unknown inputs in the
            engine's units.
        """
        r, order = self.model.B.shape[1], self.settings.p + 1
        v = self._generalized_states[:, self.model.A.shape[0] * order :][:, :r]
        return self.places, self.scaling.physical_inputs(v)

    @cached_property
    def _generalized_states(self) -> Array:
        """X of every sample with a whole window, (T′, dim X), in the engine's units."""
        return np.concatenate(generalized(self.settings, self.scaling, self.record)) @ self.state_map.T

    def to_json(self) -> str:
        """Everything as a JSON object, the training data included; :meth:`from_json` reads it back."""
        return json.dumps(values_of(self))

    @classmethod
    def from_json(cls, text: str) -> Learned:
        """The result that :meth:`to_json` wrote.

        Args:
            text: the JSON document itself, not the name of a file.

        Raises:
            ValueError: it is not such a document; what is missing or of another shape is named.
        """
        return cls(**fields_of(json_values(text, "a learnt model")))
