#!/usr/bin/env python
"""Stability margins of control loops that are identified from simulated flights, compared with the true margins.

The flights are drawn at random: one half of them chooses a method, the other half is reported. They are simulated once
and kept in --cache. With LOGS, recorded flights are read instead. To thin messages to a rate, one of every few is kept,
with --staggered from another cycle in each stream.
Stamps are exact, as in autopilots' own logs, or with --rounded partly in whole milliseconds, as MAVLink sends them.

A "figure" is a parameter of the plant (from the demand of the rate controller to the body rate), or a margin of the
rate or attitude loop. The tables have the statistics of each figure's error, which is relative, but in dB or degrees
for margins. "given" is the number of identified loops, "rms" the root mean square error, "median" the median error,
"size" the median of the absolute error, "close" the share within 1.5 dB, and "inside" the share of 90 % intervals that
contain the truth.

With --strong, flights with strong doublets and high hover show what the deviation of the gain by unexplained output
(``UNEXPLAINED_GAIN_DEVIATION``) does to the intervals of the crossover frequency.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import pandas as pd
from flights import Values, command, evaluate_flights, percent_true, print_table
from numpy.random import Generator, default_rng
from numpy.typing import NDArray
from physical import Case, draw_vehicle_values
from physical import scenario as scenario_of_case

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.assessment.record import NoLoop
from mavdem.confidence import INTERVAL_QUANTILES
from mavdem.errors import Refusal
from mavdem.experiments.paper.flights import write_log
from mavdem.facts import Fact
from mavdem.files import load_adjacent_toml
from mavdem.ingest import Log, read_log
from mavdem.ingest.telemetry import Telemetry, rate_without_gaps, selected_rows
from mavdem.ingest.vocabulary import IN_AIR
from mavdem.loops.autopilot_parameters import DEFAULT_LOOP_RATES, LOOP_RATE_PARAMETERS
from mavdem.loops.axis_loops import Loop
from mavdem.loops.controllers import Controller, controller_from_parameters
from mavdem.loops.identified_plant import UNEXPLAINED_GAIN_DEVIATION
from mavdem.loops.loop_construction import loop_from_plant
from mavdem.loops.margins import OpenLoop, attitude_loop, plant_response, rate_loop
from mavdem.plant.parameters import DRAWS, EFFECTS, ESTIMATE
from sitl_scenarios.files import scenario_from_table
from sitl_scenarios.gains import control_parameters
from sitl_scenarios.motion import Motion
from sitl_scenarios.rotors import IDLE_COMMAND, MAX_PULSE, MIN_PULSE, pulse_width, rotor_frame
from sitl_scenarios.scenario import AXES, Axis, Scenario
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import axis_model, truth
from sitl_scenarios.vehicles import airframe

TABLES = load_adjacent_toml(__file__, "loops.toml")
"""Vehicles, winds, steering, gains and ranges from which flights are drawn, and plants of recorded logs."""

HALVES = {"choose": range(1000, 1024), "report": range(2000, 2024)}
"""Seeds of the flights to choose a method on, and of those to report."""

STRONG_SEED = 10_000
"""What is added to the seeds of a half for its flights with strong doublets and high hover."""

LIMITED_SEED = 20_000
"""What is added to the seeds of a half for its flights whose setpoints end at a few hertz."""

GAIN_DEVIATIONS = (0.0, 0.1, UNEXPLAINED_GAIN_DEVIATION, 0.4)
"""Values in the place of ``UNEXPLAINED_GAIN_DEVIATION`` with which intervals of the crossover are compared."""

LOOP_RATE = DEFAULT_LOOP_RATES["ardupilot"]
"""Rate of the simulated autopilots' loops, and of their messages, Hz: ArduPilot's default."""

CACHE_FOLDER = Path.home() / ".cache" / "mavdem" / "loops"
"""Folder in which simulated flights are kept, 4 MB each, unless another is given."""

MAX_AT_LIMIT_SHARE = 0.15
"""Largest share of the time in the air with a motor at a limit, where loops are not linear: a choice."""

MIN_PHASE_MARGIN = 15.0
"""Least phase margin of the loops that are flown, degrees: a choice, below any margin that a tuned vehicle has."""

SUBTYPE_FIELDS = ("type_mask", "axis", "port")
"""Fields that distinguish streams which share a message's name; each stream is thinned by itself."""

PULSE_RANGE = MAX_PULSE - MIN_PULSE
"""Range of a motor's output, as a PWM pulse width, µs."""

MARGINS = ("crossover", "phase_margin", "gain_margin", "ms")
"""Characteristics of a loop that are compared, by their keys in ``OpenLoop.characteristics``: Hz, degrees, dB, |S|."""

