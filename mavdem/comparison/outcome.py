"""A method, and its outcome on one window."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import thread_time
from typing import Any, NamedTuple

import numpy as np

from mavdem.dem.engine.linalg import Array
from mavdem.evaluate import Skill, horizons, mspe, prediction_skill_by_horizon, skill, skill_by_horizon
from mavdem.evaluate.windows import Window
from mavdem.flight import Flight
from mavdem.forecaster import Forecaster, ProbabilisticForecaster


class Method(NamedTuple):
    """A method to compare, of a unique ``name``: ``learn`` trains a model on a flight.

    With ``predicts`` its model is also asked what comes next, the inputs unknown. To run in other processes ``learn``
    must be a module's function, or a ``partial`` of one.
    """

    name: str
    learn: Callable[[Flight], Forecaster]
    predicts: bool = False


class PredictedPart(NamedTuple):
    """What a model predicted of the test part, the inputs unknown; fields as in :class:`Outcome`."""

    mspe: Array
    skill: tuple[Skill, ...]
    inside: tuple[float | None, ...]
    forecast: Array | None = None
    band: Array | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """One method on one window; every error is infinite if it has no forecast.

    Attributes:
        method: its name.
        flight, start: of the window.
        failure: why there is no forecast; else empty.
        stable: whether the model has no growing mode; ``None`` without a model.
        cautions: of the model, and one where the error that it expects is larger than the constant mean's.
        mspe: (m,) of the forecast from the end of training, in the squares of the outputs' units.
        skill: by horizon; the last one is that of the whole test part.
        inside: by horizon k, the share of the first k samples, of all outputs, in the band of the forecast from the end
            of training; ``None`` without a band.
        mspe_from_zero, skill_from_zero: of the forecast of the whole test part that starts from state 0.
        seconds: processor time of the training.
        forecast, forecast_from_zero: (H, m); ``None`` without a forecast.
        expected: (H, m) squared error that the model expects of ``forecast``; ``None`` if it has no variance.
        band: (H, m) half width of the 90 % band about ``forecast``; or ``None``.
        predicted: the test part predicted without its inputs; ``None`` of a method that is not asked to.
    """

    method: str
    flight: str
    start: int
    failure: str
    stable: bool | None
    cautions: tuple[str, ...]
    mspe: Array
    skill: tuple[Skill, ...]
    inside: tuple[float | None, ...]
    mspe_from_zero: Array
    skill_from_zero: Skill
    seconds: float
    forecast: Array | None = None
    forecast_from_zero: Array | None = None
    expected: Array | None = None
    band: Array | None = None
    predicted: PredictedPart | None = None

    @property
    def of_prediction(self) -> Outcome:
        """The same of the prediction in place of the forecast."""
        assert self.predicted is not None
        return replace(self, **self.predicted._asdict(), expected=None, predicted=None)

    @property
    def diverged(self) -> bool:
        """Whether there is a forecast and it is infinite or NaN somewhere."""
        return not self.failure and not np.isfinite(self.mspe).all()

    def to_dict(self) -> dict[str, Any]:
        """As plain JSON values by name, without the forecasts themselves."""
        return {
            "failure": self.failure,
            "stable": self.stable,
            "cautions": list(self.cautions),
            "mspe": {"per_output": self.mspe.tolist(), "total": float(self.mspe.sum())},
            "skill": [skill_values(one) for one in self.skill],
            "inside_90_percent_band": list(self.inside),
            "from_zero": {
                "mspe": {"per_output": self.mspe_from_zero.tolist(), "total": float(self.mspe_from_zero.sum())},
                "skill": skill_values(self.skill_from_zero),
            },
            "seconds": round(self.seconds, 4),
        }


def skill_values(skill: Skill) -> dict[str, Any]:
    """A skill as plain JSON values by name."""
    return skill._asdict() | {
        "per_output": skill.per_output.tolist(),
        "relative_per_output": skill.relative_per_output.tolist(),
    }


def judge(method: Method, window: Window) -> Outcome:
    """Trains ``method`` on the first part of ``window`` and forecasts the second; failures are in the outcome."""
    began = thread_time()
    # The outcome has what numpy and scipy would warn of.
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            model = method.learn(window.train)
            return _forecast(method, window, model, thread_time() - began)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            failure = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
            return _failed(method, window, failure, thread_time() - began)


def _forecast(method: Method, window: Window, model: Forecaster, seconds: float) -> Outcome:
    train, test = window.train, window.test
    steps = horizons(len(test), test.dt)
    forecast, from_zero = model.forecast(test.inputs), model.forecast(test.inputs, from_zero=True)
    expected = band = predicted = None
    cautions = tuple(model.cautions)
    if isinstance(model, ProbabilisticForecaster):
        expected, band = model.forecast_variance(test.inputs), model.forecast_band(test.inputs)
        if (expected / train.outputs.var(axis=0)).mean() > 1:
            cautions += ("The error to expect of the forecast is larger than the constant mean's.",)
    if method.predicts:
        prediction = model.predict(len(test))
        width = model.predict_band(len(test)) if isinstance(model, ProbabilisticForecaster) else None
        predicted = PredictedPart(
            mspe(test.outputs, prediction).per_output,
            prediction_skill_by_horizon(model, train, test, steps),
            _inside(test.outputs, prediction, width, steps),
            prediction,
            width,
        )
    return Outcome(
        method.name,
        window.flight,
        window.start,
        failure="",
        stable=model.stable,
        cautions=cautions,
        mspe=mspe(test.outputs, forecast).per_output,
        skill=skill_by_horizon(model, train, test, steps),
        inside=_inside(test.outputs, forecast, band, steps),
        mspe_from_zero=mspe(test.outputs, from_zero).per_output,
        skill_from_zero=skill(train, test, from_zero, len(test)),
        forecast=forecast,
        forecast_from_zero=from_zero,
        expected=expected,
        band=band,
        predicted=predicted,
        seconds=seconds,
    )


def _inside(measured: Array, forecast: Array, band: Array | None, steps: Sequence[int]) -> tuple[float | None, ...]:
    """The share of the first k samples in the band, for each of the ``steps`` k."""
    if band is None:
        return (None,) * len(steps)
    inside = np.abs(measured - forecast) <= band
    return tuple(float(inside[:k].mean()) for k in steps)


def _failed(method: Method, window: Window, failure: str, seconds: float) -> Outcome:
    test, outputs = window.test, window.test.outputs.shape[1]
    infinite = np.full(outputs, np.inf)
    skills = tuple(Skill(steps, infinite, np.inf, infinite, np.inf) for steps in horizons(len(test), test.dt))
    inside = (None,) * len(skills)
    return Outcome(
        method.name,
        window.flight,
        window.start,
        failure=failure,
        stable=None,
        cautions=(),
        mspe=infinite,
        skill=skills,
        inside=inside,
        mspe_from_zero=infinite,
        skill_from_zero=skills[-1],
        predicted=PredictedPart(infinite, skills, inside) if method.predicts else None,
        seconds=seconds,
    )
