"""Figures of one vehicle and axis: a record of all that a log shows of them, and the same as a JSON document.

``LogAnalysis`` is the record. Its ``report_values`` are the document of a model, as ``report.json`` and fleets have it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.assessment.axis.findings import Findings, model_findings
from mavdem.assessment.axis.gains import sections_with_one_gain_set
from mavdem.assessment.condition import Condition
from mavdem.assessment.identity import Identity
from mavdem.assessment.tier import Tier
from mavdem.containers import JsonValues
from mavdem.dataset.flights import usable_segments
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.segment_learnability import Learnability
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
from mavdem.facts import Fact, Level
from mavdem.facts.forecasts import HeldOutForecast, MethodName
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ParameterDoubt
from mavdem.flight import Flights, boot_number
from mavdem.ingest import Component
from mavdem.loops.identification import identify_plant_in_loop
from mavdem.motors.motor_changes import MAX_ONSET_ERROR, MotorChange, alarm_figures
from mavdem.plant import NotIdentifiable, Physical, WindTorque, physical
from mavdem.plant.wind_torque import estimate_wind_torque, resolved_wind_torque

ALL_AXES = "all"
"""Name for roll, pitch and yaw together, in place of the name of one axis."""


class MotorChanges(NamedTuple):
    """Samples of T samples of flight at which the motors, and with them the vehicle, changed."""

    samples: list[int]
    """Samples at which a motor lost thrust or recovered, ascending."""
    has_weak_motor: Flags
    """Whether a motor had lost thrust (T,): what it lacked is not the wind's torque."""

    def checked_parameters(self, plant: Physical) -> Physical:
        """Marks the physical parameters of a flight as biased if a motor lost or regained thrust within it.

        A motor has one effect before it lost thrust and another one after, and the fit has one for the whole flight.
        Damping and lag get no better status than the effect, because a fit compensates a wrong effect by a wrong lag.

        Args:
            plant: parameters that were estimated from all T samples.

        Returns:
            The parameters; unchanged if no motor changed, or if the effect is not reported anyway.
        """
        has_motor_changed = bool(self.samples)
        if not has_motor_changed or plant.status["effect"] is not Status.REPORTED:
            return plant
        statuses = dict(plant.status)
        reasons = dict(plant.reasons)
        statuses["effect"] = Status.BIASED
        reasons["effect"] = Fact(ParameterDoubt.MOTOR_CHANGED, Level.WATCH)
        for name in ("damping", "lag"):
            if statuses[name] is Status.REPORTED:
                statuses[name] = Status.BIASED
                reasons[name] = Fact(
                    ParameterDoubt.FOLLOWS_FROM_EFFECT, Level.WATCH, status=Status.BIASED
                )
        return plant._replace(status=statuses, reasons=reasons)


@dataclass(frozen=True, eq=False)
class AxisEstimates:
    """Physical parameters of one axis, and its wind torque, which is estimated when it is first read."""

    flights: Flights
    """All settled flight of the axis."""
    physical: Physical | None
    """Physical parameters; None if they are not identifiable."""
    reason: Fact | None
    """Why there are no physical parameters; None if there are."""
    motor_changes: MotorChanges | None = None
    """The changes of the motors in these flights, between which the wind torque is estimated; None without one."""
    model: Learned | None = None
    """The model of the axis, whose wind torque is the one of the axis; None without a model."""

    @cached_property
    def wind(self) -> WindTorque | None:
        """Wind torque of the axis in rad/s², with its uncertainty; None if it could not be estimated.

        The wind torque is the angular acceleration that neither the motors nor the damping explain. It is taken from
        the linear model if there is one, and otherwise estimated from the physical parameters. It is computed when it
        is first read, since only some of the outputs show it and it takes a twentieth of the time of a review.
        """
        if self.model is not None:
            return self.model.wind_torque
        if self.physical is None or self.motor_changes is None:
            return None
        record = Record.from_flights(self.flights)
        try:
            return estimate_wind_torque(self.physical, record, *self.motor_changes)
        except ValueError:
            # NumPy's LinAlgError is a ValueError.
            return None

    @property
    def resolved_wind(self) -> WindTorque | None:
        """The wind torque, if it is larger than its errors and the motors' effectiveness is identifiable."""
        return resolved_wind_torque(self.wind, self.physical)


