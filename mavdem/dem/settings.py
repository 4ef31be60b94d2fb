"""Settings: everything that decides a fit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from math import e
from typing import Any, Literal

import numpy as np

from mavdem.dem.gaussian import Gaussian
from mavdem.dem.json_text import json_values
from mavdem.dem.positive import require_positive_definite
from mavdem.dem.real import is_number, is_whole

LARGEST_LOG = 100.0
"""Of a log precision: e^±100 is beyond anything measured, and far within what numbers hold."""

SMALLEST = 1e-50
"""Of a positive setting; and the inverse of the largest."""


@dataclass(frozen=True)
class Settings:
    """Everything that decides a fit. ``Settings()`` is for real flights, :meth:`paper` for the paper's experiments.

    ``window`` and ``parameter_precision`` may be ``None``, which leaves them to the training data: every combination of
    the candidates in ``mavdem.dem.choice`` is learnt, and the one whose forecasts inside the data err least is kept.

    Attributes:
        order: number of states n; states beyond the outputs are hidden. ``None``: one more than outputs.
        p: embedding order of outputs and states.
        d: embedding order of the inputs; ``None``: 2, or p if that is less.
        window: samples that each generalized vector is read from, more than p and d.
        smoothness: kernel width s of the noise, seconds; ``None``: one sampling step; "learn": the one at which F̄ᵒ of
            the training data is highest.
        correlation: S, of the noise and its derivatives. "sampled": as the window reads them from samples;
            "continuous": the true ones, Eq. ``Smatrix``.
        last_derivative_zero: whether the derivative of the highest order is taken to be zero and counted as evidence,
            as the paper's D does, or is left out.
        scaling: "channel": every output and the inputs are centred and brought to unit variance, and a constant input
            learns the trim; "paper": outputs as they are, one mean and one range for all inputs; "none": both as they
            are.
        prior: "regulated": each output tends back to its trim, rates are derivatives of angles, hidden states are
            actuator lags, C = [I 0]; "uniform": a mean drawn from U[−1, 1] for every parameter; or a ``Gaussian`` of
            θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)] in physical units, in which a known parameter is one of high precision.
        parameter_precision: prior precision P of each free parameter, in the units of ``scaling``; under a ``Gaussian``
            prior, only of the trim.
        lambda_z, lambda_w: prior means of the log precisions of measurement and process noise, in the units of
            ``scaling``; one number, or one for each group.
        lambda_z_precision, lambda_w_precision: how sure the prior is of them, likewise.
        lambda_prior: in place of these four, a ``Gaussian`` of all λ, outputs' groups before states'.
        output_groups, state_groups: for each output, and each state, the number of its group, from 0; a group shares
            one λ. ``None``: all share one, as in the paper.
        known_inputs: whether the recorded inputs are η̃ᵛ; if not, it is 0, and B belongs to inputs nobody recorded. For
            each column by itself, if several are given: a column of zeros then stands for one unknown input.
        input_precision: P̃ᵛ, in the units of ``scaling``: the precision of inputs about η̃ᵛ and of each derivative; one
            number, one for each input, or a matrix ((d + 1)r, (d + 1)r), order-major.
        state_rate, parameter_rate, hyperparameter_rate: learning rates k^X, k^θ and k^λ of Eq. ``GA_basic``, in the
            engine's units; ``None``: the exact limit, in which each step goes to its maximum.
        horizon: seconds of the trajectories along which θ climbs on from where generalized coordinates led it, where
            inputs are known and the prior is not "uniform" (``mavdem.dem.trajectory``); ``None``: it stays there.
        shrink_forecasts: whether forecasts are drawn back towards the trim by as much as the posterior of θ advises;
            or, where there were no trajectories, forecasts of training data that a fit has not seen.
        iterations: at most so many rounds of D, E and M steps; they end earlier when F̄ has settled.
        seed: of everything random (the "uniform" prior).

    Raises:
        ValueError: names the setting and says what it must be.
    """

    order: int | None = None
    p: int = 2
    d: int | None = None
    window: int | None = None
    smoothness: float | Literal["learn"] | None = None
    correlation: Literal["sampled", "continuous"] = "sampled"
    last_derivative_zero: bool = False
    scaling: Literal["channel", "paper", "none"] = "channel"
    prior: Literal["regulated", "uniform"] | Gaussian = "regulated"
    parameter_precision: float | None = None
    lambda_z: float | tuple[float, ...] = 20.0
    lambda_z_precision: float | tuple[float, ...] = e**25
    lambda_w: float | tuple[float, ...] = 3.0
    lambda_w_precision: float | tuple[float, ...] = 0.01
    lambda_prior: Gaussian | None = None
    output_groups: tuple[int, ...] | None = None
    state_groups: tuple[int, ...] | None = None
    known_inputs: bool | tuple[bool, ...] = True
    input_precision: float | tuple[float, ...] | tuple[tuple[float, ...], ...] = e**12
    state_rate: float | None = None
    parameter_rate: float | None = None
    hyperparameter_rate: float | None = None
    horizon: float | None = 0.3
    shrink_forecasts: bool = True
    iterations: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.generic):
                object.__setattr__(self, name, value.item())
        for name in (
            "lambda_z",
            "lambda_z_precision",
            "lambda_w",
            "lambda_w_precision",
            "input_precision",
            "known_inputs",
        ):
            object.__setattr__(self, name, _tuples(getattr(self, name)))
        for name in ("output_groups", "state_groups"):
            object.__setattr__(self, name, _tuples(getattr(self, name)))
            self._require_groups(name)
        for name in ("order", "p", "d", "window", "iterations", "seed"):
            value = getattr(self, name)
            optional = name in ("order", "d", "window")
            _require(is_whole(value) or optional and value is None, name, "a whole number", value)
        for name in ("smoothness", "scaling", "prior", "correlation"):
            _require(not isinstance(getattr(self, name), np.ndarray), name, "no array", getattr(self, name))
        for name in ("last_derivative_zero", "shrink_forecasts"):
            _require(isinstance(getattr(self, name), bool), name, "True or False", getattr(self, name))
        known = self.known_inputs if isinstance(self.known_inputs, tuple) else (self.known_inputs,)
        said = bool(known) and all(isinstance(one, bool) for one in known)
        _require(said, "known_inputs", "True or False, or that for each input", self.known_inputs)
        prior = self.lambda_prior is None or isinstance(self.lambda_prior, Gaussian)
        _require(prior, "lambda_prior", "a Gaussian or None", self.lambda_prior)
        _require(
            self.order is None or self.order >= 1, "order", "at least 1, or None for one more than outputs", self.order
        )
        _require(self.p >= 0, "p", "at least 0", self.p)
        _require(self.d is None or self.d >= 0, "d", "None or at least 0", self.d)
        fewest = max(self.p, self.d or 0) + 1
        _require(self.window is None or self.window >= fewest, "window", f"at least {fewest} for p and d", self.window)
        learnt = self.smoothness is None or self.smoothness == "learn" or _positive(self.smoothness)
        _require(learnt, "smoothness", 'a positive number, None or "learn"', self.smoothness)
        for name in ("parameter_precision", "state_rate", "parameter_rate", "hyperparameter_rate", "horizon"):
            value = getattr(self, name)
            _require(value is None or _positive(value), name, f"{_LIKE[_positive]}, or None", value)
        for kind, groups in (("z", self.output_groups), ("w", self.state_groups)):
            for name, fits in ((f"lambda_{kind}", _finite), (f"lambda_{kind}_precision", _positive)):
                self._require_each(name, fits, 1 if groups is None else max(groups) + 1)
        self._require_input_precision()
        scalings = ("channel", "paper", "none")
        _require(self.scaling in scalings, "scaling", '"channel", "paper" or "none"', self.scaling)
        correlations = ("sampled", "continuous")
        _require(self.correlation in correlations, "correlation", '"sampled" or "continuous"', self.correlation)
        # What is read as the highest order of the states' noise would take one derivative more.
        needed = self.correlation == "continuous" or not self.last_derivative_zero
        _require(needed, "correlation", '"continuous" with last_derivative_zero', self.correlation)
        named = isinstance(self.prior, Gaussian) or self.prior in ("regulated", "uniform")
        _require(named, "prior", '"regulated", "uniform" or a Gaussian', self.prior)
        # The scale of x is then held by nothing, and F̄ is highest where C is nothing.
        needed = self.last_derivative_zero or self.prior != "uniform"
        _require(needed, "last_derivative_zero", "True with the uniform prior, which leaves C free", False)
        _require(self.last_derivative_zero or self.p > 0, "last_derivative_zero", "True with p = 0", False)
        needed = all(known) or self.smoothness != "learn"
        _require(needed, "smoothness", "a number where inputs are unknown, which have a colour of their own", "learn")
        needed = all(known) or self.prior != "regulated"
        _require(needed, "known_inputs", "True with the regulated prior, under which B would stay 0", False)
        _require(self.iterations >= 1, "iterations", "at least 1", self.iterations)
        _require(self.seed >= 0, "seed", "at least 0", self.seed)

    def _require_groups(self, name: str) -> None:
        groups = getattr(self, name)
        numbered = groups is None or (
            isinstance(groups, tuple)
            and groups != ()
            and all(map(is_whole, groups))
            and sorted(set(groups)) == list(range(len(set(groups))))
        )
        _require(numbered, name, "group numbers that start at 0 and leave none out, or None", groups)

    def _require_each(self, name: str, fits: Callable[[object], bool], groups: int) -> None:
        value = getattr(self, name)
        if isinstance(value, tuple):
            _require(
                len(value) == groups and all(map(fits, value)),
                name,
                f"{_LIKE[fits]} for each of {groups} groups",
                value,
            )
        else:
            _require(fits(value), name, _LIKE[fits], value)

    def _require_input_precision(self) -> None:
        value = self.input_precision
        if not isinstance(value, tuple):
            return _require(_positive(value), "input_precision", "a positive number or a matrix", value)
        if value and not any(isinstance(one, tuple) for one in value):
            return _require(all(map(_positive, value)), "input_precision", "positive numbers", value)
        try:
            matrix = np.array(value, np.float64)
        except (TypeError, ValueError, OverflowError):
            matrix = np.empty(0)
        require_positive_definite(matrix, "input_precision", len(value))

    @classmethod
    def paper(cls, order: int = 2, seed: int = 0) -> Settings:
        """The settings of the paper, section V.D (``alg_settings``): p = 2, d = 1, s = dt, η from U[−1, 1], P = e⁴.

        Where the paper and its authors' code leave a choice: outputs are not centred; the D step takes the exact
        limit k → ∞; D's last row is zero and counts; F̄ and its mean-field terms are exact; the first step already
        uses the prior λ; inputs are embedded over the outputs' window, so that both belong to one instant.

        Args:
            order: number of states n; the paper's models have two.
            seed: of the draw of η.
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
            iterations=20,
            seed=seed,
        )

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain JSON values by name; :meth:`from_dict` reads them back."""
        return asdict(self)

    def to_json(self) -> str:
        """The settings as a JSON object; :meth:`from_json` reads it back."""
        return json.dumps(self.to_dict(), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Settings:
        """Settings whose :meth:`to_json` wrote ``text``; ``ValueError`` names a key that is not a setting."""
        return cls.from_dict(json_values(text, "settings"))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Settings:
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


def _finite(value: object) -> bool:
    """Whether it is a log precision that arithmetic can bear."""
    return is_number(value) and abs(value) <= LARGEST_LOG


def _positive(value: object) -> bool:
    return is_number(value) and SMALLEST <= value <= 1 / SMALLEST


_LIKE: dict[Callable[[object], bool], str] = {
    _finite: f"a number of at most {LARGEST_LOG:g} either way",
    _positive: f"a positive number of at least {SMALLEST:g} and at most {1 / SMALLEST:g}",
}


def _tuples(value: Any) -> Any:
    """Lists and arrays as tuples of plain numbers, which cannot be changed and compare by value."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(_tuples, value)) if isinstance(value, (list, tuple)) else value


def _require(holds: bool, name: str, expected: str, value: object) -> None:
    if not holds:
        raise ValueError(f"{name} must be {expected}, not {value!r}")
