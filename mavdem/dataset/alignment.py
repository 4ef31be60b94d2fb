"""Alignment: attitude and model inputs of a segment on one uniform clock, as a Flight."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import JsonValues
from mavdem.dataset.axes import TILT_AXES, model_outputs
from mavdem.dataset.parameter_history import BootTime, parameter_history
from mavdem.dataset.resampling import common_grid, common_step, mean_rate, resample
from mavdem.dataset.segments import Segment, rows_of_segment
from mavdem.dataset.setpoints import Setpoint, held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.flight import Flight
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS


@cached_per_vehicle("axis", "inputs")
def aligned_flight(signals: Signals, segment: Segment, dt: float | None = None) -> Flight:
    """Resamples attitude, model inputs and setpoints of a segment to one uniform grid.

    Its inputs are the outputs of all motors, or the demand for the axis (``Signals.model_inputs``). Its outputs are
    Euler angle and body rate of the axis; of yaw only the rate.

    Attitude and inputs keep their samples, are interpolated linearly or are low-passed first (see
    ``resampling.resample``). Inputs are not held, although the speed controllers of the motors hold them: they do so
    only until the next turn of the mixer, a few milliseconds later and long before the next message. Holding the last
    message would date every input half an interval late on average, and a model would learn that as a lag.
    Interpolation has no lag, but it uses an input up to one interval ahead of its time. Setpoints are held (see
    ``setpoints.held_setpoint``).

    Args:
        signals: Signals with attitude and model inputs.
        segment: Span without gaps in both.
        dt: Step of the grid, s. By default the mean interval of the slower stream, to 0.1 ms. The mean, because an
            autopilot that rounds 10 ms to its cycles of 4 ms alternates between 8 and 12, and the median is neither.

    Returns:
        The flight, on the clock of the segment's boot.
    """
    attitude, motors = signals.attitude_and_inputs
    attitude_rows = rows_of_segment(attitude, segment)
    attitude_time = attitude.time[attitude_rows]
    motor_rows = rows_of_segment(motors, segment)
    motor_time = motors.time[motor_rows]
    rate = attitude.rate[attitude_rows]
    if signals.axis in TILT_AXES:
        motion = np.column_stack([attitude.angle[attitude_rows], rate])
    else:
        motion = rate[:, np.newaxis]

    if dt is None:
        dt = common_step((attitude_time, motor_time))
    grid = common_grid(attitude_time, motor_time, dt)
    outputs = resample(grid, dt, attitude_time, motion)
    inputs = resample(grid, dt, motor_time, motors.outputs[motor_rows])

    described_outputs = model_outputs(signals.axis)
    geometry = motors.geometry
    setpoints = _setpoints_of_outputs(signals)
    return Flight(
        time=grid,
        inputs=inputs.values,
        outputs=outputs.values,
        dt=dt,
        input_names=geometry.names,
        output_names=tuple(output.name for output in described_outputs),
        input_units=(motors.scale.unit,) * len(geometry.names),
        output_units=tuple(output.unit for output in described_outputs),
        provenance={
            **_source_provenance(signals, segment),
            "rates": {
                "attitude": round(mean_rate(attitude_time), 3),
                "motors": round(mean_rate(motor_time), 3),
            },
            "dt": dt,
            "resampling": {"attitude": str(outputs.method), "motors": str(inputs.method)},
            **_vehicle_provenance(signals, segment),
        },
        effect_directions=None if geometry.positions_assumed else geometry.mixer_row(signals.axis),
        setpoints=_setpoint_columns(setpoints, segment.boot, grid),
        setpoint_names=tuple(setpoint.name for setpoint in setpoints),
        setpoint_units=tuple(setpoint.unit for setpoint in setpoints),
    )


def _setpoints_of_outputs(signals: Signals) -> list[Setpoint]:
    """Returns the setpoints of those quantities of the axis that a flight has as outputs: of yaw only the rate."""
    output_units = [output.unit for output in model_outputs(signals.axis)]
    return [setpoint for setpoint in signals.setpoints if setpoint.unit in output_units]


def _setpoint_columns(setpoints: Sequence[Setpoint], boot: int, time: Array) -> Array | None:
    """Returns the values (T, k) of k setpoints at times (T,), s, of a boot; None if there are no setpoints."""
    if not setpoints:
        return None
    return np.column_stack([held_setpoint(setpoint, boot, time) for setpoint in setpoints])


def _source_provenance(signals: Signals, segment: Segment) -> JsonValues:
    """Returns the source of a flight, for its provenance: all that is needed to make the flight from the log again.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of one axis.
        segment: part of the log from which the flight is made.

    Returns:
        Values by name: ``source`` (name of the log), MAVLink ids and types of the vehicle, ``axis``, the ``segment``
        (boot, start and end in s), and the ``messages`` that attitude and model inputs (``motors``) were read from.
    """
    telemetry = signals.telemetry
    attitude, motors = signals.attitude_and_inputs
    return {
        "source": telemetry.source,
        "system": telemetry.system,
        "component": telemetry.component,
        "vehicle": telemetry.vehicle,
        "autopilot": telemetry.autopilot,
        "axis": signals.axis,
        "segment": asdict(segment),
        "messages": {"attitude": attitude.message, "motors": motors.message},
    }


def _vehicle_provenance(signals: Signals, segment: Segment) -> JsonValues:
    """Describes the vehicle and how its data were treated, for the provenance of a flight: where it comes from.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of one axis.
        segment: part of the log from which the flight is made.

    Returns:
        Values by name: ``motors`` (output channels, positions and spins, which of these are assumed, and the ``basis``,
        a sentence on where they come from), ``scale`` of the outputs, messages of the ``setpoints``, ``repairs`` of the
        data, ``parameters`` of the controller at the end of the log, and ``earlier``, those that had another value in
        this segment.
    """
    telemetry = signals.telemetry
    _, motors = signals.attitude_and_inputs
    geometry = motors.geometry
    control_parameters: dict[str, Any] = {}
    for name, value in telemetry.parameters.items():
        if CONTROL_PARAMETERS.match(name):
            control_parameters[name] = value
    scale = motors.scale
    return {
        "motors": {
            "channels": list(geometry.channels),
            "positions": [list(position) for position in geometry.positions],
            "basis": str(geometry.basis),
            "channels_assumed": geometry.channels_assumed,
            "positions_assumed": geometry.positions_assumed,
            "spins": list(geometry.spins),
        },
        # Documents call the upper limit "stop". They have no lower one, which follows from the parameters.
        "scale": {
            "name": scale.name,
            "unit": scale.unit,
            "low": scale.low,
            "high": scale.high,
            "step": scale.step,
            "stop": scale.upper_limit,
        },
        "setpoints": {
            setpoint.name: telemetry.name_in_source(setpoint.message)
            for setpoint in _setpoints_of_outputs(signals)
        },
        "repairs": [str(repair) for repair in telemetry.repairs],
        "parameters": control_parameters,
        "earlier": _earlier_parameters(signals, segment),
    }


def _earlier_parameters(signals: Signals, segment: Segment) -> Parameters:
    """Returns the controller's parameters whose values at the start of a segment differ from those at the log's end.

    Parameters that the autopilot itself changes in flight are left out.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segment: number of the boot, start and end of the segment of flight, s.

    Returns:
        Their values at the start of the segment, by name.
    """
    telemetry = signals.telemetry
    history = parameter_history(signals)
    values_at_start = history.at(BootTime(segment.boot, segment.start))
    earlier_values = {}
    # All parameters that never changed have their last value.
    for name in history.settings:
        value = values_at_start[name]
        is_control_parameter = CONTROL_PARAMETERS.match(name)
        is_set_by_autopilot = AUTOPILOT_SET_PARAMETERS.search(name)
        has_changed = telemetry.parameters.get(name) != value
        if is_control_parameter and not is_set_by_autopilot and has_changed:
            earlier_values[name] = value
    return earlier_values