def motor_changes(alarms: Sequence[MotorChange], flights: Flights) -> MotorChanges:
    """Finds the samples at which a motor lost or recovered thrust, and those in which a motor was weak.

    A loss lasts until the same motor recovers. Its interval is extended a little at both ends, since the times of
    alarms may be wrong by as much. Alarms of other boots than the flights' are ignored.

    Args:
        alarms: changes of the motors' thrust, each with the boot on whose clock its times are.
        flights: flights with T samples in all, one after another.

    Returns:
        Ascending indices of the samples at which a motor changed, and flags (T,) whether some motor was weak.
    """
    change_samples = set[int]()
    weak_flags_of_flights = []
    # Index of the first sample of the flight among the samples of all flights.
    flight_start = 0
    for flight in flights:
        flight_alarms = [alarm for alarm in alarms if alarm.boot == boot_number(flight)]
        for alarm in flight_alarms:
            # An alarm without a motor reports a change of the balance that may have other causes than the motors.
            if alarm.motor is None:
                continue
            sample = round((alarm.onset_time - flight.time[0]) / flight.dt)
            # A change at the first sample does not divide the flight.
            if 0 < sample < len(flight):
                change_samples.add(flight_start + sample)
        is_some_motor_weak = np.zeros(len(flight), bool)
        for interval in _weak_motor_intervals(flight_alarms):
            is_some_motor_weak |= in_intervals(flight.time, [interval])
        weak_flags_of_flights.append(is_some_motor_weak)
        flight_start += len(flight)
    return MotorChanges(sorted(change_samples), np.concatenate(weak_flags_of_flights))


def _weak_motor_intervals(alarms: Sequence[MotorChange]) -> list[TimeInterval]:
    """Finds the intervals in which a motor had lost thrust, from its alarms of loss and recovery.

    Args:
        alarms: alarms of one boot: a motor lost or recovered thrust.

    Returns:
        Start and end of each interval, s since boot; the end is infinite without a recovery. Each is extended by
        ``MAX_ONSET_ERROR``, by which the times of alarms may be wrong, so that intervals may overlap.
    """
    intervals = []
    for loss in alarms:
        if not loss.is_weak:
            continue
        end_time = inf
        for alarm in alarms:
            # An alarm whose change has the size 0 reports that the motor is as it was before the loss.
            is_recovery = alarm.motor == loss.motor and alarm.size == 0
            if is_recovery and alarm.onset_time > loss.onset_time:
                end_time = min(end_time, alarm.onset_time)
        intervals.append((loss.onset_time - MAX_ONSET_ERROR, end_time + MAX_ONSET_ERROR))
    return intervals


