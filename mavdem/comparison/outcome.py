"""Outcome: what one method makes of one window."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.comparison.method import Method
from mavdem.evaluate import Skill, horizons, mspe, skill, skill_by_horizon
from mavdem.forecaster import Forecaster, ProbabilisticForecaster
from mavdem.windows import Window

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one method made of one window; every error is infinite where it has no forecast.

    Attributes:
        method: its name.
        flight, start: which window.
        failure: why there is no forecast; empty where there is one.
        stable: whether no mode of the model grows; ``None`` where there is no model.
        cautions: what the model itself warns of.
        mspe: (m,) of the forecast from the end of training, in the squares of the outputs' units.
        skill: by horizon, the last one that of the whole test part.
        mspe_from_zero, skill_from_zero: of the forecast of the whole test part that begins with state 0.
        forecast, forecast_from_zero: (H, m), for pictures; ``None`` where there is none.
        expected: (H, m) squared error that ``forecast`` expects of itself at each sample, in the squares of the units;
            ``None`` where the method does not say.
        band: lower and upper bounds, (H, m) each, between which it holds a sample to lie with probability 0.9; or
            ``None``.
        seconds: of a processor that learning took.
    """

    method: str
    flight: str
    start: int
    failure: str
    stable: bool | None
    cautions: tuple[str, ...]
    mspe: Array
    skill: tuple[Skill, ...]
    mspe_from_zero: Array
    skill_from_zero: Skill
    forecast: Array | None
    forecast_from_zero: Array | None
    expected: Array | None
    band: tuple[Array, Array] | None
    seconds: float

    @property
    def diverged(self) -> bool:
        """Whether there is a forecast, and it runs beyond all numbers."""
        return not self.failure and not np.isfinite(self.mspe).all()

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name, without the forecasts themselves."""
        return {
            "failure": self.failure,
            "stable": self.stable,
            "cautions": list(self.cautions),
            "mspe": {"per_output": self.mspe.tolist(), "total": float(self.mspe.sum())},
            "skill": [told(one) for one in self.skill],
            "from_zero": {
                "mspe": {"per_output": self.mspe_from_zero.tolist(), "total": float(self.mspe_from_zero.sum())},
                "skill": told(self.skill_from_zero),
            },
            "seconds": round(self.seconds, 4),
        }


def told(skill: Skill) -> dict[str, Any]:
    """A skill as plain JSON values by name.

    Args:
        skill: what is told.
    """
    return skill._asdict() | {
        "per_output": skill.per_output.tolist(),
        "relative_per_output": skill.relative_per_output.tolist(),
    }


def judge(method: Method, window: Window) -> Outcome:
    """Learns the first part of a window and forecasts the second; what the data make go wrong is the outcome.

    Args:
        method: what learns.
        window: what is learnt from and forecast.
    """
    began = thread_time()
    # What numpy and scipy would warn of is in the outcome.
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = method.learn(window.train)
            seconds = thread_time() - began
            return _forecast(method, window, model, seconds)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            failure = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
            return _failed(method, window, failure, thread_time() - began)


def _forecast(method: Method, window: Window, model: Forecaster, seconds: float) -> Outcome:
    train, test = window.train, window.test
    forecast, from_zero = model.forecast(test.inputs), model.forecast(test.inputs, from_zero=True)
    return Outcome(
        method.name,
        window.flight,
        window.start,
        failure="",
        stable=model.stable,
        cautions=tuple(model.cautions),
        mspe=mspe(test.outputs, forecast).per_output,
        skill=skill_by_horizon(model, train, test, horizons(len(test), test.dt)),
        mspe_from_zero=mspe(test.outputs, from_zero).per_output,
        skill_from_zero=skill(train, test, from_zero, len(test)),
        forecast=forecast,
        forecast_from_zero=from_zero,
        expected=model.forecast_variance(test.inputs) if isinstance(model, ProbabilisticForecaster) else None,
        band=model.forecast_band(test.inputs) if isinstance(model, ProbabilisticForecaster) else None,
        seconds=seconds,
    )


def _failed(method: Method, window: Window, failure: str, seconds: float) -> Outcome:
    test, outputs = window.test, window.test.outputs.shape[1]
    infinite = np.full(outputs, np.inf)
    skills = tuple(Skill(steps, infinite, np.inf, infinite, np.inf) for steps in horizons(len(test), test.dt))
    return Outcome(
        method.name,
        window.flight,
        window.start,
        failure=failure,
        stable=None,
        cautions=(),
        mspe=infinite,
        skill=skills,
        mspe_from_zero=infinite,
        skill_from_zero=skills[-1],
        forecast=None,
        forecast_from_zero=None,
        expected=None,
        band=None,
        seconds=seconds,
    )
