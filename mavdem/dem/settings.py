"""Settings: everything that decides a fit; and the complete ones, with nothing left to the data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from math import e
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field, InstanceOf

from mavdem.dem.engine.linalg import Array, require_positive_definite
from mavdem.dem.validation import checked_fields, json_values, real_numbers

LARGEST_LOG = 100.0  # of a log precision: e^±100 is beyond anything measured, and far from overflow
SMALLEST = 1e-50  # of a positive setting; the largest is its inverse


@dataclass(frozen=True)
class Gaussian:
    """N(mean, precision⁻¹). A known entry is one of high precision; a structure is a matrix of them.

    Attributes:
        mean: (k,).
        precision: (k, k), symmetric positive definite; a number or (k,) stands for a diagonal.

    Raises:
        ValueError: names what is not finite, of the wrong shape or not positive definite.
    """

    mean: tuple[float, ...]
    precision: tuple[tuple[float, ...], ...]

    def __init__(self, mean: ArrayLike, precision: ArrayLike) -> None:
        means, precisions = real_numbers(mean, "mean"), real_numbers(precision, "precision")
        if means.ndim != 1 or not len(means) or not np.isfinite(means).all():
            raise ValueError(f"mean must be finite numbers of shape (k,), not of shape {means.shape}")
        if precisions.ndim == 0:
            precisions = np.full(len(means), precisions)
        if precisions.ndim == 1 and len(precisions) == len(means):
            precisions = np.diag(precisions)
        require_positive_definite(precisions, "precision", len(means))
        object.__setattr__(self, "mean", tuple(means.tolist()))
        object.__setattr__(self, "precision", tuple(map(tuple, precisions.tolist())))

    @property
    def arrays(self) -> tuple[Array, Array]:
        """Mean (k,) and precision (k, k)."""
        return np.array(self.mean), np.array(self.precision)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Gaussian:
        """From ``values`` = {"mean": …, "precision": …}; ``ValueError`` for anything else."""
        if not isinstance(values, Mapping) or set(values) != {"mean", "precision"}:
            raise ValueError(f'a Gaussian must be {{"mean": [...], "precision": ...}}, not {values!r}')
        return cls(values["mean"], values["precision"])


def _numbered_from_zero(groups: tuple[int, ...]) -> tuple[int, ...]:
    if sorted(set(groups)) != list(range(len(set(groups)))):
        raise ValueError
    return groups


def _positive_definite(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    require_positive_definite(np.array(rows), "it", len(rows))
    return rows


Positive = Annotated[float, Field(ge=SMALLEST, le=1 / SMALLEST)]
LogPrecision = Annotated[float, Field(ge=-LARGEST_LOG, le=LARGEST_LOG)]
Groups = Annotated[tuple[int, ...], Field(min_length=1), AfterValidator(_numbered_from_zero)]
Matrix = Annotated[tuple[tuple[float, ...], ...], Field(min_length=1), AfterValidator(_positive_definite)]

_POSITIVE = f"a positive number of at least {SMALLEST:g} and at most {1 / SMALLEST:g}"
_ONE_OR_EACH = ", or one for each group"
_LOG_PRECISION = f"a number of at most {LARGEST_LOG:g} either way{_ONE_OR_EACH}"
_GROUPS = "group numbers that start at 0 and leave none out, or None"

LogPrecisions = Annotated[LogPrecision | tuple[LogPrecision, ...], Field(description=_LOG_PRECISION)]
Precisions = Annotated[Positive | tuple[Positive, ...], Field(description=_POSITIVE + _ONE_OR_EACH)]
PositiveOrNone = Annotated[Positive | None, Field(description=f"{_POSITIVE}, or None")]
GroupsOrNone = Annotated[Groups | None, Field(description=_GROUPS)]
Flag = Annotated[bool, Field(description="True or False")]


def _whole(least: int, otherwise: str = "") -> Any:
    return Field(ge=least, le=2**63 - 1, description=f"a whole number of at least {least}{otherwise}")


@dataclass(frozen=True, eq=False)
class Settings:
    """Everything that decides a fit. ``Settings()`` is for real flights, :meth:`paper` for the paper's experiments.

    Settings are equal where all their values are, complete (:class:`CompleteSettings`) or not.

    Attributes:
        order: number of states n; states beyond the outputs are hidden. ``None``: one more than outputs.
        p: embedding order of outputs and states.
        d: embedding order of the inputs; ``None``: 2, or p if that is less.
        window: samples that each generalized vector is computed from, more than p and d; ``None``: 0.09 s of them,
            or as few as possible where segments are too short (``mavdem.dem.selection``).
        smoothness: kernel width s of the noise, seconds; ``None``: one sampling step; "learn": the one that maximises
            F̄ᵒ of the training data (:func:`mavdem.dem.estimate_smoothness`).
        correlation: S, of the noise and its derivatives. "sampled": of derivatives computed from the window's samples;
            "continuous": of the true derivatives, Eq. ``Smatrix``.
        last_derivative_zero: whether the derivative of the highest order is taken to be zero and counted as evidence,
            as the paper's D does, or is left out.
        scaling: "channel": every output and the inputs are centred and brought to unit variance, and a constant input
            learns the trim; "paper": outputs as they are, one mean and one range for all inputs; "none": both as they
            are.
        prior: "regulated": each output returns to its trim, rates are derivatives of angles, hidden states are
            actuator lags, C = [I 0]; "uniform": a mean drawn from U[−1, 1] for every parameter; or a ``Gaussian`` of
            θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] in physical units, in which a known parameter is one of high precision.
        parameter_precision: prior precision P of each free parameter, in the units of ``scaling``; under a ``Gaussian``
            prior, only of the trim; ``None``: 10 under the "regulated" prior, or, without a
            simulation-error fit, the one of four that forecasts the training data best; under others 1.
        lambda_z, lambda_w: prior means of the log precisions of measurement and process noise, in the units of
            ``scaling``; one number, or one for each group.
        lambda_z_precision, lambda_w_precision: precisions of these priors, likewise.
        lambda_prior: in place of these four, a ``Gaussian`` of all λ, outputs' groups before states'.
        output_groups, state_groups: for each output, and each state, the number of its group, from 0; a group shares
            one λ. ``None``: all share one, as in the paper.
        known_inputs: whether the recorded inputs are η̃ᵛ; if not, it is 0, and B belongs to unrecorded inputs. Or a
            flag for each column: a column of zeros then represents one unknown input.
        input_precision: P̃ᵛ, in the units of ``scaling``: the precision of inputs about η̃ᵛ and of each derivative; one
            number, one for each input, or a matrix ((d + 1)r, (d + 1)r), order-major.
        state_rate, parameter_rate, hyperparameter_rate: learning rates k^X, k^θ and k^λ of Eq. ``GA_basic``, in the
            engine's units; ``None``: the exact limit, in which each step goes to its maximum.
        horizon: seconds of the simulation-error fit that refines θ after DEM, where inputs are known and the prior is
            not "uniform" (``mavdem.dem.forecast.simulation_error``), less where the training data are too short;
            ``None``: no such fit.
        shrink_forecasts: whether forecasts are shrunk towards the trim as far as the posterior of θ is uncertain; or,
            where θ was not refined, by the weight that forecasts of the training data give.
        closed_loop: whether forecasts take the motors for measurements of the motion as well, since the autopilot
            answers it, and not for causes alone (``mavdem.dem.closed_loop``).
        iterations: the most rounds of D, E and M steps; fewer when F̄ has converged.
        seed: of everything random (the "uniform" prior).

    Raises:
        ValueError: names the setting and says what it must be.
    """

    order: Annotated[int | None, _whole(1, ", or None for one more than outputs")] = None
    p: Annotated[int, _whole(0)] = 2
    d: Annotated[int | None, _whole(0, ", or None")] = None
    window: Annotated[int | None, _whole(1, ", or None")] = None
    smoothness: Annotated[
        Positive | Literal["learn"] | None, Field(description='a positive number, None or "learn"')
    ] = None
    correlation: Annotated[Literal["sampled", "continuous"], Field(description='"sampled" or "continuous"')] = "sampled"
    last_derivative_zero: Flag = False
    scaling: Annotated[Literal["channel", "paper", "none"], Field(description='"channel", "paper" or "none"')] = (
        "channel"
    )
    prior: Annotated[
        Literal["regulated", "uniform"] | InstanceOf[Gaussian],
        Field(description='"regulated", "uniform" or a Gaussian'),
    ] = "regulated"
    parameter_precision: PositiveOrNone = None
    lambda_z: LogPrecisions = 20.0
    lambda_z_precision: Precisions = e**25
    lambda_w: LogPrecisions = 3.0
    lambda_w_precision: Precisions = 0.01
    lambda_prior: Annotated[InstanceOf[Gaussian] | None, Field(description="a Gaussian or None")] = None
    output_groups: GroupsOrNone = None
    state_groups: GroupsOrNone = None
    known_inputs: Annotated[
        bool | Annotated[tuple[bool, ...], Field(min_length=1)],
        Field(description="True or False, or one of them for each input"),
    ] = True
    input_precision: Annotated[
        Positive | Annotated[tuple[Positive, ...], Field(min_length=1)] | Matrix,
        Field(description="a positive number, one for each input, or a positive definite matrix"),
    ] = e**12
    state_rate: PositiveOrNone = None
    parameter_rate: PositiveOrNone = None
    hyperparameter_rate: PositiveOrNone = None
    horizon: PositiveOrNone = 0.3
    shrink_forecasts: Flag = True
    closed_loop: Flag = True
    iterations: Annotated[int, _whole(1)] = 200
    seed: Annotated[int, _whole(0)] = 0

    def __post_init__(self) -> None:
        plain = {name: _plain(value) for name, value in vars(self).items()}
        for name, value in checked_fields(type(self), plain).items():
            object.__setattr__(self, name, value)
        self._require_consistent()

    def _require_consistent(self) -> None:
        """What no field can satisfy by itself."""
        fewest = max(self.p, self.d or 0) + 1
        _require(self.window is None or self.window >= fewest, "window", f"at least {fewest} for p and d", self.window)
        for kind, groups in (("z", self.output_groups), ("w", self.state_groups)):
            number = 1 if groups is None else max(groups) + 1
            for name in (f"lambda_{kind}", f"lambda_{kind}_precision"):
                value = getattr(self, name)
                fits = not isinstance(value, tuple) or len(value) == number
                _require(fits, name, f"a number for each of {number} groups", value)
        # The highest order of the states' noise, computed from samples, would take one derivative more.
        needed = self.correlation == "continuous" or not self.last_derivative_zero
        _require(needed, "correlation", '"continuous" with last_derivative_zero', self.correlation)
        # Else nothing fixes the scale of x, and F̄ is largest at C = 0.
        needed = self.last_derivative_zero or self.prior != "uniform"
        _require(needed, "last_derivative_zero", "True with the uniform prior, which leaves C free", False)
        _require(self.last_derivative_zero or self.p > 0, "last_derivative_zero", "True with p = 0", False)
        all_known = all(np.atleast_1d(self.known_inputs))
        needed = all_known or self.smoothness != "learn"
        _require(needed, "smoothness", "a number where inputs are unknown, whose smoothness differs", "learn")
        needed = all_known or self.prior != "regulated"
        _require(needed, "known_inputs", "True with the regulated prior, under which B would stay 0", False)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Settings) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash(tuple(vars(self).values()))

    @classmethod
    def paper(cls, order: int = 2, seed: int = 0) -> Self:
        """The settings of the paper, section V.D (``alg_settings``): p = 2, d = 1, s = dt, η from U[−1, 1], P = e⁴.

        Where the paper and its authors' code leave a choice: outputs are not centred; the D step takes the exact
        limit k → ∞; D's last row is zero and counts; F̄ and its mean-field terms are exact; the first step already
        uses the prior λ; inputs are embedded over the outputs' window, so that both belong to one instant. ``order``
        is the number of states n, two in the paper's models, and ``seed`` that of the draw of η.
        """
        return cls(
            order=order,
            p=2,
            d=1,
            window=3,
            correlation="continuous",
            last_derivative_zero=True,
            scaling="paper",
            prior="uniform",
            parameter_precision=e**4,
            lambda_z=20.0,
            lambda_z_precision=e**25,
            lambda_w=3.0,
            lambda_w_precision=e**20,
            input_precision=e**16,
            horizon=None,
            shrink_forecasts=False,
            closed_loop=False,
            iterations=20,
            seed=seed,
        )

    def completed(self, order: int, d: int, window: int, parameter_precision: float) -> CompleteSettings:
        """These settings; where they leave ``order``, ``d``, ``window`` or ``parameter_precision`` open, with these."""
        chosen = {"order": order, "d": d, "window": window, "parameter_precision": parameter_precision}
        fixed = {name: value for name, value in vars(self).items() if value is not None}
        return CompleteSettings(**{**vars(self), **chosen, **fixed})

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain JSON values by name; :meth:`from_dict` is its inverse."""
        return asdict(self)

    def to_json(self) -> str:
        """The settings as a JSON object; :meth:`from_json` is its inverse."""
        return json.dumps(self.to_dict(), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Settings from the ``text`` of :meth:`to_json`; ``ValueError`` names a key that is not a setting."""
        return cls.from_dict(json_values(text, "settings"))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """Settings from plain values by name; ``ValueError`` names a key that is not a setting."""
        if not isinstance(values, dict):
            raise ValueError(f"settings must be an object of settings by name, not {values!r}")
        unknown = set(values) - {f.name for f in fields(cls)}
        if unknown:
            raise ValueError(f"not a setting: {', '.join(sorted(unknown))}")
        gaussians = {
            name: Gaussian.from_dict(values[name])
            for name in ("prior", "lambda_prior")
            if isinstance(values.get(name), dict)
        }
        return cls(**{**values, **gaussians})


@dataclass(frozen=True, eq=False, kw_only=True)
class CompleteSettings(Settings):
    """Settings with a number for all that may be left to the data; the fields are those of :class:`Settings`."""

    order: Annotated[int, _whole(1)]
    d: Annotated[int, _whole(0)]
    window: Annotated[int, _whole(1)]
    smoothness: Annotated[Positive | None, Field(description="a positive number or None")] = None
    parameter_precision: Annotated[Positive, Field(description=_POSITIVE)]


def _plain(value: Any) -> Any:
    """Lists and arrays as tuples of plain numbers, which cannot be changed and compare by value."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, list | tuple) else value


def _require(holds: bool, name: str, expected: str, value: object) -> None:
    if not holds:
        raise ValueError(f"{name} must be {expected}, not {value!r}")