@dataclass(frozen=True, eq=False)
class LogAnalysis:
    """All that a log shows of one vehicle and axis."""

    learnability: Learnability
    """Whether a full model of the axis can be learned, from which segment, and the figures of its data."""
    tier: Tier
    """What the log allows, why no more, and what the next tier needs."""
    condition: Condition
    """Motor balance, lean, vibration, battery and oscillation, at any rate."""
    identity: Identity
    """Which vehicle it is, and when it flew."""
    reason: Fact | None = None
    """Why there is no full model; None if there is one."""
    axes: Mapping[str, AxisEstimates] = field(default_factory=dict)
    """Physical parameters of roll, pitch and yaw, if all axes were analysed; otherwise empty."""
    flights: Flights = ()
    """What the model was trained on."""
    learned: Learned | None = None
    """The model; in tier "b" one of the slow motion, without physical parameters; None if there is none."""
    held_out: HeldOut | None = None
    """Forecasts of windows that no model was trained on."""
    truth: TruthComparison | None = None
    """The estimates compared with the truth of a simulated flight, if its file was given."""
    alarms: tuple[MotorChange, ...] = ()
    """Lasting changes of the motors' balance in flight, as a live session would have found them."""
    trim: Fact | None = None
    """How even the motors work; None if their outputs were not recorded."""
    motors_are_watched: bool = False
    """Whether a motor that weakens in flight would have been detected."""

    @property
    def estimates_by_axis(self) -> Mapping[str, AxisEstimates]:
        """Physical parameters and wind torque by axis, for each axis that they were estimated of.

        These are roll, pitch and yaw if all axes were analysed (``axes``), and otherwise only the axis of the model.
        The mapping is empty without a model.
        """
        learned = self.learned
        if self.axes or learned is None:
            return self.axes
        estimates = AxisEstimates(
            self.flights,
            physical=learned.physical,
            reason=learned.physical_reason,
            model=learned,
        )
        return {self.learnability.axis: estimates}

    @property
    def model(self) -> str | None:
        """Which model can be learned: "full", "slow motion", or None."""
        if self.learnability.learnable:
            return "full"
        return None if self.learned is None else "slow motion"

    @cached_property
    def findings(self) -> Findings:
        """Faults that make the flight doubtful, such as a weak motor, and the grade of its model for each purpose.

        One of the faults is that the recorded body rates do not match the derivative of the recorded angles. Slow
        streams do not show that, so that it is tested only if the log allows a full model.
        """
        # Fraction of the angle's changes that the recorded rates explain, 0 to 1.
        rate_consistency = None
        if self.learnability.learnable:
            rate_consistency = self.learnability.figures.consistency
        return model_findings(
            self.learned,
            self.held_out,
            self.condition,
            self.alarms,
            consistency=rate_consistency,
            trim=self.trim,
        )

    @property
    def report_values(self) -> JsonValues:
        """Returns the content of ``report.json`` by its keys, as records, facts and arrays that are not yet JSON.

        The document has six parts: the model with its errors of forecast, which is missing if no model was learned
        (:func:`model_figures`); the physical parameters of each axis; the tier, which is the kind of model that the log
        allows; the condition of the vehicle; the changes of its motors in flight; and the grades of the model by
        purpose. Two keys are older than the names that are used here: "verdict" is the learnability of the log, and
        "truth" the comparison of the estimates with the known parameters of a simulated vehicle.

        Returns:
            Values by key; None, or empty, for what is not known. Angles are in rad, rates in rad/s, times in s.
        """
        model_values: JsonValues = {}
        model_settings = None
        if self.learned is not None:
            model_settings = asdict(self.learned.settings)
            if self.held_out is not None:
                model_values = model_figures(self.flights, self.learned, self.held_out)
        no_model_reason = self.reason
        remedy = None if no_model_reason is None else no_model_reason.remedy
        return {
            **model_values,
            "axes": self.axes,
            "hover": self.condition.hover,
            "tier": self.tier.tier,
            "tier_reason": self.tier.tier_reason,
            "allows": self.tier.allows,
            "next_tier": self.tier.next_tier,
            "reason": no_model_reason,
            "remedy": remedy,
            "condition": self.condition,
            "identity": self.identity,
            **alarm_figures(self.alarms),
            "overrides": self.findings.overrides,
            "purposes": self.findings.purposes,
            "warnings": self.findings.warnings,
            "truth": self.truth,
            "settings": model_settings,
            "verdict": self.learnability,
        }


