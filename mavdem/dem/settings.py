"""Settings: everything that decides a fit; and the complete ones, with nothing left to the data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from math import e
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from mavdem.arrays import ArrayPair, as_real_array
from mavdem.containers import JsonValues, Numbers
from mavdem.dem.engine.linalg import require_positive_definite
from mavdem.dem.validation import MAX_ABS_VALUE, checked_values
from mavdem.facts.fact import plain

FORMER = {"learning_rates"}  # of documents of earlier versions, where they were ``None``
LARGEST_LOG = 100.0  # of a log precision: e^±100 is beyond anything measured, and far from overflow


@dataclass(frozen=True)
class Gaussian:
    """N(mean, precision⁻¹): ``mean`` (k,), ``precision`` (k, k), positive definite; a number or (k,) is a diagonal.

    A known entry is one of high precision; a structure is a matrix of them.
    """

    mean: Numbers
    precision: tuple[Numbers, ...]

    def __init__(self, mean: ArrayLike, precision: ArrayLike) -> None:
        means = as_real_array(mean, "mean")
        precisions = as_real_array(precision, "precision")
        if means.ndim != 1 or not len(means) or not np.isfinite(means).all():
            raise ValueError(
                f"mean must be finite numbers of shape (k,), not of shape {means.shape}"
            )
        if precisions.ndim == 0:
            precisions = np.full(len(means), precisions)
        if precisions.ndim == 1 and len(precisions) == len(means):
            precisions = np.diag(precisions)
        require_positive_definite(precisions, "precision", len(means))
        object.__setattr__(self, "mean", tuple(means.tolist()))
        object.__setattr__(self, "precision", tuple(map(tuple, precisions.tolist())))

    @property
    def arrays(self) -> ArrayPair:
        """Mean (k,) and precision (k, k)."""
        return np.array(self.mean), np.array(self.precision)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Gaussian:
        """Returns the one of ``values`` = {"mean": …, "precision": …}; ``ValueError`` for anything else."""
        if not isinstance(values, Mapping) or set(values) != {"mean", "precision"}:
            raise ValueError(
                f'a Gaussian must be {{"mean": [...], "precision": ...}}, not {values!r}'
            )
        return cls(values["mean"], values["precision"])


Whole = Annotated[int, Field(ge=0, le=2**63 - 1)]
Natural = Annotated[int, Field(ge=1, le=2**63 - 1)]
# of a model: its fit takes memory of order n⁴, and no flight shows as many states
LARGEST_ORDER = 12
Positive = Annotated[float, Field(ge=1e-50, le=MAX_ABS_VALUE)]
Log = Annotated[float, Field(ge=-LARGEST_LOG, le=LARGEST_LOG)]


@dataclass(frozen=True, eq=False)
class Settings:
    """Everything that decides a fit. ``Settings()`` is for real flights, :meth:`paper` for the paper's experiments.

    Settings are equal where all their values are, complete (:class:`CompleteSettings`) or not.

    >>> settings = mavdem.Settings(order=4, horizon=None)
    >>> mavdem.Settings.from_json(settings.to_json()) == settings
    True

    **The model**

    Attributes:
        order: number of states n; states beyond the outputs are hidden. ``None``: one more than outputs.
        p: embedding order of outputs and states.
        d: embedding order of the inputs; ``None``: 2, or p if that is less.
        window: samples that each generalized vector is computed from, more than p and d; ``None``: 0.09 s of them,
            or as few as possible where segments are too short.
        scaling: "channel": every output and the inputs are centred and brought to unit variance, and a constant input
            learns the trim; "paper": outputs as they are, one mean and one range for all inputs; "none": both as they
            are.
        known_inputs: whether the recorded inputs are η̃ᵛ; if not, it is 0, and B belongs to unrecorded inputs.

    **The noise**

    Attributes:
        smoothness: kernel width s of the noise, seconds; ``None``: one sampling step.
        correlation: "sampled": the highest derivative of the process noise is left out, since samples do not show it;
            "continuous": it is taken to be that of a state whose next derivative is zero, and counted as evidence, as
            the paper's D does.

    **Priors**, in the units of ``scaling``

    Attributes:
        prior: "regulated": each output returns to its trim, rates are derivatives of angles, hidden states are
            actuator lags, C = [I 0]; "uniform": a mean drawn from U[−1, 1] for every parameter; or a ``Gaussian`` of
            θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] in physical units, in which a known parameter is one of high precision.
        parameter_precision: prior precision P of each free parameter; under a ``Gaussian`` prior, only of the trim;
            ``None``: 10 under the "regulated" prior, 1 under others.
        lambda_z, lambda_w: prior means of the log precisions of measurement and process noise, each one for all
            outputs or states, as in the paper.
        lambda_log_precision: the log precisions of these two priors: e²⁵ fixes λᶻ, e^−4.6 leaves λʷ to the data.
        input_precision: of every input about η̃ᵛ, and of each of its derivatives: P̃ᵛ is diagonal. 1.6e5: known to
            0.25 % of a unit.

    **Inference**

    Attributes:
        iterations: the most rounds of D, E and M steps; fewer when F̄ has converged.
        seed: of everything random (the "uniform" prior).

    **Forecasts**

    Attributes:
        horizon: seconds of the simulation-error fit that refines θ after DEM, where inputs are known and the prior is
            not "uniform" (``mavdem.dem.forecast.simulation_error``), less where the training data are too short;
            ``None``: no such fit.
        forecasts: "joint": by the joint model of outputs and motors, in which the motors measure the motion
            (``mavdem.dem.forecast.joint``); "plant": by A, B and C alone, motors as causes, as the paper does.
    """

    order: Annotated[int, Field(ge=1, le=LARGEST_ORDER)] | None = None
    p: Whole = 2
    d: Whole | None = None
    window: Natural | None = None
    scaling: Literal["channel", "paper", "none"] = "channel"
    known_inputs: bool = True

    smoothness: Positive | None = None
    correlation: Literal["sampled", "continuous"] = "sampled"

    prior: Literal["regulated", "uniform"] | Gaussian = "regulated"
    parameter_precision: Positive | None = None
    lambda_z: Log = 20.0
    lambda_w: Log = 3.0
    lambda_log_precision: tuple[Log, Log] = (25.0, -4.6)
    input_precision: Positive = 1.6e5

    iterations: Natural = 200
    seed: Whole = 0

    horizon: Positive | None = 0.3
    forecasts: Literal["joint", "plant"] = "joint"

    def __post_init__(self) -> None:
        values = {name: plain(value) for name, value in vars(self).items()}
        for name, value in checked_values(type(self), values).items():
            object.__setattr__(self, name, value)
        self._require_consistent()

    def _require_consistent(self) -> None:
        """Raises ``ValueError`` for what no field can satisfy by itself."""
        fewest = max(self.p, self.d or 0) + 1
        continuous = self.last_derivative_zero
        needs = (
            (
                self.window is None or self.window >= fewest,
                "window",
                f"at least {fewest} for p and d",
            ),
            # With C free, nothing fixes the scale of x, and F̄ is largest at C = 0.
            (
                self.prior != "uniform" or continuous,
                "correlation",
                '"continuous" with the uniform prior, which leaves C free',
            ),
            (continuous or self.p > 0, "correlation", '"continuous" with p = 0'),
            (
                self.known_inputs or self.prior != "regulated",
                "known_inputs",
                "True with the regulated prior, under which B would stay 0",
            ),
        )
        for holds, name, expected in needs:
            if not holds:
                raise ValueError(f"{name} must be {expected}, not {getattr(self, name)!r}")

    @property
    def last_derivative_zero(self) -> bool:
        """Whether the derivative of the highest order is taken to be zero and counted as evidence, or left out."""
        return self.correlation == "continuous"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Settings) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash(tuple(vars(self).values()))

    @classmethod
    def paper(cls, order: int = 2, seed: int = 0) -> Self:
        """Returns those of the paper, section V.D (``alg_settings``), of ``order`` states, η drawn with ``seed``.

        Where the paper and its authors' code leave a choice: outputs are not centred; the D step takes the exact
        limit k → ∞; D's last row is zero and counts; F̄ and its mean-field terms are exact; the first step already
        uses the prior λ; inputs are embedded over the outputs' window, so that both belong to one instant.
        """
        return cls(
            order=order,
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
        """Returns the settings as plain JSON values by name; :meth:`from_dict` is its inverse."""
        return asdict(self)

    def to_json(self) -> str:
        """Returns the settings as a JSON object; :meth:`from_json` is its inverse."""
        return json.dumps(self.to_dict(), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Returns settings from the ``text`` of :meth:`to_json`; ``ValueError`` names a key that is not a setting."""
        try:
            values = json.loads(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"settings must be a JSON document: {error}") from None
        return cls.from_dict(values)

    @classmethod
    def from_dict(cls, values: JsonValues) -> Self:
        """Returns settings from plain values by name; ``ValueError`` names a key that is not a setting."""
        if not isinstance(values, dict):
            raise ValueError(f"settings must be an object of settings by name, not {values!r}")
        names = {f.name for f in fields(cls)}
        unknown = set(values) - names - FORMER
        if unknown:
            raise ValueError(f"not a setting: {', '.join(sorted(unknown))}")
        if isinstance(values.get("prior"), dict):
            values = values | {"prior": Gaussian.from_dict(values["prior"])}
        return cls(**{name: values[name] for name in names & set(values)})


@dataclass(frozen=True, eq=False, kw_only=True)
class CompleteSettings(Settings):
    """Settings with a number for all that may be left to the data; the fields are those of :class:`Settings`."""

    order: Natural
    d: Whole
    window: Natural
    parameter_precision: Positive
