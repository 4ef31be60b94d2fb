"""Settings: everything that decides a fit."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields
from math import e
from numbers import Integral, Real
from typing import Any, Literal


@dataclass(frozen=True)
class Settings:
    """Everything that decides a fit. ``Settings()`` is for real flights, :meth:`paper` for the paper's experiments.

    ``window`` and ``parameter_precision`` may be ``None``, which leaves them to the training data: every combination of
    the candidates in ``mavdem.dem.choice`` is learnt, and the one whose forecasts inside the data err least is kept.

    Attributes:
        order: number of states n; states beyond the outputs are hidden. ``None``: one more than outputs.
        p: embedding order of outputs and states, at least 1.
        d: embedding order of the inputs, at most p; ``None``: 2, or p if that is less.
        window: samples that each generalized vector is read from, at least p + 1.
        smoothness: kernel width s of the noise, seconds; ``None``: one sampling step.
        last_derivative_zero: whether the derivative of the highest order is taken to be zero and counted as evidence,
            as the paper's D does, or is left out.
        scaling: "channel": every output and the inputs are centred and brought to unit variance, and a constant input
            learns the trim; "paper": outputs as they are, one mean and one range for all inputs.
        prior: "regulated": each output tends back to its trim, rates are derivatives of angles, hidden states are
            actuator lags, C = [I 0]; "uniform": a mean drawn from U[−1, 1] for every parameter.
        parameter_precision: prior precision P of each free parameter, in the units of ``scaling``.
        lambda_z, lambda_w: prior means of the log precisions of measurement and process noise.
        lambda_z_precision, lambda_w_precision: how sure the prior is of them.
        lambda_per_channel: one λ for each output and each state, or one λᶻ and one λʷ as in the paper.
        input_precision: precision of the measured inputs about themselves, P̃ᵛ = ``input_precision``·I.
        shrink_forecasts: whether forecasts are drawn back towards the trim by as much as forecasts of training data
            that a fit has not seen advise.
        iterations: at most so many rounds of D, E and M steps; they end earlier when F̄ has settled.
        seed: of everything random (the "uniform" prior).
    """

    order: int | None = None
    p: int = 2
    d: int | None = None
    window: int | None = None
    smoothness: float | None = None
    last_derivative_zero: bool = False
    scaling: Literal["channel", "paper"] = "channel"
    prior: Literal["regulated", "uniform"] = "regulated"
    parameter_precision: float | None = None
    lambda_z: float = 20.0
    lambda_z_precision: float = e**25
    lambda_w: float = 3.0
    lambda_w_precision: float = 0.01
    lambda_per_channel: bool = False
    input_precision: float = e**12
    shrink_forecasts: bool = True
    iterations: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("order", "p", "d", "window", "iterations", "seed"):
            value = getattr(self, name)
            optional = name in ("order", "d", "window")
            whole = isinstance(value, Integral) and not isinstance(value, bool)
            _require(whole or optional and value is None, name, "a whole number", value)
        for name in ("lambda_z", "lambda_w"):
            _require(_finite(getattr(self, name)), name, "a finite number", getattr(self, name))
        for name in ("last_derivative_zero", "lambda_per_channel", "shrink_forecasts"):
            _require(isinstance(getattr(self, name), bool), name, "True or False", getattr(self, name))
        _require(
            self.order is None or self.order >= 1, "order", "at least 1, or None for one more than outputs", self.order
        )
        _require(self.p >= 1, "p", "at least 1", self.p)
        _require(self.d is None or 0 <= self.d <= self.p, "d", f"None or between 0 and p = {self.p}", self.d)
        _require(self.window is None or self.window > self.p, "window", f"at least p + 1 = {self.p + 1}", self.window)
        positive = ("lambda_z_precision", "lambda_w_precision", "input_precision")
        for name in (*positive, "parameter_precision", "smoothness"):
            value = getattr(self, name)
            optional = name not in positive
            _require(_finite(value) and value > 0 or optional and value is None, name, "a positive number", value)
        _require(self.scaling in ("channel", "paper"), "scaling", '"channel" or "paper"', self.scaling)
        _require(self.prior in ("regulated", "uniform"), "prior", '"regulated" or "uniform"', self.prior)
        # The scale of x is then held by nothing, and F̄ is highest where C is nothing.
        needed = self.last_derivative_zero or self.prior == "regulated"
        _require(needed, "last_derivative_zero", "True with the uniform prior, which leaves C free", False)
        _require(self.iterations >= 1, "iterations", "at least 1", self.iterations)

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
            last_derivative_zero=True,
            scaling="paper",
            prior="uniform",
            parameter_precision=e**4,
            lambda_z=20.0,
            lambda_z_precision=e**25,
            lambda_w=3.0,
            lambda_w_precision=e**20,
            input_precision=e**16,
            shrink_forecasts=False,
            iterations=20,
            seed=seed,
        )

    def to_json(self) -> str:
        """The settings as a JSON object; :meth:`from_json` reads it back."""
        return json.dumps(asdict(self), indent=1)

    @classmethod
    def from_json(cls, text: str) -> Settings:
        """Settings whose :meth:`to_json` wrote ``text``; ``ValueError`` names a key that is not a setting."""
        return cls.from_dict(json.loads(text))

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Settings:
        """Settings from plain values by name; ``ValueError`` names a key that is not a setting."""
        if not isinstance(values, dict):
            raise ValueError(f"settings must be an object of settings by name, not {values!r}")
        unknown = set(values) - {f.name for f in fields(cls)}
        if unknown:
            raise ValueError(f"not a setting: {', '.join(sorted(unknown))}")
        return cls(**values)


def _finite(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _require(holds: bool, name: str, expected: str, value: object) -> None:
    if not holds:
        raise ValueError(f"{name} must be {expected}, not {value!r}")