def model_figures(flights: Flights, learned: Learned, held_out: HeldOut) -> JsonValues:
    """Returns the figures of a model by the keys of ``report.json``, in rad, rad/s and s.

    They are the training data, the learned model with its free energy, how well it forecasts windows that no model was
    trained on, the simulation fit, and the physical parameters. docs/report.md explains each key.

    Args:
        flights: segments that the model was trained on.
        learned: the linear model that was learned from a flight, with its training data.
        held_out: forecasts of windows that no model was trained on.

    Returns:
        Values by key.
    """
    first_flight = flights[0]
    # The model's forecast is compared with those of the baselines, which have the same names as methods.
    forecasts = dict[StrEnum, HeldOutForecast]({MethodName.JOINT: FORECAST})
    forecasts |= {baseline: baseline for baseline in BASELINES}
    errors = {
        method: held_out.squared_errors(forecast).mean(axis=0)
        for method, forecast in forecasts.items()
    }
    ranked_errors = _ranked_errors(errors, held_out.variance)
    model = learned.model
    energy = learned.free_energy
    joint = learned.joint
    return {
        "flight": first_flight.provenance,
        "segments": [{"start": flight.time[0], "samples": len(flight)} for flight in flights],
        "inputs": first_flight.input_names,
        "outputs": first_flight.output_names,
        "dt": first_flight.dt,
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
        "forecast_mspe": ranked_errors,
        "forecast_over_constant_mean": ranked_errors[MethodName.JOINT]["relative"],
        "expected_error": (held_out.expected / held_out.variance).mean(),
        "inside_90_percent_band": held_out.coverage,
        "prediction": {
            "half_explained_seconds": learned.useful_steps * first_flight.dt,
            "error_ratio": held_out.error_ratio(PREDICTION),
        },
        "simulation_fit": _simulation_fit_figures(learned),
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


def _simulation_fit_figures(learned: Learned) -> JsonValues | None:
    """Returns figures of the simulation-error (output-error) fit of a model, by the keys of ``report.json``.

    Such a fit minimises the errors of simulations that begin at each sample and last for a fixed number of samples.

    Args:
        learned: the learned model, with r inputs.

    Returns:
        A dictionary: ``samples`` is how many samples each simulation lasts, ``converged`` whether the fit converged,
        ``numbers`` the effective sample size, ``parameters`` the number of free parameters, ``turning`` the weights
        (r,) with which the inputs sum to the command of the axis, and ``terms`` has the terms of the objective at the
        last iteration. None for a model without such a fit.
    """
    fit = learned.simulation_fit
    if fit is None:
        return None
    # The first column of the mixer is the command of the axis.
    axis_weights = learned.joint.mixer[:, 0]
    last_terms = {name: values[-1] for name, values in fit.terms.items()}
    return {
        "samples": fit.horizon,
        "converged": fit.converged,
        "numbers": fit.effective_samples,
        "parameters": len(fit.free),
        "turning": axis_weights,
        "terms": last_terms,
    }


def _ranked_errors(errors: Mapping[StrEnum, Array], variance: Array) -> dict[StrEnum, JsonValues]:
    """Ranks forecasting methods by their errors.

    The methods are ranked by the key ``relative``: the error over the constant mean's error, 1 for a method that is no
    better. The keys ``per_output`` and ``total`` are the errors themselves, in squared units of the outputs.

    Args:
        errors: mean squared errors (m,) of m outputs, by method.
        variance: (m,) variances of the outputs. An error over the variance has no unit, so that errors of angle and
            rate can be added.

    Returns:
        The keys ``relative``, ``per_output`` and ``total`` for each method, the most accurate method first.
    """
    baseline_error = (errors[CONSTANT_MEAN] / variance).sum()
    error_ratios = {}
    for method, output_errors in errors.items():
        normalised_error = (output_errors / variance).sum()
        error_ratios[method] = float(error_over(normalised_error, baseline_error))
    ranking = {}
    for method in sorted(error_ratios, key=lambda method: error_ratios[method]):
        output_errors = errors[method]
        ranking[method] = {
            "per_output": output_errors,
            "total": output_errors.sum(),
            "relative": error_ratios[method],
        }
    return ranking


def physical_parameters(signals: Signals, flights: Flights) -> Physical | NotIdentifiable:
    """Returns the physical parameters of one axis: control effectiveness, damping, motor time constant and delay.

    There are two estimates. The open-loop one uses only inputs and outputs. It distinguishes the motors and has
    narrower intervals, but it may be biased if the controller reacts to the wind. The closed-loop one models the
    controller too, so it needs flights with one known set of gains, and setpoints that excite the axis.

    The open-loop estimate is returned if it is identifiable and unbiased, and the closed-loop one determines the
    control effectiveness as well. Otherwise the closed-loop estimate is returned, if there is one.

    Args:
        signals: signals of the vehicle and the axis.
        flights: settled flight of the axis.

    Returns:
        The parameters, or the reason why neither estimate is possible. An open-loop estimate that is not reliable is
        returned too if there is no closed-loop one; its ``refusal`` says why.
    """
    open_loop = physical(flights)
    is_reliable = isinstance(open_loop, Physical) and open_loop.identifiable and not open_loop.bias
    try:
        # The controller is known only while its gains do not change.
        flights_of_gains, _ = sections_with_one_gain_set(signals, flights)
        closed_loop = identify_plant_in_loop(signals, flights_of_gains)
    except NotLearnable as error:
        return open_loop if is_reliable else open_loop._replace(refusal=error.fact)
    # The closed loop may not determine the effectiveness, as when it rings. Then the open-loop estimate of it is
    # doubtful too.
    loop_confirms_effect = closed_loop.status["effect"] is Status.REPORTED
    return open_loop if is_reliable and loop_confirms_effect else closed_loop


def estimates_of_axis(
    signals: Signals,
    components: tuple[Component, ...],
    alarms: Sequence[MotorChange],
) -> AxisEstimates:
    """Estimates physical parameters of the axis of ``signals``, from which its wind torque follows, without a model.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        components: all components of the log, for the advice on rates if messages are too slow.
        alarms: changes of the motors in flight. The wind torque is estimated again after each, and there is none while
            a motor had lost thrust.

    Returns:
        The figures; if the parameters could not be estimated, with the ``reason``.
    """
    flights, learnability = usable_segments(signals, components)
    if not flights:
        return AxisEstimates((), None, learnability.reason)
    parameters = physical_parameters(signals, flights)
    if isinstance(parameters, NotIdentifiable):
        return AxisEstimates(flights, None, parameters.reason)
    changes = motor_changes(alarms, flights)
    parameters = changes.checked_parameters(parameters)
    return AxisEstimates(flights, parameters, reason=None, motor_changes=changes)
