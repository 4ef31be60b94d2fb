"""Figures: what is known of a flight, as one record and as one dictionary of plain values.

``LogAnalysis`` holds what a log says of one vehicle and axis. Its ``as_dict`` is the document that ``report.json``
is, that pages and fleets read, and that scripts hold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

from mavdem.arrays import Array
from mavdem.assessment.axis.findings import Findings, findings_of
from mavdem.assessment.axis.gains import with_one_set_of_gains
from mavdem.assessment.condition import Condition
from mavdem.assessment.inventory import Identity, Tier
from mavdem.containers import JsonValues
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.learnability import Learnability
from mavdem.dataset.signals import Signals
from mavdem.dem import Learned
from mavdem.dem.record import Record
from mavdem.errors import NotLearnable
from mavdem.experiments.held_out import (
    BASELINES,
    CONSTANT_MEAN,
    FORECAST,
    PREDICTION,
    HeldOut,
)
from mavdem.experiments.scores import error_over
from mavdem.experiments.truth import TruthComparison
from mavdem.facts import Fact
from mavdem.facts.forecasts import HeldOutForecast, MethodName
from mavdem.facts.identifiability import Status
from mavdem.flight import Flights
from mavdem.ingest import Component
from mavdem.loops.identification import identify_plant_in_loop
from mavdem.motors.loss_detection import MotorAlarm, alarm_figures
from mavdem.plant import NotIdentifiable, Physical, WindTorque, physical
from mavdem.plant.wind_torque import estimate_wind_torque

ALL = "all"  # of an axis: roll, pitch and yaw


class AxisFigures(NamedTuple):
    """One axis: all its settled ``flights``, ``physical`` parameters, ``wind`` torque; ``reason``: why none."""

    flights: Flights
    physical: Physical | None
    wind: WindTorque | None
    reason: Fact | None


@dataclass(frozen=True, eq=False)
class LogAnalysis:
    """One vehicle and axis of a log.

    Attributes:
        learnability: whether a full model of the axis can be learned, on which segment, and its figures.
        tier: what the log allows, why no more, and what the next tier needs.
        condition: balance, limits, lean, vibration and battery, at any rate.
        identity: which vehicle, and when.
        axes: of ``axis="all"`` the physical parameters of each axis.
        reason: why there is no full model; ``None`` where there is one.
        flights, learned, held_out: what was trained on; the model, in tier "b" of the slow motion and without physical
            parameters; forecasts of windows that no model saw.
        truth: the estimates beside the truth of a simulated flight, where its file was given.
        alarms: lasting changes of the motors' balance in flight, as a live session would have found them.
        trim: how even the motors work; None without their outputs.
        watched: whether a motor that weakens would have been seen.
    """

    learnability: Learnability
    tier: Tier
    condition: Condition
    identity: Identity
    reason: Fact | None = None
    axes: Mapping[str, AxisFigures] = field(default_factory=dict)
    flights: Flights = ()
    learned: Learned | None = None
    held_out: HeldOut | None = None
    truth: TruthComparison | None = None
    alarms: tuple[MotorAlarm, ...] = ()
    trim: Fact | None = None
    watched: bool = False

    @property
    def axis_figures(self) -> Mapping[str, AxisFigures]:
        """The physical parameters of each axis that they were estimated of, with the model or for all axes."""
        if self.axes or self.learned is None:
            return self.axes
        return {
            self.learnability.axis: AxisFigures(
                self.flights,
                self.learned.physical,
                self.learned.wind_torque,
                self.learned.physical_reason,
            )
        }

    @property
    def model(self) -> str | None:
        """Which model can be learned: "full", "slow motion", or None."""
        if self.learnability.learnable:
            return "full"
        return None if self.learned is None else "slow motion"

    @property
    def changes(self) -> list[float]:
        """When a motor changed in flight and so the vehicle, s."""
        return [alarm.since for alarm in self.alarms if alarm.motor is not None]

    @cached_property
    def findings(self) -> Findings:
        """What makes the flight doubtful, and what the model is good for: made once, shown everywhere."""
        # Rates that are sent slowly say nothing of the angle.
        consistency = self.learnability.figures.consistency if self.model == "full" else None
        return findings_of(
            self.learned, self.held_out, self.condition, self.alarms, consistency, self.trim
        )

    def as_dict(self) -> JsonValues:
        """Returns all figures as plain JSON values: what ``report.json`` has.

        Angles in rad, rates in rad/s, time in s. Without a model its figures are missing.
        """
        learned = self.learned
        held_out = self.held_out
        figures = {}
        if learned is not None and held_out is not None:
            figures = model_figures(self.flights, learned, held_out)
        return {
            **figures,
            "axes": self.axes,
            "hover": self.condition.hover,
            **self.tier._asdict(),
            "reason": self.reason,
            "remedy": self.reason and self.reason.remedy,
            "condition": self.condition,
            "identity": self.identity,
            **alarm_figures(self.alarms),
            **self.findings._asdict(),
            "truth": self.truth,
            "settings": None if learned is None else asdict(learned.settings),
            "verdict": self.learnability,
        }


def model_figures(flights: Flights, learned: Learned, held_out: HeldOut) -> JsonValues:
    """Returns the figures of a model of ``flights``, judged by ``held_out`` windows, as JSON values: rad, rad/s, s."""
    first = flights[0]
    fit = learned.simulation_fit
    names = dict[StrEnum, HeldOutForecast]({MethodName.JOINT: FORECAST})
    names |= {name: name for name in BASELINES}
    ranked = _ranked(
        {name: held_out.squared_errors(of).mean(axis=0) for name, of in names.items()},
        held_out.variance,
    )
    model = learned.model
    energy = learned.free_energy
    joint = learned.joint
    return {
        "flight": first.provenance,
        "segments": [{"start": flight.time[0], "samples": len(flight)} for flight in flights],
        "inputs": first.input_names,
        "outputs": first.output_names,
        "dt": first.dt,
        "training_samples": len(learned.record.outputs),
        "forecast_samples": held_out.time.shape[1],
        "order": learned.settings.order,
        "converged": learned.converged,
        "model": model,
        "model_interval_90_percent": learned.model_interval(),
        "spectral_abscissa": model.spectral_abscissa,
        "free_energy": {
            "start": energy[0],
            "end": energy[-1],
            "gained": energy.gained,
            "terms": {name: term[-1] for name, term in energy.terms.items()},
        },
        "held_out": held_out,
        "forecast_mspe": ranked,
        "forecast_over_constant_mean": ranked[MethodName.JOINT]["relative"],
        "expected_error": (held_out.expected / held_out.variance).mean(),
        "inside_90_percent_band": held_out.coverage,
        "prediction": {
            "half_explained_seconds": learned.useful_steps * first.dt,
            "error_ratio": held_out.error_ratio(PREDICTION),
        },
        "simulation_fit": None
        if fit is None
        else {
            "samples": fit.horizon,
            "converged": fit.converged,
            "numbers": fit.effective_samples,
            "parameters": len(fit.free),
            "turning": joint.mixer[:, 0],
            "terms": {name: term[-1] for name, term in fit.terms.items()},
        },
        "joint": {
            "lags": joint.hyperparameters.lags,
            "prior_precision": joint.hyperparameters.ridge,
            "combinations": joint.mixer.T,
            "spectral_radius": joint.process.spectral_radius,
            "free_energy": joint.terms,
        },
        "physical": learned.physical,
        "wind": learned.wind_torque,
        "cautions": learned.cautions,
    }


def _ranked(errors: Mapping[StrEnum, Array], variance: Array) -> dict[StrEnum, JsonValues]:
    """Mean squared errors (m,) by name, with the ratio to the constant mean's, the lowest first."""
    shares = {name: (error / variance).sum() for name, error in errors.items()}
    ratios = {
        name: float(error_over(share, shares[CONSTANT_MEAN])) for name, share in shares.items()
    }
    return {
        name: {"per_output": errors[name], "total": errors[name].sum(), "relative": ratio}
        for name, ratio in sorted(ratios.items(), key=lambda named: named[1])
    }


