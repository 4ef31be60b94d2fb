"""The figures of one learnt vehicle, beside those of forecasts without a model."""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import Any

import numpy as np

from mavdem.dem import Learned, Physical, WindTorque
from mavdem.dem.engine.linalg import Array
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.validation import LEVEL
from mavdem.evaluate.held_out import BASELINES, CONSTANT_MEAN, FORECAST, HOLD_LAST, PREDICTION, HeldOut
from mavdem.evaluate.squared_error import error_over, mspe
from mavdem.flight import Flight

DEM = "DEM"  # the name of the model's own forecasts, beside the baselines
HALF = 0.5  # of an output's variance: up to the horizon at which the expected squared error reaches it


def report(flights: Sequence[Flight], learned: Learned, held_out: HeldOut) -> dict[str, Any]:
    """The figures of one learnt vehicle, as plain JSON values; angles in rad, rates in rad/s, time in s.

    ``learned`` is the model of the training data ``flights``; ``held_out`` are windows that its like, or it itself, has
    forecast without having seen them.
    """
    first, measured = flights[0], learned.record.outputs
    after_first = np.setdiff1d(np.arange(len(measured)), learned.record.starts)
    before = after_first - 1
    one_step = {
        DEM: learned.one_step()[after_first],
        HOLD_LAST: measured[before],
        CONSTANT_MEAN: np.broadcast_to(measured.mean(axis=0), measured[after_first].shape),
    }
    variance = measured.var(axis=0)
    model, sd, half_width = learned.model, learned.model_sd, learned.model_interval(LEVEL)
    expected = float((held_out.expected / held_out.variance).mean())
    names = {FORECAST: DEM, **{name: name for name in BASELINES}}
    forecast_errors = _ranked(
        {names[name]: held_out.squared_errors(name).mean(axis=0) for name in names}, held_out.variance
    )
    return {
        "flight": dict(first.provenance),
        "segments": [{"start": float(one.time[0]), "samples": len(one)} for one in flights],
        "inputs": list(first.input_names),
        "outputs": list(first.output_names),
        "dt": first.dt,
        "training_samples": len(measured),
        "forecast_samples": held_out.time.shape[1],
        "order": learned.settings.order,
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
        "held_out": held_out.as_dict(),
        "one_step_mspe": _ranked(
            {name: mspe(measured[after_first], predicted).per_output for name, predicted in one_step.items()}, variance
        ),
        "forecast_mspe": forecast_errors,
        "forecast_over_constant_mean": forecast_errors[DEM]["relative"],
        "expected_error": expected,
        "inside_90_percent_band": held_out.coverage,
        "prediction": {
            "half_explained_seconds": (learned.prediction.useful_steps(HALF) * first.dt).tolist(),
            "error_ratio": held_out.error_ratio(PREDICTION),
        },
        "simulation_fit": _simulation_fit(learned.simulation_fit),
        "physical": physical_values(learned.physical),
        "wind": wind_values(learned.wind),
        "closed_loop": None,
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
        "converged": fit.settled,
        "numbers": fit.numbers,
        "parameters": len(fit.places),
        "turning": None if turning is None else turning.tolist(),
        "terms": {name: float(term[-1]) for name, term in fit.terms.items()},
    }


def _ranked(errors: dict[str, Array], variance: Array) -> dict[str, Any]:
    """Mean squared errors (m,) by name, with the ratio to the constant mean's, the lowest first."""
    sizes = {name: float((each / variance).sum()) for name, each in errors.items()}
    found = {
        name: {
            "per_output": each.tolist(),
            "total": float(each.sum()),
            "relative": float(error_over(sizes[name], sizes[CONSTANT_MEAN])),
        }
        for name, each in errors.items()
    }
    return dict(sorted(found.items(), key=lambda named: named[1]["relative"]))
