"""Figures: what is known of a flight, as one record and as one dictionary of plain values.

``LogAnalysis`` holds what a log says of one vehicle and axis. ``figures`` makes of it the document that ``report.json``
is, that pages and fleets read, and that scripts hold. ``vehicle`` has the physical parameters of all axes in one call.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import isnan
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from mavdem.alignment.drive import AXES
from mavdem.alignment.read import learnable_segments
from mavdem.alignment.verdict import Verdict
from mavdem.analysis.findings import Finding
from mavdem.condition import Condition, Identity
from mavdem.condition.hover import HoverFigures, hover_of_log
from mavdem.condition.inventory import Tier
from mavdem.dem import Learned, Physical, WindTorque, physical
from mavdem.dem.engine.linalg import Array
from mavdem.dem.forecast.simulation_error import SimulationFit
from mavdem.dem.graybox.wind import wind
from mavdem.dem.record import Record
from mavdem.dem.validation import LEVEL
from mavdem.errors import NotLearnable
from mavdem.evaluate.held_out import BASELINES, CONSTANT_MEAN, FORECAST, HOLD_LAST, PREDICTION, HeldOut
from mavdem.evaluate.scores import error_over, mspe
from mavdem.evaluate.truth import TruthComparison
from mavdem.flight import Flight
from mavdem.health.motor_watch import MotorAlarm, alarm_figures
from mavdem.ingest import Log, read_log

DEM = "DEM"  # the name of the model's own forecasts, beside the baselines
HALF = 0.5  # of an output's variance: up to the horizon at which the expected squared error reaches it


class AxisFigures(NamedTuple):
    """One axis, from all its settled flight.

    Attributes:
        flights: its segments; none where there is a ``reason``.
        physical: effect of each motor, damping and lag, with the status of each.
        wind: its torque.
        reason: why there are no physical parameters; empty where there are.
    """

    flights: tuple[Flight, ...]
    physical: Physical | None
    wind: WindTorque | None
    reason: str


class VehicleFigures(NamedTuple):
    """All that was asked of a vehicle.

    Attributes:
        axes: figures by name of axis.
        hover: trim, imbalance and headroom of each motor; ``None`` where no settled flight has motor outputs.
    """

    axes: dict[str, AxisFigures]
    hover: HoverFigures | None

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        axes = {
            name: {"physical": physical_values(own.physical), "wind": wind_values(own.wind), "reason": own.reason}
            for name, own in self.axes.items()
        }
        return {"axes": axes, "hover": None if self.hover is None else self.hover.as_dict()}


@dataclass(frozen=True, eq=False)
class LogAnalysis:
    """One vehicle and axis of a log.

    Attributes:
        verdict: whether a full model of the axis can be learnt, on which segment, and its figures.
        tier: what the log allows, why no more, and what the next tier needs.
        condition: balance, limits, lean, vibration and battery, at any rate.
        identity: which vehicle, and when.
        vehicle: how hard each motor works; of ``axis="all"`` also the physical parameters of each axis.
        reason, remedy: why there is no full model, and what to change; empty where there is one.
        flights: what was learnt from; empty without a model.
        learned: the model: in tier "b" of the slow motion, and without physical parameters; None where there is none.
        held_out: forecasts of windows that no model saw; None without a model.
        findings: what the model is good for, purpose by purpose.
        truth: the estimates beside the truth of a simulated flight, where its file was given.
        alarms: lasting changes of the motors' balance in flight, as a live session would have found them; those
            without a motor are no alarms.
    """

    verdict: Verdict
    tier: Tier
    condition: Condition
    identity: Identity
    vehicle: VehicleFigures
    reason: str = ""
    remedy: str = ""
    flights: tuple[Flight, ...] = ()
    learned: Learned | None = None
    held_out: HeldOut | None = None
    findings: tuple[Finding, ...] = ()
    truth: TruthComparison | None = None
    alarms: tuple[MotorAlarm, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Returns :func:`figures` of it."""
        return figures(self)


def figures(analysis: LogAnalysis) -> dict[str, Any]:
    """Returns all figures of one vehicle and axis as plain JSON values: what ``report.json`` has.

    Angles in rad, rates in rad/s, time in s. Without a model its figures are missing.
    """
    learned, held_out = analysis.learned, analysis.held_out
    model = {} if learned is None or held_out is None else model_figures(analysis.flights, learned, held_out)
    return {
        **model,
        **analysis.vehicle.as_dict(),
        **analysis.tier.as_dict(),
        "reason": analysis.reason,
        "remedy": analysis.remedy,
        "condition": analysis.condition.as_dict(),
        "identity": analysis.identity.as_dict(),
        **alarm_figures(analysis.alarms),
        "findings": [finding._asdict() for finding in analysis.findings],
        "truth": None if analysis.truth is None else analysis.truth.as_dict(),
        "settings": None if learned is None else asdict(learned.settings),
        "verdict": analysis.verdict.as_dict(),
    }


def model_figures(flights: Sequence[Flight], learned: Learned, held_out: HeldOut) -> dict[str, Any]:
    """Returns the figures of one model, as plain JSON values; angles in rad, rates in rad/s, time in s.

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


ALL = "all"


def vehicle(path: str | bytes | PathLike[str], axis: str = ALL, vehicle: str | None = None) -> VehicleFigures:
    """Roll, pitch and yaw of a log in one call, or one of them; yaw by its rate only.

    Args:
        path: a log that ``mavdem.ingest.read_log`` reads.
        axis: "all", "roll", "pitch" or "yaw".
        vehicle: "system" or "system:component", where the log holds several.

    Raises:
        Unreadable: the log cannot be read.
        NotLearnable: it holds no vehicle, or several and none was chosen.
        ValueError: ``path`` is no path, or an axis that is none.
    """
    if axis not in (*AXES, ALL):
        raise ValueError(f"axis must be one of {', '.join((*AXES, ALL))}, not {axis!r}")
    return vehicle_of_log(read_log(path), AXES if axis == ALL else (axis,), vehicle)


def vehicle_of_log(
    log: Log,
    names: Sequence[str],
    vehicle: str | None = None,
    inputs: str | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> VehicleFigures:
    """As :func:`vehicle`, of these axes of a log that is read; ``progress`` is called with the share of them done."""
    axes = {}
    for done, name in enumerate(names, start=1):
        axes[name] = _axis(log, name, vehicle, inputs)
        progress(done / len(names))
    try:
        figures = hover_of_log(log, vehicle)
    except NotLearnable:
        figures = None
    return VehicleFigures(axes, figures)


def _axis(log: Log, axis: str, vehicle: str | None, inputs: str | None) -> AxisFigures:
    try:
        flights, _ = learnable_segments(log, axis, vehicle, inputs)
    except NotLearnable as error:
        return AxisFigures((), None, None, str(error))
    record = Record.of(flights)
    try:
        found = physical(record)
    except ValueError as error:
        return AxisFigures(flights, None, None, f"{str(error)[:1].upper()}{str(error)[1:]}.")
    try:
        return AxisFigures(flights, found, wind(found, record), "")
    except ValueError:  # LinAlgError is one
        return AxisFigures(flights, found, None, "")
