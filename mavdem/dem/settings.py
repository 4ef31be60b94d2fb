"""Settings of a fit: model order, embedding, noise, priors, iterations and forecasts, with checks and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from math import e
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from mavdem.arrays import Array, as_real_array
from mavdem.containers import JsonValues, Numbers
from mavdem.dem.engine.linalg import require_positive_definite
from mavdem.dem.validation import MAX_ABS_VALUE, checked_values
from mavdem.facts.fact import plain

FORMER_SETTINGS = {"learning_rates"}
"""Settings of earlier versions that documents may still contain; their value was ``None`` there, and is ignored."""

MAX_LOG_PRECISION = 100.0
"""Largest size of a log precision: exp(±100) is beyond anything measured, and far from overflow."""

MAX_INTEGER = 2**63 - 1
"""Largest integer of a setting: the largest of 64 bits."""

MAX_ORDER = 12
"""Most states of a model: a fit takes memory of the order of n⁴, and no flight shows as many states."""

MIN_POSITIVE_VALUE = 1e-50
"""Smallest positive number of a setting; the squares of smaller ones could vanish."""

NonNegativeInteger = Annotated[int, Field(ge=0, le=MAX_INTEGER)]
"""An integer of at least 0."""

PositiveInteger = Annotated[int, Field(ge=1, le=MAX_INTEGER)]
"""An integer of at least 1."""

PositiveNumber = Annotated[float, Field(ge=MIN_POSITIVE_VALUE, le=MAX_ABS_VALUE)]
"""A positive number whose square neither overflows nor vanishes."""

LogPrecision = Annotated[float, Field(ge=-MAX_LOG_PRECISION, le=MAX_LOG_PRECISION)]
"""Natural logarithm of a precision."""


class MeanAndPrecision(NamedTuple):
    """A Gaussian distribution of k numbers."""

    mean: Array
    """(k,) mean."""

    precision: Array
    """(k, k) precision, the inverse of the covariance."""


@dataclass(frozen=True)
class Gaussian:
    """A multivariate normal distribution N(mean, precision⁻¹), as a prior of parameters.

    A known parameter is one of high precision; the structure of a model is a matrix of them.

    Attributes:
        mean: k means.
        precision: Rows of the precision matrix, (k, k), which is positive definite.
    """

    mean: Numbers
    precision: tuple[Numbers, ...]

    def __init__(self, mean: ArrayLike, precision: ArrayLike) -> None:
        """Takes mean and precision.

        Args:
            mean: Means, (k,).
            precision: Precision matrix, (k, k); its diagonal, (k,), if it has no other entries; or one number for
                all of the diagonal.

        Raises:
            ValueError: An argument has another shape or is not finite, or the matrix is not positive definite.
        """
        means = as_real_array(mean, "mean")
        precisions = as_real_array(precision, "precision")
        if means.ndim != 1 or not len(means) or not np.isfinite(means).all():
            raise ValueError(
                f"mean must be finite numbers of shape (k,), not of shape {means.shape}"
            )
        # One number, or a diagonal, becomes the whole matrix.
        if precisions.ndim == 0:
            precisions = np.full(len(means), precisions)
        if precisions.ndim == 1 and len(precisions) == len(means):
            precisions = np.diag(precisions)
        require_positive_definite(precisions, "precision", len(means))
        # Tuples of floats, in place of arrays, make the distribution hashable and comparable. The dataclass is frozen,
        # so that its fields can only be set in this way.
        object.__setattr__(self, "mean", tuple(means.tolist()))
        object.__setattr__(self, "precision", tuple(map(tuple, precisions.tolist())))

    @property
    def arrays(self) -> MeanAndPrecision:
        """Mean and precision as arrays."""
        return MeanAndPrecision(np.array(self.mean), np.array(self.precision))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Gaussian:
        """Returns the distribution that a JSON object describes.

        Args:
            values: The object ``{"mean": …, "precision": …}``.

        Raises:
            ValueError: The object has other keys, or its values are not a mean and a precision.
        """
        if not isinstance(values, Mapping) or set(values) != {"mean", "precision"}:
            raise ValueError(
                f'a Gaussian must be {{"mean": [...], "precision": ...}}, not {values!r}'
            )
        return cls(values["mean"], values["precision"])


@dataclass(frozen=True, eq=False)
class Settings:
    """Everything that decides a fit. ``Settings()`` is for real flights, :meth:`paper` for the paper's experiments.

    Settings are equal where all their values are, whether they are complete (:class:`CompleteSettings`) or not. The
    names of the fields are keys of the JSON document of a model.

    >>> settings = mavdem.Settings(order=4, horizon=None)
    >>> mavdem.Settings.from_json(settings.to_json()) == settings
    True

    **The model**

    Attributes:
        order: Number of states n, at most 12; states beyond the outputs are hidden. ``None``: one more than outputs.
        p: Embedding order of outputs and states: the highest derivative in their generalized coordinates.
        d: Embedding order of the inputs; ``None``: 2, or p if that is less.
        window: Samples that each generalized vector is computed from, more than p and d. ``None``: 0.09 s of them, or
            as few as possible where segments are too short.
        scaling: "channel": every output and the inputs are centred and scaled to unit variance, and a constant input
            learns the trim. "paper": outputs as they are, one mean and one range for all inputs. "none": both as they
            are.
        known_inputs: Whether the recorded inputs are the prior mean η̃ᵛ of the inputs. If not, it is 0, and B belongs
            to unrecorded inputs.

    **The noise**

    Attributes:
        smoothness: Width s of the noise's Gaussian autocorrelation kernel, seconds; ``None``: one sampling step.
        correlation: Treatment of the highest derivative of the process noise. "sampled": it is left out, since samples
            do not show it. "continuous": the state's next derivative is assumed to be zero, and the resulting noise is
            counted as evidence, as the paper's D does.

    **Priors**, in the units of ``scaling``

    Attributes:
        prior: "regulated": each output returns to its trim, rates are derivatives of angles, hidden states are
            actuator lags, C = [I 0]. "uniform": a mean drawn from U[−1, 1] for every parameter. Or a ``Gaussian`` of
            θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] in physical units, in which a known parameter is one of high precision.
        parameter_precision: Prior precision P of each free parameter; under a ``Gaussian`` prior, only of the trim.
            ``None``: 10 under the "regulated" prior, 1 under others.
        lambda_z, lambda_w: Prior means of the log precisions of measurement and process noise, one for all outputs and
            one for all states, as in the paper.
        lambda_log_precision: Log precisions of these two priors: e²⁵ fixes λᶻ, e^−4.6 leaves λʷ to the data.
        input_precision: Precision of every input about η̃ᵛ, and of each of its derivatives: P̃ᵛ is diagonal. With 1.6e5
            an input is known to 0.25 % of a unit.

    **Inference**

    Attributes:
        iterations: Most rounds of D, E and M steps; there are fewer when the free energy action F̄ has converged.
        seed: Seed of the random numbers that the "uniform" prior draws.

    **Forecasts**

    Attributes:
        horizon: Length, s, of the segments of the simulation-error fit that refines θ after DEM, where inputs are known
            and the prior is not "uniform" (``mavdem.dem.forecast.simulation_error``); it is shorter if the training
            data are too short. ``None``: no such fit.
        forecasts: "joint": by the joint model of outputs and motors, in which the motors measure the motion
            (``mavdem.dem.forecast.joint``). "plant": by A, B and C alone, with the motors as causes, as in the paper.

    Raises:
        ValueError: A setting has a wrong type or value, or two contradict each other; the message names it.
    """

    order: Annotated[int, Field(ge=1, le=MAX_ORDER)] | None = None
    p: NonNegativeInteger = 2
    d: NonNegativeInteger | None = None
    window: PositiveInteger | None = None
    scaling: Literal["channel", "paper", "none"] = "channel"
    known_inputs: bool = True

    smoothness: PositiveNumber | None = None
    correlation: Literal["sampled", "continuous"] = "sampled"

    prior: Literal["regulated", "uniform"] | Gaussian = "regulated"
    parameter_precision: PositiveNumber | None = None
    lambda_z: LogPrecision = 20.0
    lambda_w: LogPrecision = 3.0
    lambda_log_precision: tuple[LogPrecision, LogPrecision] = (25.0, -4.6)
    input_precision: PositiveNumber = 1.6e5

    iterations: PositiveInteger = 200
    seed: NonNegativeInteger = 0

    horizon: PositiveNumber | None = 0.3
    forecasts: Literal["joint", "plant"] = "joint"

    def __post_init__(self) -> None:
        """Checks each field by its annotation, and the settings as a whole.

        Raises:
            ValueError: A value does not fit, or two settings contradict each other; the message names the setting.
        """
        # Numbers of numpy become Python's own, which the annotations ask for.
        values = {name: plain(value) for name, value in vars(self).items()}
        # The values are set again as pydantic returns them, such as tuples for lists; the dataclass is frozen.
        for name, value in checked_values(type(self), values).items():
            object.__setattr__(self, name, value)
        self._require_consistent()

    def _require_consistent(self) -> None:
        """Checks that the settings do not contradict each other.

        The embedding orders p and d are the highest derivatives of the states and of the inputs. The equation of motion
        ẋ = A x + B v is differentiated as often. Whether its highest derivative is part of the model is set by
        ``correlation`` (:attr:`models_highest_derivative`).

        Raises:
            ValueError: A setting contradicts another; the message names it.
        """
        # A derivative of order k is computed from at least k + 1 samples. An open d is chosen later, and fits.
        highest_derivative = max(self.p, self.d or 0)
        min_window = highest_derivative + 1
        if self.window is not None and self.window < min_window:
            raise self._value_error("window", f"at least {min_window} for p and d")
        if not self.models_highest_derivative:
            # The uniform prior leaves C free. Without the highest derivative, nothing then determines the scale of the
            # states x: the larger they are, the smaller C, and the free energy F̄ is largest at C = 0.
            if self.prior == "uniform":
                raise self._value_error(
                    "correlation", '"continuous" with the uniform prior, which leaves C free'
                )
            # With p = 0 the only equation of motion is the one that is left out.
            if self.p == 0:
                raise self._value_error("correlation", '"continuous" with p = 0')
        # The mean of B is 0 under this prior, and only recorded inputs can change it.
        if self.prior == "regulated" and not self.known_inputs:
            raise self._value_error(
                "known_inputs", "True with the regulated prior, under which B would stay 0"
            )

    def _value_error(self, name: str, expected: str) -> ValueError:
        """Returns the error that the setting of this ``name`` does not have the ``expected`` value."""
        return ValueError(f"{name} must be {expected}, not {getattr(self, name)!r}")

    @property
    def models_highest_derivative(self) -> bool:
        """Whether the equation of motion of the states' highest derivative is part of the model.

        It contains a derivative above the highest one, which is then assumed to be 0. Otherwise the equation is left
        out, and with it the highest derivative of the process noise (setting ``correlation``).
        """
        return self.correlation == "continuous"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Settings) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash(tuple(vars(self).values()))

    @classmethod
    def paper(cls, order: int = 2, seed: int = 0) -> Self:
        """Returns the settings of the paper's experiments, section V.D (``alg_settings``).

        The paper and its authors' code leave some choices open, which are made as follows:

        - Outputs are not centred.
        - The D step, which estimates the states, uses the exact limit of an infinite step (k → ∞).
        - The last row of the derivative operator D is zero, and its errors are included in the free energy F̄.
        - F̄ and its mean-field terms are exact.
        - The first step already uses the prior of the log noise precisions λ.
        - Inputs are embedded over the window of the outputs, so that both are values at the same time.

        Args:
            order: Number of states n.
            seed: Seed of the random prior means of the parameters.
        """
        return cls(
            order=order,
            # The embedding orders of outputs and inputs, and the samples from which derivatives are computed.
            p=2,
            d=1,
            window=3,
            scaling="paper",
            correlation="continuous",
            prior="uniform",
            parameter_precision=e**4,
            lambda_log_precision=(25.0, 20.0),
            input_precision=e**16,
            iterations=20,
            seed=seed,
            horizon=None,
            forecasts="plant",
        )

    def to_dict(self) -> JsonValues:
        """Returns the settings as JSON values by name; :meth:`from_dict` is the inverse."""
        return asdict(self)

    def to_json(self) -> str:
        """Returns the settings as the text of a JSON object; :meth:`from_json` is the inverse."""
        return json.dumps(self.to_dict(), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Reads settings from the text of a JSON object; those that are left out have their defaults.

        Args:
            text: The text, as :meth:`to_json` returns it.

        Returns:
            The settings.

        Raises:
            ValueError: The text is not a JSON object of settings; the message names the wrong key or value.
        """
        try:
            values = json.loads(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"settings must be a JSON document: {error}") from None
        return cls.from_dict(values)

    @classmethod
    def from_dict(cls, values: JsonValues) -> Self:
        """Returns settings from JSON values by name; those that are left out have their defaults.

        Args:
            values: Values by name, as :meth:`to_dict` returns them.

        Raises:
            ValueError: A key is not a setting, or a value is wrong; the message names it.
        """
        if not isinstance(values, dict):
            raise ValueError(f"settings must be an object of settings by name, not {values!r}")
        names = {field.name for field in fields(cls)}
        unknown_names = set(values) - names - FORMER_SETTINGS
        if unknown_names:
            raise ValueError(f"not a setting: {', '.join(sorted(unknown_names))}")
        # In JSON a Gaussian prior is an object, and any other prior is a string.
        if isinstance(values.get("prior"), dict):
            values = values | {"prior": Gaussian.from_dict(values["prior"])}
        return cls(**{name: values[name] for name in names & set(values)})


@dataclass(frozen=True, eq=False, kw_only=True)
class CompleteSettings(Settings):
    """Settings with a value for everything that :class:`Settings` may leave to the data; its fields are the same."""

    order: PositiveInteger
    d: NonNegativeInteger
    window: PositiveInteger
    parameter_precision: PositiveNumber
