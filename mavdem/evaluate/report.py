"""The report of one learnt flight: its numbers beside those of forecasts that know nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.dem import Learned, Physical
from mavdem.dem.choice import Candidate
from mavdem.dem.trajectory import Trajectory
from mavdem.evaluate.mspe import mspe, relative_mspe
from mavdem.flight import Flight

Array = NDArray[np.float64]


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
    expected = learned.forecast_variance(test.inputs).mean(axis=0) / train.outputs.var(axis=0)
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
        "expected_error": float(expected.mean()),
        "inside_90_percent_band": float(inside.mean()),
        "trajectories": _climbed(learned.trajectory),
        "physical": _physical(learned.physical),
        "candidates": [_candidate(each) for each in learned.candidates],
        "motors_share": learned.unseen.motors_share,
        "cautions": list(learned.cautions),
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    """What was tried, and how it forecast inside the training data; nothing where it broke down."""
    return {**vars(candidate), "error": candidate.error if np.isfinite(candidate.error) else None}


def _physical(read: Physical | None) -> dict[str, Any] | None:
    """What motors, damping and lag are; no intervals where they cannot be told."""
    if read is None:
        return None
    motors, damping, lag = read.interval(0.9)
    return {
        "motors": read.motors.tolist(),
        "damping": read.damping,
        "lag": read.lag,
        "delay": read.delay,
        "interval_90_percent": {"motors": motors.tolist(), "damping": damping, "lag": lag} if read.told else None,
        "wind": read.wind,
        "wind_share": read.wind_share,
        "caution": read.caution,
    }


def _climbed(trajectory: Trajectory | None) -> dict[str, Any] | None:
    """How θ climbed on along trajectories."""
    if trajectory is None:
        return None
    turning = None if trajectory.layout is None else trajectory.layout.turning
    return {
        "samples": trajectory.horizon,
        "settled": trajectory.settled,
        "numbers": trajectory.numbers,
        "parameters": len(trajectory.places),
        "turning": None if turning is None else turning.tolist(),
        "terms": {name: float(term[-1]) for name, term in trajectory.terms.items()},
    }


def _ranked(train: Flight, measured: Flight, predictions: dict[str, Array]) -> dict[str, Any]:
    """The errors of each prediction by name, the best first by the relative one."""
    errors = {}
    for name, predicted in predictions.items():
        per_output, total = mspe(measured.outputs, predicted)
        relative = relative_mspe(train, measured, predicted)
        errors[name] = {"per_output": per_output.tolist(), "total": total, "relative": relative}
    return dict(sorted(errors.items(), key=lambda named: named[1]["relative"]))
