"""The mean squared prediction error (MSPE), and the error ratio to the constant mean, also by horizon.

A test part of H samples is forecast in pieces of k steps: at every k-th sample a forecast starts from all data before
it. So each sample counts once at every horizon, forecasts do not overlap, the error is the mean *up to* the k-th step,
and the constant mean's error is the same at all horizons. k = H is the MSPE of the one forecast from the end of
training.

The error *at* the k-th step of that one forecast would be a single sample of each window. Forecasts from every sample
would count a sample in the middle k times and those at the ends once, with hardly more information, because
neighbouring errors are correlated.

A method, and its outcome on one window.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import thread_time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mavdem.dem.engine.linalg import Array
from mavdem.evaluate.windows import Window
from mavdem.flight import Flight
from mavdem.forecaster import Forecaster, ProbabilisticForecaster

HORIZONS = (1, 5, 10, 25, 50, 150)
"""Steps; the last is the paper's."""

USUAL_RATE, FAST = 100.0, 125.0
"""Hz: the rate of these steps, and the rate above which they last as long as at ``USUAL_RATE``."""


class Mspe(NamedTuple):
    """Mean squared prediction error: ``per_output`` (m,) in the squares of their units, and ``total``, their sum."""

    per_output: Array
    total: float


def mspe(measured: ArrayLike, predicted: ArrayLike) -> Mspe:
    """Mean over samples of the squared error (the paper, ``Metric for comparison``), per output and summed.

    ``measured`` and ``predicted`` are (H, m) each. A prediction that is NaN has an infinite error.

    Raises:
        ValueError: shapes that differ, or no samples.
    """
    per_output = squared_errors(measured, predicted).mean(axis=0)
    return Mspe(per_output, float(per_output.sum()))


def squared_errors(measured: ArrayLike, predicted: ArrayLike) -> Array:
    """(H, m): squared errors of samples ``measured`` and ``predicted``, (H, m); infinite where the latter are NaN.

    Raises:
        ValueError: shapes that differ, or no samples.
    """
    y, yhat = np.asarray(measured, np.float64), np.asarray(predicted, np.float64)
    if y.shape != yhat.shape or y.ndim != 2 or not len(y):
        raise ValueError(f"measured and predicted must be (H, m) alike, not {y.shape} and {yhat.shape}")
    # The forecast of an unstable model may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (y - yhat) ** 2
    return np.where(np.isnan(squares), np.inf, squares)


def horizons(samples: int, dt: float) -> tuple[int, ...]:
    """The horizons, in steps, of a test part of ``samples``: those of ``HORIZONS`` that are shorter, and all of it.

    Above 125 Hz, by the sampling step ``dt`` in s, they last as long as at 100 Hz.
    """
    shorter = [steps for steps in (_usual_steps(usual, dt) for usual in HORIZONS) if steps < samples]
    return (*shorter, samples)


def _usual_steps(usual: int, dt: float) -> int:
    return usual if dt >= 1 / FAST else round(usual / USUAL_RATE / dt)


class Skill(NamedTuple):
    """The error of forecasts of so many steps; an output's is in units of its training variance.

    Attributes:
        steps: k, the length of each forecast.
        per_output: (m,) MSPE over training variance.
        total: their sum.
        relative_per_output: (m,) over the same of the constant mean of the training data.
        relative: the total over the constant mean's, the error ratio: below 1 is better than the constant mean. The
            skill score is one minus this.
    """

    steps: int
    per_output: Array
    total: float
    relative_per_output: Array
    relative: float


def skill(train: Flight, test: Flight, predicted: ArrayLike, steps: int) -> Skill:
    """The error of ``predicted`` (H, m), forecasts of ``test`` in pieces of ``steps``, beside the constant mean.

    Mean and variances are those of the training data, ``train``.

    Raises:
        ValueError: predictions of another shape, or an output of ``train`` that is constant.
    """
    if not np.ptp(train.outputs, axis=0).all():
        raise ValueError("train must vary in every output: errors are in units of its variance")
    # In these units lest a rate, ten times its angle, dominate.
    variance = train.outputs.var(axis=0)
    ours = mspe(test.outputs, predicted).per_output / variance
    constant = mspe(test.outputs, np.broadcast_to(train.outputs.mean(axis=0), test.outputs.shape)).per_output / variance
    return Skill(
        steps, ours, float(ours.sum()), error_over(ours, constant), float(error_over(ours.sum(), constant.sum()))
    )


def error_over(ours: ArrayLike, theirs: ArrayLike) -> Array:
    """The ratio of errors, ``ours`` over ``theirs``; 1 if both are the same, also 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.equal(ours, theirs), 1.0, np.divide(ours, theirs))


def skill_by_horizon(
    forecaster: Forecaster, train: Flight, test: Flight, horizons: Sequence[int] = HORIZONS
) -> tuple[Skill, ...]:
    """The skill at each horizon of a fixed model, whose filter uses every sample before each forecast.

    ``forecaster`` is the model of ``train``; ``test`` are the samples right after that. ``horizons`` are in steps; one
    longer than ``test`` is cut to its length.

    Raises:
        ValueError: a horizon below 1, or as :func:`skill`.
    """
    return tuple(
        skill(train, test, forecaster.forecast_every(steps, test.inputs, test.outputs), steps) for steps in horizons
    )


def prediction_skill_by_horizon(
    forecaster: Forecaster, train: Flight, test: Flight, horizons: Sequence[int] = HORIZONS
) -> tuple[Skill, ...]:
    """As :func:`skill_by_horizon`, of predictions that do not know the inputs of the time that they predict.

    Arguments are the same: ``forecaster``, ``train``, ``test`` and ``horizons``.

    Raises:
        ValueError: the model needs the inputs; or as :func:`skill_by_horizon`.
    """
    return tuple(
        skill(train, test, forecaster.predict_every(steps, test.inputs, test.outputs), steps) for steps in horizons
    )


def relative_mspe(train: Flight, test: Flight, forecast: ArrayLike) -> float:
    """The error ratio: MSPE in units of each output's training variance, summed, over that of the training mean.

    Below 1 the forecast is better than the mean.

    Args:
        train: the training data, for mean and variances.
        test: the samples that are forecast.
        forecast: (H, m), of the H samples of ``test``.

    Raises:
        ValueError: a forecast of another shape, or an output of ``train`` that is constant.
    """
    return skill(train, test, forecast, len(test)).relative


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
