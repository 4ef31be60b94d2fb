"""Controllers: what an autopilot's parameters say of the rate and attitude controller of one axis, and of its mixer.

Units are the autopilots' own: rates in rad/s, and a demand of 1 is all that the mixer takes. Sources: ``AC_PID``,
``AP_MotorsMatrix`` and ``AP_Motors_Thrust_Linearization`` of https://github.com/ArduPilot/ardupilot; ``rate_control``,
``VehicleAngularVelocity`` and ``ControlAllocationPseudoInverse`` of https://github.com/PX4/PX4-Autopilot.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from mavdem.errors import NotLearnable

USED = re.compile(
    r"ATC_RAT_|ATC_ANG_(RLL|PIT|YAW)_P$|INS_GYRO_FILTER$|SCHED_LOOP_RATE$|FSTRATE_ENABLE$|FRAME_CLASS$|FRAME_TYPE$|"
    r"MOT_(THST_EXPO|SPIN_MIN|SPIN_MAX|BAT_VOLT_M..|BAT_V_M..)$|MC_(ROLL|PITCH|YAW)|MC_BAT_SCALE_EN$|THR_MDL_FAC$|"
    r"IMU_GYRO_(CUTOFF|RATEMAX)$|IMU_DGYRO_CUTOFF$|CA_(AIRFRAME|ROTOR_COUNT)$|CA_ROTOR[0-3]_"
)
"""Names of the parameters that a controller depends on, of any autopilot."""
MOTORS = 4  # Of the frames whose mixer is known
ASK = "Record all parameters: log from the first connection, or ask for the parameter list once while recording."


@dataclass(frozen=True)
class Controller:
    """The rate and the attitude controller of one axis; cut-offs in Hz, 0 where there is no filter.

    Attributes:
        axis: "roll", "pitch" or "yaw".
        p, i, d, ff: demand per rad/s, rad and rad/s² of the error, and per rad/s of the setpoint.
        angle: rate setpoint per error of the angle, 1/s.
        target_filter, error_filter, derivative_filter, output_filter: of first-order low-passes.
        derivative_of_error: whether the error is differentiated (ArduPilot), or the rate alone (PX4).
        gyro_filter: of the second-order low-pass of the gyro, behind which rates are logged.
        cycle: s.
        mixer: (4,) thrust, as a share of a motor's most, that a demand of 1 adds to each motor.
        expo: quadratic share of the thrust curve that the autopilot undoes.
        spin: shares of the output's range at which thrust begins and ends.
        parameters: what it was made of, with all that :data:`USED` names.
        weights: (4,) of the motors in the axis's torque, where the parameters do not give them.
        names: the parameter behind "p", "i", "d" and so on.
        cautions: what is not modelled, one sentence each.
    """

    axis: str
    p: float
    i: float
    d: float
    ff: float
    angle: float
    target_filter: float
    error_filter: float
    derivative_filter: float
    output_filter: float
    derivative_of_error: bool
    gyro_filter: float
    cycle: float
    mixer: tuple[float, ...]
    expo: float
    spin: tuple[float, float]
    parameters: Mapping[str, float] = field(repr=False)
    weights: tuple[float, ...]
    names: Mapping[str, str] = field(repr=False)
    cautions: tuple[str, ...] = ()

    def per_demand(self, shares: Sequence[float]) -> tuple[float, ...]:
        """Returns (4,) how far a demand of 1 moves outputs that are at ``shares`` of their range, as such shares."""
        begin, end = self.spin
        thrust = [min(max((share - begin) / (end - begin), 0.0), 1.0) for share in shares]
        slopes = [(end - begin) / (1 - self.expo + 2 * self.expo * one) for one in thrust]
        return tuple(factor * slope for factor, slope in zip(self.mixer, slopes, strict=True))

    def changed(self, parameters: Mapping[str, float]) -> Controller:
        """Returns the controller with other values of some ``parameters``, by name."""
        return controller_of({**self.parameters, **parameters}, self.axis, self.weights)


def controller_of(parameters: Mapping[str, float], axis: str = "roll", weights: Sequence[float] = ()) -> Controller:
    """Returns the controller that an autopilot's ``parameters`` describe.

    Args:
        parameters: values by name, as the autopilot calls them; others than :data:`USED` do not count.
        axis: "roll", "pitch" or "yaw".
        weights: (4,) of the motors in the axis's torque, of any size; PX4's parameters have them.

    Raises:
        NotLearnable: a parameter is missing, or the firmware or the mixer is not known.
    """
    own = {name: float(value) for name, value in parameters.items() if USED.match(name) and isfinite(value)}
    if any(name.startswith("ATC_RAT_") for name in own):
        return _ardupilot(own, axis, tuple(float(one) for one in weights))
    if any(name.startswith("MC_") for name in own):
        return _px4(own, axis)
    raise NotLearnable("The log has no gains of ArduPilot's or PX4's rate controller.", ASK)


def _required(parameters: Mapping[str, float], *names: str) -> list[float]:
    missing = [name for name in names if name not in parameters]
    if missing:
        raise NotLearnable(f"The log has no {', '.join(missing)}.", ASK)
    return [parameters[name] for name in names]


def _ardupilot(parameters: Mapping[str, float], axis: str, weights: tuple[float, ...]) -> Controller:
    short = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}[axis]
    rate, angle = f"ATC_RAT_{short}_", f"ATC_ANG_{short}_P"
    names = {"p": f"{rate}P", "i": f"{rate}I", "d": f"{rate}D", "ff": f"{rate}FF", "angle": angle}
    p, i, d, stiff = _required(parameters, names["p"], names["i"], names["d"], angle)
    if parameters.get("FRAME_CLASS") != 1:
        raise NotLearnable("The mixer is known of quadrotors with FRAME_CLASS 1 only, and this is another.")
    if len(weights) != MOTORS or not any(weights):
        raise NotLearnable("The weights of four motors in the mixer are not known: FRAME_TYPE is missing or special.")
    largest = 2 * max(map(abs, weights))  # the largest factor is a half
    # Before ArduCopter 4.0 one filter, of the error, was for all.
    filters = {"error_filter": f"{rate}FILT"} if f"{rate}FILT" in parameters else {}
    if not filters:
        filters = {"target_filter": f"{rate}FLTT", "error_filter": f"{rate}FLTE", "derivative_filter": f"{rate}FLTD"}
    cutoffs = dict(zip(filters, _required(parameters, *filters.values()), strict=True))
    expo, begin, end = _required(parameters, "MOT_THST_EXPO", "MOT_SPIN_MIN", "MOT_SPIN_MAX")
    doubts = {
        f"{rate}SMAX": "limits the slew of P and D, and so the gains while the motors are busy",
        f"{rate}PDMX": "limits the sum of P and D",
        f"{rate}NEF": "puts a notch filter on the error, which is not modelled",
        "FSTRATE_ENABLE": "runs the rate loop faster than SCHED_LOOP_RATE",
    }
    return Controller(
        axis=axis,
        p=p,
        i=i,
        d=d,
        ff=parameters.get(names["ff"], 0.0),
        angle=stiff,
        target_filter=cutoffs.get("target_filter", 0.0),
        error_filter=cutoffs["error_filter"],
        derivative_filter=cutoffs.get("derivative_filter", 0.0),
        output_filter=0.0,
        derivative_of_error=True,
        gyro_filter=parameters.get("INS_GYRO_FILTER", 0.0),
        cycle=1 / parameters.get("SCHED_LOOP_RATE", 400.0),
        mixer=tuple(one / largest for one in weights),
        expo=expo,
        spin=(begin, end),
        parameters=parameters,
        weights=weights,
        names=names | filters,
        cautions=_cautions(parameters, doubts),
    )


def _px4(parameters: Mapping[str, float], axis: str) -> Controller:
    rate, angle = f"MC_{axis.upper()}RATE_", f"MC_{axis.upper()}_P"
    names = {"p": f"{rate}P", "i": f"{rate}I", "d": f"{rate}D", "ff": f"{rate}FF", "angle": angle}
    p, i, d, stiff = _required(parameters, names["p"], names["i"], names["d"], angle)
    count, airframe, differentiated = _required(parameters, "CA_ROTOR_COUNT", "CA_AIRFRAME", "IMU_DGYRO_CUTOFF")
    if count != MOTORS or airframe:
        raise NotLearnable("The mixer is known of multirotors with four motors only (CA_AIRFRAME 0, CA_ROTOR_COUNT 4).")
    scale = parameters.get(f"{rate}K", 1.0)
    doubts = {"MC_BAT_SCALE_EN": "scales the demand with the battery's voltage, which is not modelled"}
    return Controller(
        axis=axis,
        p=scale * p,
        i=scale * i,
        d=scale * d,
        ff=parameters.get(names["ff"], 0.0),
        angle=stiff,
        target_filter=0.0,
        error_filter=0.0,
        derivative_filter=differentiated,
        output_filter=parameters.get("MC_YAW_TQ_CUTOFF", 0.0) if axis == "yaw" else 0.0,
        derivative_of_error=False,
        gyro_filter=parameters.get("IMU_GYRO_CUTOFF", 0.0),
        cycle=1 / parameters.get("IMU_GYRO_RATEMAX", 400.0),
        mixer=_allocation(parameters)[axis],
        expo=_required(parameters, "THR_MDL_FAC")[0],
        spin=(0.0, 1.0),
        parameters=parameters,
        weights=(),
        names=names | {"derivative_filter": "IMU_DGYRO_CUTOFF"},
        cautions=_cautions(parameters, doubts),
    )


def _allocation(parameters: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
    """PX4's mixer by axis: the inverse of the motors' torques and thrust, normalised as the control allocator does."""
    x, y, moment = (
        np.array(_required(parameters, *(f"CA_ROTOR{n}_{name}" for n in range(MOTORS)))) for name in ("PX", "PY", "KM")
    )
    tilted = [parameters.get(f"CA_ROTOR{n}_A{name}", 0.0) for n in range(MOTORS) for name in "XY"]
    effects = np.array([-y, x, moment, np.ones(MOTORS)])
    if any(tilted) or np.ptp([parameters.get(f"CA_ROTOR{n}_CT", 1.0) for n in range(MOTORS)]):
        raise NotLearnable("The mixer is known of motors alike and upright only, by CA_ROTORn_AX, _AY and _CT.")
    if np.linalg.matrix_rank(effects) < MOTORS:
        raise NotLearnable("By CA_ROTORn_PX, _PY and _KM the four motors do not control all axes: check the geometry.")
    mixer = np.linalg.inv(effects)
    moved = np.abs(mixer[:, :2]) > 1e-3 * np.abs(mixer[:, :2]).max()
    tilt = float(np.sqrt((mixer[:, :2] ** 2).sum(axis=0) / (moved.sum(axis=0) / 2)).max())
    scaled = mixer[:, :3] / [tilt, tilt, mixer[:, 2].max()]
    return {axis: tuple(column.tolist()) for axis, column in zip(("roll", "pitch", "yaw"), scaled.T, strict=True)}


def _cautions(parameters: Mapping[str, float], doubts: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(f"{name} = {parameters[name]:g} {why}." for name, why in doubts.items() if parameters.get(name))