def physical_of(signals: Signals, flights: Flights) -> Physical | NotIdentifiable:
    """Returns the physical parameters of the axis of ``signals`` in ``flights``, or why there are none.

    They are those that inputs and outputs alone tell where they tell them without a bias, by motor and in narrower
    intervals; else, or where its loop makes them doubtful, those of the plant in its loop where it is found.
    """
    alone = physical(flights)
    is_sure = isinstance(alone, Physical) and alone.identifiable and not alone.bias
    try:
        in_loop = identify_plant_in_loop(signals, with_one_set_of_gains(signals, flights)[0])
    except NotLearnable as error:
        return alone if is_sure else alone._replace(refusal=error.fact)
    return alone if is_sure and in_loop.status["effect"] is Status.REPORTED else in_loop


def axis_figures(
    signals: Signals, components: tuple[Component, ...], changes: Sequence[float]
) -> AxisFigures:
    """Returns the physical parameters of the axis of ``signals``; the torque is cut at ``changes``, s, of a motor."""
    flights, learnability = usable_segments(signals, components)
    if not flights:
        return AxisFigures((), None, None, learnability.reason)
    record = Record.from_flights(flights)
    parameters = physical_of(signals, flights)
    if isinstance(parameters, NotIdentifiable):
        return AxisFigures(flights, None, None, parameters.reason)
    try:
        return AxisFigures(
            flights, parameters, estimate_wind_torque(parameters, record, changes), None
        )
    except ValueError:  # LinAlgError is one
        return AxisFigures(flights, parameters, None, None)