LOOPS = ("rate", "attitude")
"""Loops of an axis, whose names begin the names of their figures, such as "rate_gain_margin"."""

SHOWN_FIGURES = ("effect", *(f"rate_{name}" for name in MARGINS))
"""Figures that are printed of recorded logs."""

CLOSE_GAIN_ERROR = 1.5
"""Largest error of a gain margin that is called close, dB: a choice."""

MAX_GAIN_ERROR = 30.0
"""Largest error of a gain margin in statistics, dB: an infinite margin where the truth is finite counts as this."""

Array = NDArray[np.float64]

FiguresByAxis = dict[str, dict[str, float]]
"""Figures of the plant and its loops: by axis, and then by the name of the figure, as in ``loop_figures``."""


class AxisPlant(NamedTuple):
    """What turns the vehicle about one axis: the response of the body rate to the rate controller's demand."""

    effect: float
    """Control effectiveness: angular acceleration per unit of demand in steady state, rad/s²."""
    damping: float
    """Rate damping, 1/s."""
    lag: float
    """Time constant of the motors, s."""
    delay: float
    """Dead time from the controller to the gyro's measurement, s."""

    @staticmethod
    def from_figures(figures: Mapping[str, float]) -> AxisPlant:
        """Returns the plant among the figures of an axis, which also have the margins of its loops."""
        return AxisPlant(**{name: figures[name] for name in AxisPlant._fields})


class RandomGains(NamedTuple):
    """Gains of the controllers of all axes, and the stability that they leave."""

    parameters: dict[str, float]
    """Gains by the autopilot's names of the parameters."""
    phase_margin: float
    """Smallest phase margin of the rate and attitude loops of all axes, degrees."""


def random_scenario(seed: int, rng: Generator) -> Scenario:
    """Draws scenarios of a flight until one has at least ``MIN_PHASE_MARGIN`` in all its loops.

    Args:
        seed: seed of the flight, which chooses autopilot, filters and excitation.
        rng: source of the random numbers.

    Returns:
        The scenario, with its gains as parameters of the autopilot.
    """
    while True:
        values = _scenario_with_default_gains(seed, rng)
        gains = _random_gains(scenario_from_table(values), rng)
        if gains.phase_margin > MIN_PHASE_MARGIN:
            values["vehicle"]["parameters"] |= gains.parameters
            return scenario_from_table(values)


