"""The figures of one learnt flight, beside those of forecasts without a model."""

from __future__ import annotations

from math import isnan
from typing import Any

import numpy as np

from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.engine.linalg import Array
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.validation import LEVEL
from mavdem.evaluate.squared_error import mspe, relative_mspe
from mavdem.flight import Flight

HALF = 0.5  # of an output's variance: up to the horizon at which the expected squared error reaches it


def trivial_forecasts(train: Flight, horizon: int) -> dict[str, Array]:
    """Forecasts (horizon, m) without a model: the mean of ``train``, its last sample held, and zero."""
    shape = (horizon, train.outputs.shape[1])
    return {
        "constant mean": np.broadcast_to(train.outputs.mean(axis=0), shape),
        "hold last": np.broadcast_to(train.outputs[-1], shape),
        "zero": np.zeros(shape),
    }


def report(train: Flight, test: Flight, learned: Learned) -> dict[str, Any]:
    """The figures of one learnt flight, as plain JSON values; angles in rad, rates in rad/s, time in s.

    ``learned`` is the model of the training data ``train``; ``test`` is the held-out test set, right after these.
    """
    forecasts = {"DEM": learned.forecast(test.inputs), **trivial_forecasts(train, len(test))}
    one_step = {
        "DEM": learned.one_step()[1:],
        "hold last": train.outputs[:-1],
        "constant mean": np.broadcast_to(train.outputs.mean(axis=0), train.outputs[1:].shape),
    }
    inside = np.abs(test.outputs - forecasts["DEM"]) <= learned.forecast_band(test.inputs)
    model, sd, half_width = learned.model, learned.model_sd, learned.model_interval(LEVEL)
    forecast_errors = _ranked(train, test, forecasts)
    expected = learned.forecast_variance(test.inputs).mean(axis=0) / train.outputs.var(axis=0)
    return {
        "flight": dict(train.provenance),
        "inputs": list(train.input_names),
        "outputs": list(train.output_names),
        "dt": train.dt,
        "training_samples": len(train),
        "forecast_samples": len(test),
        "order": learned.settings.order,
        "settled": learned.converged,
        "converged": learned.converged,
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
        "expected_error": float(expected.mean()),
        "inside_90_percent_band": float(inside.mean()),
        "prediction": {
            "half_explained_seconds": (learned.prediction.useful_steps(HALF) * train.dt).tolist(),
            "error_ratio": relative_mspe(train, test, learned.predict(len(test))),
        },
        "trajectories": _simulation_fit(learned.simulation_fit),
        "physical": physical_values(learned.physical),
        "wind": wind_values(learned.wind),
        "motors_share": learned.training_forecasts.motors_share,
        "cautions": list(learned.cautions),
    }


def physical_values(read: Physical | None) -> dict[str, Any] | None:
    """Effect, damping and lag with status and reason; no interval of what is not identifiable."""
    if read is None:
        return None
    effect, *others = read.interval(LEVEL)
    halves = {
        name: None if isnan(half) else half for name, half in zip(("damping", "lag", "delay"), others, strict=True)
    }
    return {
        "effect": read.effect.tolist(),
        "damping": read.damping,
        "lag": read.lag,
        "delay": read.delay,
        "interval_90_percent": {"effect": None if np.isnan(effect).any() else effect.tolist(), **halves},
        "status": read.status,
        "reasons": read.reasons,
        "bias": read.bias,
        "wind": read.wind,
        "wind_share": read.wind_share,
        "refinements": read.refinements,
        "windows": {name: column.tolist() for name, column in read.windows._asdict().items()},
    }


def wind_values(found: WindTorque | None) -> dict[str, Any] | None:
    """The wind's torque as numbers, rad/s²; ``None`` for shares that are not known."""
    if found is None:
        return None
    return {
        "mean": found.mean,
        "mean_band": found.mean_band,
        "sd": found.sd,
        "scale_error": found.scale_error,
        "resolved": found.resolved,
        "reason": found.reason,
        "answered": _or_none(found.answered),
        "answered_below_1_hz": _or_none(found.answered_slow),
        "gusts": [gust._asdict() for gust in found.gusts],
        "gust_threshold": found.gust_threshold,
        "false_gusts_per_minute": found.false_gusts_per_minute,
        "spectrum": {name: values.tolist() for name, values in found.spectrum._asdict().items()},
    }


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _simulation_fit(fit: SimulationFit | None) -> dict[str, Any] | None:
    """The simulation-error fit: its horizon, effective sample size, mixer geometry and terms."""
    if fit is None:
        return None
    turning = None if fit.layout is None else fit.layout.turning
    return {
        "samples": fit.horizon,
        "settled": fit.settled,
        "numbers": fit.numbers,
        "parameters": len(fit.places),
        "turning": None if turning is None else turning.tolist(),
        "terms": {name: float(term[-1]) for name, term in fit.terms.items()},
    }


def _ranked(train: Flight, measured: Flight, predictions: dict[str, Array]) -> dict[str, Any]:
    """The errors of each prediction by name, the lowest error ratio first."""
    errors = {}
    for name, predicted in predictions.items():
        per_output, total = mspe(measured.outputs, predicted)
        relative = relative_mspe(train, measured, predicted)
        errors[name] = {"per_output": per_output.tolist(), "total": total, "relative": relative}
    return dict(sorted(errors.items(), key=lambda named: named[1]["relative"]))
