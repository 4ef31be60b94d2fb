"""Evaluation: how far forecasts are off, beside those that know nothing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mavdem.dem import Learned
from mavdem.flight import Flight

Array = NDArray[np.float64]


class Mspe(NamedTuple):
    """Mean squared prediction error.

    Attributes:
        per_output: (m,), each in the square of its output's unit.
        total: their sum, as the paper reports it.
    """

    per_output: Array
    total: float


def mspe(measured: ArrayLike, predicted: ArrayLike) -> Mspe:
    """Mean over samples of the squared error (the paper, ``Metric for comparison``), per output and summed.

    A prediction that is not a number errs infinitely.

    Args:
        measured, predicted: (H, m) each.

    Raises:
        ValueError: shapes that differ, or no samples.
    """
    y, yhat = np.asarray(measured, np.float64), np.asarray(predicted, np.float64)
    if y.shape != yhat.shape or y.ndim != 2 or not len(y):
        raise ValueError(f"measured and predicted must be (H, m) alike, not {y.shape} and {yhat.shape}")
    # A forecast of an unstable model may run beyond all numbers.
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (y - yhat) ** 2
    per_output = np.where(np.isnan(squares), np.inf, squares).mean(axis=0)
    return Mspe(per_output, float(per_output.sum()))


def relative_mspe(train: Flight, test: Flight, forecast: ArrayLike) -> float:
    """MSPE in units of each output's training variance, summed, over the same of the training mean.

    Below 1 the forecast is better than knowing nothing but the mean. The scaling keeps a rate, ten times its angle
    in number, from being all that counts.

    Args:
        train: what was learnt from, whose mean and variances are taken.
        test: the samples that were forecast.
        forecast: (H, m), of the H samples of ``test``.

    Raises:
        ValueError: a forecast of another shape, or an output of ``train`` that is constant.
    """
    if not np.ptp(train.outputs, axis=0).all():
        raise ValueError("train must vary in every output: errors are told in units of its variance")
    variance = train.outputs.var(axis=0)
    constant = np.broadcast_to(train.outputs.mean(axis=0), test.outputs.shape)
    ours = (mspe(test.outputs, forecast).per_output / variance).sum()
    return float(ours / (mspe(test.outputs, constant).per_output / variance).sum())


def trivial_forecasts(train: Flight, horizon: int) -> dict[str, Array]:
    """Forecasts (horizon, m) that use no model: the mean of ``train``, its last sample held, and zero."""
    shape = (horizon, train.outputs.shape[1])
    return {
        "constant mean": np.broadcast_to(train.outputs.mean(axis=0), shape),
        "hold last": np.broadcast_to(train.outputs[-1], shape),
        "zero": np.zeros(shape),
    }


def report(train: Flight, test: Flight, learned: Learned) -> dict[str, Any]:
    """The numbers of one learnt flight, as plain JSON values; angles in rad, rates in rad/s, time in s.

    Args:
        train: what was learnt from.
        test: the samples right after it, to forecast.
        learned: the model of ``train``.
    """
    forecasts = {"DEM": learned.forecast(test.inputs), **trivial_forecasts(train, len(test))}
    one_step = {
        "DEM": learned.one_step()[1:],
        "hold last": train.outputs[:-1],
        "constant mean": np.broadcast_to(train.outputs.mean(axis=0), train.outputs[1:].shape),
    }
    lower, upper = learned.forecast_band(test.inputs)
    inside = (lower <= test.outputs) & (test.outputs <= upper)
    model, sd, half_width = learned.model, learned.model_sd, learned.model_interval(0.9)
    forecast_errors = _ranked(train, test, forecasts)
    return {
        "flight": dict(train.provenance),
        "inputs": list(train.input_names),
        "outputs": list(train.output_names),
        "dt": train.dt,
        "training_samples": len(train),
        "forecast_samples": len(test),
        "order": learned.settings.order,
        "settled": learned.settled,
        "model": {name: value.tolist() for name, value in model._asdict().items()},
        "model_sd": {name: getattr(sd, name).tolist() for name in ("A", "B", "C")},
        "model_interval_90_percent": {name: getattr(half_width, name).tolist() for name in ("A", "B", "C")},
        "undetermined": len(learned.undetermined),
        "spectral_abscissa": model.spectral_abscissa,
        "free_energy": {
            "start": float(learned.free_energy[0]),
            "end": float(learned.free_energy[-1]),
            "gained": learned.free_energy.gained,
            "terms": {name: float(term[-1]) for name, term in learned.free_energy.terms.items()},
        },
        "one_step_mspe": _ranked(train, train[1:], one_step),
        "forecast_mspe": forecast_errors,
        "forecast_over_constant_mean": forecast_errors["DEM"]["relative"],
        "inside_90_percent_band": float(inside.mean()),
        "motors_share": learned.unseen.motors_share,
        "cautions": list(learned.cautions),
    }


def _ranked(train: Flight, measured: Flight, predictions: dict[str, Array]) -> dict[str, Any]:
    """The errors of each prediction by name, the best first by the relative one."""
    errors = {}
    for name, predicted in predictions.items():
        per_output, total = mspe(measured.outputs, predicted)
        relative = relative_mspe(train, measured, predicted)
        errors[name] = {"per_output": per_output.tolist(), "total": total, "relative": relative}
    return dict(sorted(errors.items(), key=lambda named: named[1]["relative"]))