def _scenario_with_default_gains(seed: int, rng: Generator) -> Values:
    """Draws vehicle, wind, filters and sensors of a flight, in which the autopilot has its default gains.

    The seed, rather than a draw, chooses autopilot, gyro filter and excitation, so that successive seeds have each of
    them equally often. From ``STRONG_SEED`` on, doublets are strong and vehicles need much thrust to hover.

    Args:
        seed: seed of the flight.
        rng: source of the random numbers.

    Returns:
        Values of the scenario by key, as in its TOML file, for :func:`scenario_from_table`.
    """
    tables = TABLES | _tables_of_kind(seed)
    autopilot = ("ardupilot", "px4")[seed % 2]
    has_gyro_low_pass = seed % 3 != 0
    # Pairs of successive seeds, one of each autopilot, have the same excitation.
    excitations = tables["steering"]
    excitation = excitations[seed // 2 % len(excitations)]

    vehicle = rng.choice(tables["vehicles"])
    wind = str(rng.choice(TABLES["winds"]))
    # The case gives the wind and random properties such as the rotors' lag. Its vehicle and its excitation ("none") are
    # replaced below.
    vehicle_values = draw_vehicle_values(rng)
    case = Case("iris", wind, "none", LOOP_RATE, autopilot, vehicle_values, seed)
    values: Values = scenario_of_case(case).model_dump(mode="json")

    parameters = {LOOP_RATE_PARAMETERS[autopilot]: LOOP_RATE, **TABLES["filters"][autopilot]}
    if has_gyro_low_pass:
        parameters |= TABLES["gyro"][autopilot]
    values["vehicle"] |= {**vehicle, "parameters": parameters}
    values["excitation"] = excitation
    values["sensors"] |= {name: _random_value(name, rng) for name in ("delay", "rate_sd")}
    values["stream"]["rates"] = {"ATTITUDE_TARGET": LOOP_RATE}
    return values


def _tables_of_kind(seed: int) -> Values:
    """Returns the vehicles and the steering that only the flights of one kind are drawn from, by the flight's seed."""
    if seed >= LIMITED_SEED:
        return TABLES["limited"]
    if seed >= STRONG_SEED:
        return TABLES["strong"]
    return {}


def _random_value(name: str, rng: Generator) -> float:
    """Draws a number uniformly from the range of this name in ``loops.toml``."""
    return float(rng.uniform(*TABLES["ranges"][name]))


def _random_gains(scenario: Scenario, rng: Generator) -> RandomGains:
    """Draws gains of rate and attitude controllers for all axes.

    The default gains of a rate loop are scaled so that it has a gain margin that is drawn; the gain of an attitude loop
    is drawn itself. The plants are linearised in hover.

    Args:
        scenario: the flight, whose vehicle and filters the margins depend on.
        rng: source of the random numbers.

    Returns:
        The gains, and the smallest phase margin that they leave.
    """
    vehicle = airframe(scenario.vehicle)
    # Output of each motor in hover, as a fraction of its range.
    hover_output = vehicle.command_for(vehicle.hover_speed) / vehicle.full_command
    gains: dict[str, float] = {}
    phase_margins = []
    for axis in AXES:
        controller = axis_controller(scenario, axis)
        # The last state of the axis is its rate: this row of B has the angular acceleration by each motor.
        motor_effect = axis_model(scenario.vehicle, axis).B[-1]
        hover_outputs = [hover_output] * len(motor_effect)
        plant = true_plant(scenario, axis, motor_effect, hover_outputs)
        default_pid = TABLES["gains"][scenario.stream.autopilot][axis]
        gain_margin = _random_value("gain_margin", rng)
        axis_gains = _scaled_pid(controller, plant, default_pid, gain_margin)
        axis_gains[controller.parameter_names["angle_gain"]] = _random_value("angle", rng)
        figures = loop_figures(controller.with_parameters(axis_gains), plant)
        phase_margins.append(figures["rate_phase_margin"])
        phase_margins.append(figures["attitude_phase_margin"])
        gains |= axis_gains
    return RandomGains(gains, min(phase_margins))


def _scaled_pid(
    controller: Controller, plant: AxisPlant, default_pid: Sequence[float], gain_margin: float
) -> dict[str, float]:
    """Scales P, I and D of a rate controller by a common factor, so that the rate loop has a wanted gain margin.

    The loop gain is proportional to that factor, which is therefore the surplus of the gain margin, dB, as a ratio.

    Args:
        controller: rate and attitude controller of the axis.
        plant: control effectiveness, damping, lag and delay of the axis.
        default_pid: P, I and D (3,) whose proportions are kept, in the units of the parameters.
        gain_margin: wanted gain margin of the rate loop, dB.

    Returns:
        P, I and D by the autopilot's names.
    """
    names = [controller.parameter_names[gain] for gain in "pid"]
    default_gains = dict(zip(names, default_pid, strict=True))
    default_margin = loop_figures(controller.with_parameters(default_gains), plant)[
        "rate_gain_margin"
    ]
    factor = 10 ** ((default_margin - gain_margin) / 20)
    return {name: factor * gain for name, gain in default_gains.items()}


def axis_controller(scenario: Scenario, axis: Axis) -> Controller:
    """Returns the rate and attitude controller of one axis with which a scenario is flown."""
    frame = rotor_frame(scenario.vehicle.frame, airframe(scenario.vehicle).arm)
    mixer_weights = getattr(frame, axis)
    return controller_from_parameters(control_parameters(scenario), axis, mixer_weights)


def true_plant(
    scenario: Scenario, axis: Axis, motor_effect: Array, outputs: Sequence[float]
) -> AxisPlant:
    """Returns the true plant of one axis of a simulated vehicle, linearised about given motor outputs.

    Rotors speed up and slow down with different time constants, of which a linear plant has the mean. The delay is the
    sensors' delay, and half a cycle because the controller holds its output for a cycle.

    Args:
        scenario: scenario of the simulated flight: vehicle, wind, excitation, sensors and faults.
        axis: the axis.
        motor_effect: angular acceleration per output of each motor (4,), rad/s² per µs of pulse width.
        outputs: output of each motor (4,), as a fraction of its range.

    Returns:
        Effect of a demand, rad/s², damping, 1/s, lag, s, and delay, s.
    """
    # Mixer and thrust curve: change of each motor's output, a fraction of its range, per unit of demand.
    outputs_per_demand = axis_controller(scenario, axis).outputs_per_demand(outputs)
    effect = PULSE_RANGE * motor_effect @ outputs_per_demand
    # The last state is the body rate: its own coefficient is the negative damping.
    damping = -axis_model(scenario.vehicle, axis).A[-1, -1]
    lag = sum(airframe(scenario.vehicle).rotor_lags) / 2
    delay = scenario.sensors.delay + scenario.cycle / 2
    return AxisPlant(float(effect), float(damping), lag, delay)


def figures_of_plants(
    effectiveness: Array, dynamics: Array, rate: OpenLoop, attitude: OpenLoop
) -> dict[str, Array]:
    """Collects the parameters of N plants of an axis and the margins of their control loops by name.

    Args:
        effectiveness: control effectiveness of each plant (N,), rad/s² per demand.
        dynamics: damping, 1/s, lag, s, and delay, s, of each plant (N, 3).
        rate: rate loops of these plants.
        attitude: attitude loops of these plants.

    Returns:
        Arrays (N,). Parameters have the names and units of the fields of ``AxisPlant``. Margins have the name of the
        loop and of the margin, such as "rate_gain_margin", and the units of ``MARGINS``.
    """
    figures = dict(zip(AxisPlant._fields, (effectiveness, *dynamics.T), strict=True))
    for loop_name, loop in zip(LOOPS, (rate, attitude), strict=True):
        for margin in MARGINS:
            figures[f"{loop_name}_{margin}"] = loop.characteristics[margin]
    return figures


def loop_figures(controller: Controller, plant: AxisPlant) -> dict[str, float]:
    """Computes the margins of the rate and attitude loop that a controller has with a given plant.

    Args:
        controller: controller of the axis.
        plant: control effectiveness, damping, lag and delay of the axis.

    Returns:
        Parameters of the plant and margins of both loops, by the names of :func:`figures_of_plants`.
    """
    effectiveness = np.array([plant.effect])
    dynamics = np.array([[plant.damping, plant.lag, plant.delay]])
    rate = rate_loop(controller, plant_response(controller, effectiveness, dynamics))
    attitude = attitude_loop(controller, rate)
    figures = figures_of_plants(effectiveness, dynamics, rate, attitude)
    return {name: float(values[0]) for name, values in figures.items()}


def flight_folder(seed: int, cache: Path) -> Path:
    """Returns the folder of a simulated flight, which is flown if the folder does not exist yet.

    The folder has the log, ``flight.tlog``, and the true figures of all axes, ``truth.json``.

    Args:
        seed: seed of the flight.
        cache: folder of all flights.

    Returns:
        The folder, a subfolder of ``cache``.
    """
    folder = cache / str(seed)
    if (folder / "truth.json").exists():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    scenario, motion = drawn_flight(seed)
    write_log(folder / "flight.tlog", scenario, motion)
    true_figures = true_figures_of_flight(scenario, motion)
    (folder / "truth.json").write_text(json.dumps(true_figures, indent=1), "utf-8")
    return folder


def drawn_flight(seed: int) -> tuple[Scenario, Motion]:
    """Draws and flies scenarios until one neither tumbles nor has motors at their limits for too long.

    A motor is at a limit at the full or at the idle pulse width. Then the linear loop does not describe the vehicle, so
    that the share of the time in the air with any motor at a limit is bounded by ``MAX_AT_LIMIT_SHARE``.

    Args:
        seed: seed of the flight.

    Returns:
        The scenario, and the motion of its flight.
    """
    rng = default_rng(seed)
    while True:
        scenario = random_scenario(seed, rng)
        # A vehicle that tumbles raises the error.
        with suppress(ValueError):
            motion = fly(scenario)
            pulses = _pulses_in_air(motion)
            is_at_limit = (pulses >= MAX_PULSE) | (pulses <= pulse_width(IDLE_COMMAND))
            has_motor_at_limit = is_at_limit.any(axis=1)
            if has_motor_at_limit.mean() <= MAX_AT_LIMIT_SHARE:
                return scenario, motion


def true_figures_of_flight(scenario: Scenario, motion: Motion) -> FiguresByAxis:
    """Computes the true plants of a simulated flight and the margins that its loops really had.

    The plants are linear models about the mean outputs of the motors in the air, since the slope of the thrust curve
    depends on the output.

    Args:
        scenario: scenario of the simulated flight: vehicle, wind, excitation, sensors and faults.
        motion: true states, rotor speeds and motor outputs of that flight, cycle by cycle.

    Returns:
        By axis, the parameters of the plant and the margins of both loops, as :func:`loop_figures` names them.
    """
    # Pulse widths, µs, become fractions of the range from the pulse of no command to the pulse of full command.
    mean_outputs = (_pulses_in_air(motion).mean(axis=0) - MIN_PULSE) / PULSE_RANGE
    true_arrays = truth(scenario, motion)
    figures: FiguresByAxis = {}
    for axis in AXES:
        # (4,) angular acceleration per output of each motor, rad/s² per µs.
        motor_effect = true_arrays[f"{axis}_effect"]
        plant = true_plant(scenario, axis, motor_effect, mean_outputs.tolist())
        figures[axis] = loop_figures(axis_controller(scenario, axis), plant)
    return figures


def _pulses_in_air(motion: Motion) -> Array:
    """Returns the PWM pulse widths of all motors at the T samples in the air (T, 4), µs."""
    pulses: Array = motion.outputs[motion.landed_state == IN_AIR]
    return pulses


def simulated_log(seed: int, cache: Path, is_rounded: bool = False) -> tuple[Log, FiguresByAxis]:
    """Returns the log of a simulated flight, and the true plant parameters and loop margins of its axes.

    Args:
        seed: seed of the flight.
        cache: folder of all flights, each with its telemetry log and a file of the true values.
        is_rounded: whether the messages keep the stamps of the telemetry log, some of which are rounded to whole
            milliseconds. Otherwise they get the exact times, as in the logs that autopilots write themselves.

    Returns:
        The log, and the true values by axis, as :func:`loop_figures` names them.
    """
    folder = flight_folder(seed, cache)
    true_figures = json.loads((folder / "truth.json").read_text("utf-8"))
    path = folder / "flight.tlog"
    log = read_log(path) if is_rounded else exact_log(path)
    return log, true_figures


def exact_log(path: Path) -> Log:
    """Reads the log of a simulated flight, and gives its messages the exact times of the autopilot's cycles.

    Every message is sent in some cycle, so that its rounded stamp becomes the time of the nearest one.

    Args:
        path: path of a telemetry log of one vehicle, whose autopilot runs at ``LOOP_RATE``.

    Returns:
        The log with these times.
    """
    log = read_log(path)
    messages = {}
    for name, columns in log.vehicles[0].messages.items():
        cycle_times = np.round(columns["time"] * LOOP_RATE) / LOOP_RATE
        messages[name] = {**columns, "time": cycle_times}
    vehicle = replace(log.vehicles[0], messages=messages)
    return replace(log, vehicles=(vehicle,))


def identified_loops(
    log: Log, rate: float, is_staggered: bool = False
) -> Mapping[str, Loop | NoLoop]:
    """Identifies the loops of all axes from a log whose messages are thinned to a rate, as ``mavdem tune`` does.

    Args:
        log: the log of a flight, with the messages of each vehicle.
        rate: rate of the messages, Hz; infinite for all messages.
        is_staggered: whether the streams begin at different cycles of the autopilot, as for :func:`thinned_telemetry`.

    Returns:
        The loops by axis, or why there is none.
    """
    vehicles = tuple(thinned_telemetry(vehicle, rate, is_staggered) for vehicle in log.vehicles)
    thinned_log = replace(log, vehicles=vehicles)
    return assess(thinned_log, options=Options(with_model=False)).loops


def thinned_telemetry(vehicle: Telemetry, rate: float, is_staggered: bool = False) -> Telemetry:
    """Thins telemetry to about a rate: of each stream of messages that is faster, only one of every few stays.

    Messages of one name are several streams if one of ``SUBTYPE_FIELDS``, or else the boot, differs.

    Args:
        vehicle: messages of the vehicle as columns, and its parameters.
        rate: rate to thin messages to, Hz; infinite to keep all.
        is_staggered: whether the streams begin at different cycles of the autopilot in turn, as where a ground station
            asks for one message after another. Otherwise all begin at the first cycle.

    Returns:
        The telemetry with the rows that stay, in their order.
    """
    messages = {}
    for message_index, (name, columns) in enumerate(sorted(vehicle.messages.items())):
        subtype_fields = [field for field in SUBTYPE_FIELDS if field in columns]
        subtypes = columns[subtype_fields[0]] if subtype_fields else columns["boot"]
        remaining_rows = []
        for subtype in np.unique(subtypes):
            rows = np.flatnonzero(subtypes == subtype)
            stream_rate = rate_without_gaps(np.diff(columns["time"][rows]))
            decimation = max(1, round(stream_rate / rate))
            first_row = message_index % decimation if is_staggered else 0
            remaining_rows.append(rows[first_row::decimation])
        messages[name] = selected_rows(columns, np.sort(np.concatenate(remaining_rows)))
    return replace(vehicle, messages=messages)


class FigureEstimate(NamedTuple):
    """A figure of an identified loop (a parameter of its plant, or a margin) with its 90 % interval."""

    value: float
    """Figure of the estimated plant."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""


def estimated_figures(loop: Loop) -> dict[str, FigureEstimate]:
    """Returns plant parameters and margins of an identified loop with their 90 % intervals.

    An identified loop has N plants: the first is the estimate, the others are samples of the posterior. The intervals
    are quantiles of the samples.

    Args:
        loop: the identified loop of one axis.

    Returns:
        Estimate and both ends of the interval, by the names and in the units of :func:`figures_of_plants`.
    """
    figures = figures_of_plants(loop.effectiveness, loop.dynamics, loop.rate, loop.attitude)
    estimates = {}
    for name, values in figures.items():
        estimate = values[ESTIMATE]
        posterior_samples = values[DRAWS]
        # An infinite gain margin has no neighbour to interpolate to: quantiles are values of samples.
        low, high = np.quantile(posterior_samples, INTERVAL_QUANTILES, method="nearest")
        estimates[name] = FigureEstimate(estimate, low, high)
    return estimates


def root_cause(fact: Fact) -> str:
    """Returns the code of the root cause why a loop was not identified.

    Args:
        fact: the refusal, a coded finding. It may have another finding as its figure "reason", which may have one in
            turn: the last finding of that chain is the root cause.
    """
    reason = fact.figures.get("reason")
    if isinstance(reason, Fact):
        return root_cause(reason)
    return fact.code.name


def true_figures_of_recording(log: Log, file_name: str) -> FiguresByAxis:
    """Returns the true parameters and margins of the control loops in a recorded log, whose plant was measured.

    The plants are in the tables ``[[recorded]]`` of ``loops.toml``, each with the names that its logs begin with
    (``files``) and the axes that it is true of (``axes``). The gains of the controllers are recorded in the log.

    Args:
        log: the log, with the parameters of the autopilot.
        file_name: name of its file.

    Returns:
        Figures by axis and name, as :func:`loop_figures` returns them; empty for a log without a measured plant.
    """
    parameters = log.vehicles[0].parameters
    # The input of the plants is the demand of the controller, instead of motors: so the mixer is a single weight of 1.
    demand_mixer = (1.0,)
    figures = {}
    for table in TABLES["recorded"]:
        if not file_name.startswith(tuple(table["files"])):
            continue
        plant = AxisPlant(**table["plant"])
        for axis in table["axes"]:
            controller = controller_from_parameters(parameters, axis, demand_mixer)
            figures[axis] = loop_figures(controller, plant)
    return figures


def evaluate_log(
    source: Path | int,
    rates: Sequence[float],
    cache: Path,
    is_rounded: bool = False,
    is_staggered: bool = False,
) -> list[Values]:
    """Identifies the loops of a flight at several message rates, and compares each figure with its true value.

    Args:
        source: path of a log, or seed of a simulated flight.
        rates: rates to which messages are thinned, Hz.
        cache: folder of all simulated flights.
        is_rounded: whether a simulated flight has the stamps of MAVLink, as for :func:`simulated_log`.
        is_staggered: whether the streams begin at different cycles of the autopilot, as for :func:`thinned_telemetry`.

    Returns:
        A row for each parameter and margin ("figure") of each axis at each rate: "estimate", the ends "low" and "high"
        of its 90 % interval, and the "true" value. An axis without an identified loop, or a log that cannot be read,
        has one row with the "cause" instead, which is empty in all others.
    """
    name = source.name if isinstance(source, Path) else str(source)
    try:
        if isinstance(source, Path):
            log = read_log(source)
            true_figures = true_figures_of_recording(log, name)
        else:
            log, true_figures = simulated_log(source, cache, is_rounded)
    except Refusal as error:
        row = {"log": name, "rate": np.nan, "axis": "", "figure": ""}
        return [row | {"cause": root_cause(error.fact)}]
    rows = []
    for rate in rates:
        for axis, loop in identified_loops(log, rate, is_staggered).items():
            row = {"log": name, "rate": rate, "axis": axis, "figure": "", "cause": ""}
            if isinstance(loop, NoLoop):
                rows.append(row | {"cause": root_cause(loop.refusal)})
            else:
                comparisons = _figures_beside_truth(loop, true_figures.get(axis, {}))
                rows += [row | comparison for comparison in comparisons]
    return rows


def _figures_beside_truth(loop: Loop, true_values: Mapping[str, float]) -> list[Values]:
    """Returns each figure of an identified loop, with its interval and its true value, NaN where not known."""
    comparisons = []
    for figure, estimate in estimated_figures(loop).items():
        comparison = {
            "figure": figure,
            "estimate": estimate.value,
            "low": estimate.low,
            "high": estimate.high,
            "true": true_values.get(figure, np.nan),
        }
        comparisons.append(comparison)
    return comparisons


def with_gain_deviation(loop: Loop, deviation: float) -> Loop:
    """Returns an identified loop whose control effectiveness is more or less uncertain.

    The controller's output that its logged inputs do not explain makes the identified effectiveness e uncertain: it
    adds the variance (d u e)² to its covariance, with the share u of unexplained output and the constant d =
    ``UNEXPLAINED_GAIN_DEVIATION``. Here another value takes the place of d, to test the choice of the constant.

    Args:
        loop: the loop, whose plant was identified with the constant.
        deviation: value in the place of d, without unit.

    Returns:
        The loop, with the covariance of its plant changed.
    """
    plant = loop.plant
    added_relative_variance = deviation**2 - UNEXPLAINED_GAIN_DEVIATION**2
    added_relative_variance *= plant.unexplained_output**2
    covariance = plant.covariance.copy()
    # All effects have the same relative error, so the added covariance is proportional to their outer product.
    covariance[EFFECTS, EFFECTS] += added_relative_variance * np.outer(plant.effect, plant.effect)
    return loop_from_plant(plant._replace(covariance=covariance), loop.record, loop.controller)


def evaluate_crossovers(seed: int, rates: Sequence[float], cache: Path) -> list[Values]:
    """Compares intervals of the rate loops' crossover frequency with the true one, in one flight.

    Each interval is computed with each of the ``GAIN_DEVIATIONS``, to choose among them.

    Args:
        seed: seed of a simulated flight with strong doublets, from ``STRONG_SEED`` on.
        rates: rates to which messages are thinned, Hz.
        cache: folder of all simulated flights.

    Returns:
        A row for each deviation and each loop whose plant was identified together with its controller: the "half" of
        the flights that this one belongs to, a key of ``HALVES``; the "deviation"; "error" and "half width" of the
        interval, both relative to the true crossover; and whether the true one is "inside" the interval.
    """
    log, true_figures = simulated_log(seed, cache)
    half = next(name for name, seeds in HALVES.items() if seed - STRONG_SEED in seeds)
    rows = []
    for rate in rates:
        for axis, loop in identified_loops(log, rate).items():
            # The deviation is no part of a plant that was identified without its controller (the gray-box model).
            if isinstance(loop, NoLoop) or loop.plant.filtered:
                continue
            true_crossover = true_figures[axis]["rate_crossover"]
            for deviation in GAIN_DEVIATIONS:
                changed_rate_loop = with_gain_deviation(loop, deviation).rate
                low, high = changed_rate_loop.crossover_interval
                row = {
                    "half": half,
                    "deviation": deviation,
                    "error": changed_rate_loop.crossover / true_crossover - 1,
                    "half width": (high - low) / 2 / true_crossover,
                    "inside": low <= true_crossover <= high,
                }
                rows.append(row)
    return rows


def crossover_statistics(rows: pd.DataFrame) -> pd.Series:
    """Summarises intervals of the crossover frequency: how many hold the true one, and how wide they are.

    Args:
        rows: rows of :func:`evaluate_crossovers` with one deviation, whose errors and half widths are relative.

    Returns:
        Number of loops, number of intervals that hold the truth ("inside"), root mean square error and median half
        width in percent of the true crossover.
    """
    statistics = {
        "loops": len(rows),
        "inside": rows["inside"].sum(),
        "rms error, %": 100 * (rows["error"] ** 2).mean() ** 0.5,
        "median half width, %": 100 * rows["half width"].median(),
    }
    return pd.Series(statistics).round(1)


def error_statistics(rows: Any) -> pd.Series:
    """Summarises the errors of one plant parameter or margin, and counts the intervals that contain the truth.

    Errors are relative, except errors of margins, which are in dB and degrees.

    Args:
        rows: group of rows of :func:`evaluate_log`, whose name begins with the parameter's or margin's.

    Returns:
        By column: number of estimates ("given"), root mean square error ("rms"), "median" error, median of the absolute
        error ("size"), and percentages of errors of at most ``CLOSE_GAIN_ERROR`` ("close") and of intervals that
        contain the truth ("inside").
    """
    figure = rows.name[0]
    errors = rows["estimate"] - rows["true"]
    if figure.endswith("gain_margin"):
        # The difference of two infinite margins is NaN: they agree.
        errors = errors.fillna(0.0).clip(-MAX_GAIN_ERROR, MAX_GAIN_ERROR)
    elif "margin" not in figure:
        errors = errors / rows["true"]
    absolute_errors = errors.abs()
    statistics = {
        "given": len(rows),
        "rms": (errors**2).mean() ** 0.5,
        "median": errors.median(),
        "size": absolute_errors.median(),
        "close": percent_true(absolute_errors <= CLOSE_GAIN_ERROR),
        "inside": percent_true(rows["true"].between(rows["low"], rows["high"])),
    }
    return pd.Series(statistics)


HALF = click.option("--half", type=click.Choice(list(HALVES)), default="choose", show_default=True)
"""Option of which half of the simulated flights to evaluate; the scripts that use these flights share it."""

CACHE = click.option("--cache", default=CACHE_FOLDER, show_default=True, type=Path)
"""Option of the folder in which the simulated flights are kept."""


@command(__doc__, flights=24)
@click.argument("logs", nargs=-1, type=Path)
@click.option("--rates", default="400 200 100 80 50 25 10", help="Hz; inf: as recorded.")
@click.option("--rounded", is_flag=True, help="Stamps as MAVLink rounds them.")
@click.option("--staggered", is_flag=True, help="Streams begin at different cycles.")
@click.option("--strong", is_flag=True, help="Strong doublets and high hover, both halves.")
@click.option("--limited", is_flag=True, help="Setpoints that end at 3 to 8 Hz.")
@HALF
@CACHE
def main(
    logs: tuple[Path, ...],
    half: str,
    rates: str,
    rounded: bool,
    staggered: bool,
    strong: bool,
    limited: bool,
    flights: int,
    cache: Path,
    jobs: int,
) -> None:
    """Prints how far the figures of identified loops are from the true ones, by figure, message rate and axis.

    Before that it prints how many axes have an identified loop at each rate, and why the others have none. Of recorded
    LOGS, it prints the estimate, interval and truth of each figure instead.

    Args:
        logs: recorded logs; simulated flights if there are none.
        half: half of the simulated flights, a key of ``HALVES``.
        rates: message rates, Hz, separated by spaces.
        rounded: whether stamps are rounded as in MAVLink messages.
        staggered: whether thinned streams begin at different cycles of the autopilot.
        strong: whether to print intervals of the crossover in flights with strong doublets and high hover instead.
        limited: whether to evaluate flights whose setpoints end at a few hertz.
        flights: number of simulated flights.
        cache: folder that keeps the simulated flights.
        jobs: number of processes.
    """
    message_rates = [float(rate) for rate in rates.split()]
    if strong:
        seeds = [STRONG_SEED + seed for name in HALVES for seed in HALVES[name][:flights]]
        evaluate = partial(evaluate_crossovers, rates=message_rates, cache=cache)
        _print_crossovers(evaluate_flights(evaluate, seeds, jobs))
        return
    evaluate = partial(
        evaluate_log,
        rates=message_rates,
        cache=cache,
        is_rounded=rounded,
        is_staggered=staggered,
    )
    if logs:
        rows = evaluate_flights(evaluate, logs, jobs)
        is_shown = rows["figure"].isin(SHOWN_FIGURES) | (rows["cause"] != "")
        print_table("Logs", rows[is_shown])
        return
    first_seed = LIMITED_SEED if limited else 0
    seeds = [first_seed + seed for seed in HALVES[half][:flights]]
    _print_errors(evaluate_flights(evaluate, seeds, jobs))


def _print_crossovers(rows: pd.DataFrame) -> None:
    """Prints how well the intervals of the crossover frequency hold the true one, by the deviation of the gain.

    Args:
        rows: rows of :func:`evaluate_crossovers`.
    """
    groups = rows.groupby(["half", "deviation"])
    table = groups.apply(crossover_statistics).reset_index()
    print_table("Crossover, by the deviation of the gain", table)


def _print_errors(rows: pd.DataFrame) -> None:
    """Prints how many axes have an identified loop, why the others have none, and a table of errors for each figure.

    Args:
        rows: rows of :func:`evaluate_log`: one for each figure of an identified loop, or one with the "cause" why an
            axis has none.
    """
    axes = rows.drop_duplicates(["log", "rate", "axis"])
    counts = axes.groupby(["rate", "cause"]).size()
    print_table("Given or refused, axes", counts.reset_index(name="axes"))
    identified = rows[rows["cause"] == ""]
    with_all_axes = pd.concat([identified, identified.assign(axis="all")])
    groups = with_all_axes.groupby(["figure", "rate", "axis"], sort=False)
    statistics = groups.apply(error_statistics)
    for figure, table in statistics.reset_index().groupby("figure", sort=False):
        print_table(figure, table.drop(columns="figure"))


if __name__ == "__main__":
    main()
