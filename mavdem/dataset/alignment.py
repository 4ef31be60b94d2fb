"""Alignment: attitude and inputs of a segment on one uniform clock, as a Flight."""

from dataclasses import asdict

import numpy as np

from mavdem.dataset.axes import output_names_and_units
from mavdem.dataset.resampling import common_grid, common_step, mean_rate, resample
from mavdem.dataset.segments import Segment, in_segments
from mavdem.dataset.setpoints import held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.flight import Flight
from mavdem.ingest.mavlink.definitions import decoded_parameters, latest_parameters
from mavdem.ingest.telemetry import (
    Columns,
    Parameters,
    selected_rows,
)
from mavdem.ingest.vocabulary import AUTOPILOT_SET_PARAMETERS, CONTROL_PARAMETERS


@cached_per_vehicle("axis", "inputs")
def aligned_flight(signals: Signals, segment: Segment, dt: float | None = None) -> Flight:
    """Returns the flight of a sampled ``segment``, uniform on the boot clock, in steps of ``dt``, s.

    Its inputs are one column a motor, or the demand (``Signals.drive``), its outputs angle and rate of the axis, of yaw
    the rate only.

    Unless given, the step is the mean interval of the slower of attitude and motors, to 0.1 ms. The mean, because an
    autopilot that rounds 10 ms to its 4 ms loop alternates 8 and 12 and the median is neither (but see ``_interval``).

    A stream with a sample within ``STAMP_SECONDS`` of every grid point keeps its samples as they are, unless it is so
    much faster that it has to be low-passed (see :func:`sample`). Otherwise it is interpolated linearly.

    A motor output is held by the ESC, but only until the mixer's next turn, a few ms later and long before the next
    message. Holding the last message would date every input half an interval late on average, a lag the model would
    learn; interpolation has none. It looks one message ahead: an input between two messages uses up to one interval of
    the future. Setpoints are held (see ``setpoints``).
    """
    attitude, motors = signals.attitude_and_inputs
    telemetry = signals.telemetry
    axis = signals.axis
    near = in_segments(attitude, segment)
    stamps = attitude.time[near]
    measured = output_names_and_units(axis)
    motion = np.column_stack([attitude.angle, attitude.rate])[:, -len(measured) :]
    drive = in_segments(motors, segment)
    driven = motors.time[drive]
    rates = {"attitude": mean_rate(stamps), "motors": mean_rate(driven)}
    dt = common_step((stamps, driven)) if dt is None else dt
    time = common_grid(stamps, driven, dt)
    outputs, attitude_way = resample(time, dt, stamps, motion[near])
    inputs, motors_way = resample(time, dt, driven, motors.outputs[drive])
    layout = motors.geometry
    scale = motors.scale
    asked = signals.setpoints
    return Flight(
        time=time,
        inputs=inputs,
        outputs=outputs,
        dt=dt,
        input_names=layout.names,
        output_names=tuple(name for name, _ in measured),
        input_units=(scale.unit,) * len(layout.names),
        output_units=tuple(unit for _, unit in measured),
        provenance={
            **{
                name: getattr(telemetry, name)
                for name in ("source", "system", "component", "vehicle", "autopilot")
            },
            "axis": axis,
            "segment": asdict(segment),
            "messages": {"attitude": attitude.message, "motors": motors.message},
            "rates": {name: round(rate, 3) for name, rate in rates.items()},
            "dt": dt,
            "resampling": {"attitude": str(attitude_way), "motors": str(motors_way)},
            "motors": {
                "channels": list(layout.channels),
                "positions": [list(position) for position in layout.positions],
                "basis": str(layout.basis),
                "channels_assumed": layout.channels_assumed,
                "positions_assumed": layout.positions_assumed,
                "spins": list(layout.spins),
            },
            "scale": asdict(scale),
            "setpoints": {
                setpoint.name: telemetry.name_in_source(setpoint.message) for setpoint in asked
            },
            "repairs": list(map(str, telemetry.repairs)),
            "parameters": {
                name: value
                for name, value in telemetry.parameters.items()
                if CONTROL_PARAMETERS.match(name)
            },
            "earlier": _earlier_parameters(signals, segment),
        },
        effect_directions=None if layout.positions_assumed else layout.mixer_row(axis),
        setpoints=np.column_stack(
            [held_setpoint(setpoint, segment.boot, time) for setpoint in asked]
        )
        if asked
        else None,
        setpoint_names=tuple(setpoint.name for setpoint in asked),
        setpoint_units=tuple(setpoint.unit for setpoint in asked),
    )


@cached_per_vehicle()
def _changed_parameter_messages(signals: Signals) -> Columns:
    """The messages of parameters that had other values than the last: few, where many boots send all again."""
    telemetry = signals.telemetry
    sent = telemetry.messages["PARAM_VALUE"]
    named = decoded_parameters(sent, telemetry.autopilot)
    changed = {name for name, value in named if value != telemetry.parameters.get(name)}
    return selected_rows(sent, np.array([name in changed for name, _ in named], dtype=bool))


def _earlier_parameters(signals: Signals, segment: Segment) -> Parameters:
    """The controller's parameters that changed after the segment began, or sometime, with their values before."""
    telemetry = signals.telemetry
    before = telemetry.initial_parameters
    if "PARAM_VALUE" in telemetry.messages:
        sent = _changed_parameter_messages(signals)
        rows = (sent["boot"] < segment.boot) | (
            (sent["boot"] == segment.boot) & (sent["time"] <= segment.start)
        )
        before = latest_parameters(selected_rows(sent, rows), telemetry.autopilot)
    return {
        name: value
        for name, value in before.items()
        if CONTROL_PARAMETERS.match(name)
        and not AUTOPILOT_SET_PARAMETERS.search(name)
        and telemetry.parameters[name] != value
    }
