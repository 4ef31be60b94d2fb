"""Controllers: what an autopilot's parameters say of one axis's rate and attitude controller, and of the mixer.

A demand of 1 is all that the mixer takes. Sources: ``AC_PID``, ``AP_MotorsMatrix`` and ``Thrust_Linearization`` of
https://github.com/ArduPilot/ardupilot; ``RateControl`` and ``ControlAllocation`` of https://github.com/PX4/PX4-Autopilot.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from mavdem.errors import NotLearnable

USED = re.compile(
    r"ATC_RAT_|ATC_ANG_(RLL|PIT|YAW)_P$|INS_GYRO_FILTER$|SCHED_LOOP_RATE$|FSTRATE_ENABLE$|FRAME_CLASS$|"
    r"MOT_(THST_EXPO|SPIN_MIN|SPIN_MAX|BAT_VOLT_MAX)$|MC_(ROLL|PITCH|YAW)|MC_BAT_SCALE_EN$|THR_MDL_FAC$|"
    r"IMU_GYRO_(CUTOFF|RATEMAX)$|IMU_DGYRO_CUTOFF$|CA_(AIRFRAME|ROTOR_COUNT)$|CA_ROTOR[0-3]_"
)
"""Names of the parameters that a controller depends on."""
# of the frames that are known; Hz of a rate loop; slope of a thrust curve
MOTORS = 4
SLOWEST = 50.0
FLATTEST = 0.1
LOOP_RATES = {"px4": "IMU_GYRO_RATEMAX", "ardupilot": "SCHED_LOOP_RATE"}  # the parameters of it
ASK = "Record all parameters: log from the first connection, or ask for the parameter list once while recording."
LOWEST_CUTOFF = 0.1  # Hz, of a filter that is on
RANGES = {
    **dict.fromkeys(("p", "i", "d", "ff"), (0.0, 1e3)),
    "angle": (1e-3, 1e3),
    **dict.fromkeys(
        ("target_filter", "error_filter", "derivative_filter", "output_filter", "gyro_filter"),
        (0.0, 1e4),
    ),
    "cycle": (1e-5, 1 / SLOWEST),
    "expo": (-1.0, 1.0),
}
"""From the least to the most that each figure of a controller can be."""
DOUBTS = {
    "SMAX": "limits the slew of P and D, and so the gains while the motors are busy",
    "PDMX": "limits the sum of P and D",
    "NEF": "puts a notch filter on the error, which is not modelled",
    "FSTRATE_ENABLE": "runs the rate loop faster than SCHED_LOOP_RATE",
    "MOT_BAT_VOLT_MAX": "scales the mixer with the battery's voltage, by up to a fifth, which is not modelled",
    "MC_BAT_SCALE_EN": "scales the demand with the battery's voltage, which is not modelled",
}


@dataclass(frozen=True)
class Controller:
    """The rate and the attitude controller of one axis; cut-offs are in Hz, 0 where there is no filter."""

    axis: str  # "roll", "pitch" or "yaw"
    p: float  # with i, d: demand per rad/s, rad and rad/s² of the error
    i: float
    d: float
    ff: float  # demand per rad/s of the setpoint
    angle: float  # rate setpoint per error of the angle, 1/s
    target_filter: float  # with error_, derivative_, output_filter: of first-order low-passes
    error_filter: float
    derivative_filter: float
    output_filter: float
    gyro_filter: float  # of the gyro's second-order low-pass, behind which rates are logged
    derivative_of_error: bool  # ArduPilot differentiates the error, PX4 the rate alone
    cycle: float  # s
    # (4,) thrust that a demand of 1 adds to each motor, as a share of its most
    mixer: tuple[float, ...]
    expo: float  # quadratic share of the thrust curve that the autopilot undoes
    spin: tuple[float, float]  # shares of the output's range at which thrust begins and ends
    names: Mapping[str, str]  # the parameter behind "p", "i", "d" and so on
    parameters: Mapping[str, float]  # all that it was made of
    # (4,) likewise, of the motors in the axis's torque, with ArduPilot
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high or (name.endswith("filter") and 0 < value < LOWEST_CUTOFF):
                what = f"{self.names.get(name, name.replace('_', ' '))} is {value:g}"
                raise NotLearnable(
                    f"{what}, which no autopilot flies with.", "Check the parameters of the log."
                )

    @property
    def cautions(self) -> tuple[str, ...]:
        """What is not modelled, one sentence each."""
        doubts = {
            name if "_" in name else self.names["p"][:-1] + name: why
            for name, why in DOUBTS.items()
        }
        return tuple(f"{name} {why}." for name, why in doubts.items() if self.parameters.get(name))

    def per_demand(self, shares: Sequence[float]) -> tuple[float, ...]:
        """Returns (4,) how far a demand of 1 moves outputs that are at ``shares`` of their range, as such shares."""
        begin, end = self.spin
        thrust = [min(max((share - begin) / (end - begin), 0.0), 1.0) for share in shares]
        slopes = [
            (end - begin) / max(1 - self.expo + 2 * self.expo * one, FLATTEST) for one in thrust
        ]
        return tuple(factor * slope for factor, slope in zip(self.mixer, slopes, strict=True))

    def changed(self, parameters: Mapping[str, float]) -> Controller:
        """Returns the controller with other values of some ``parameters``, by name."""
        return controller_of({**self.parameters, **parameters}, self.axis, self.weights)


def controller_of(
    parameters: Mapping[str, float], axis: str = "roll", weights: Sequence[float] = ()
) -> Controller:
    """Returns the controller that an autopilot's ``parameters`` describe, of which only :data:`USED` count.

    ``weights`` (4,) are those of the motors in the axis's torque, of any size; PX4's parameters have them. A single one
    is of the demand itself. Raises ``NotLearnable``: a parameter is missing, or the firmware or the mixer is not known.
    """
    own = {
        name: float(value)
        for name, value in parameters.items()
        if USED.match(name) and isfinite(value)
    }
    ardupilot = any(name.startswith("ATC_RAT_") for name in own)
    if not ardupilot and not any(name.startswith("MC_") for name in own):
        raise NotLearnable("The log has no gains of ArduPilot's or PX4's rate controller.", ASK)
    short = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}[axis] if ardupilot else axis.upper()
    rate, angle = (
        (f"ATC_RAT_{short}_", f"ATC_ANG_{short}_P")
        if ardupilot
        else (f"MC_{short}RATE_", f"MC_{short}_P")
    )
    names = {"p": f"{rate}P", "i": f"{rate}I", "d": f"{rate}D", "angle": angle}
    if ardupilot:  # before ArduCopter 4.0 one filter, of the error, was for all
        filters = {"target_filter": "FLTT", "error_filter": "FLTE", "derivative_filter": "FLTD"}
        filters = {"error_filter": "FILT"} if f"{rate}FILT" in own else filters
        names |= {name: rate + end for name, end in filters.items()} | {"expo": "MOT_THST_EXPO"}
    else:
        names |= {"derivative_filter": "IMU_DGYRO_CUTOFF", "expo": "THR_MDL_FAC"}
    values = {"target_filter": 0.0, "error_filter": 0.0, "derivative_filter": 0.0}
    values |= dict(zip(names, _required(own, *names.values()), strict=True))
    begin = 0.0
    end = 1.0
    mixer: tuple[float, ...] = (1.0,)
    if ardupilot:
        if len(weights) != 1:
            begin, end, frame = _required(own, "MOT_SPIN_MIN", "MOT_SPIN_MAX", "FRAME_CLASS")
            if frame != 1 or len(weights) != MOTORS or not any(weights) or not begin < end:
                raise NotLearnable(
                    "The mixer is not known: this needs a quadrotor of a usual FRAME_CLASS and FRAME_TYPE."
                )
            mixer = tuple(float(one) / max(map(abs, weights)) / 2 for one in weights)
        gyro = own.get("INS_GYRO_FILTER", 0.0)
        cycle = 1 / max(own.get("SCHED_LOOP_RATE", 400.0), SLOWEST)
        output = 0.0
    else:
        values |= {gain: own.get(f"{rate}K", 1.0) * values[gain] for gain in "pid"}
        mixer = mixer if len(weights) == 1 else _allocation(own)[axis]
        gyro = own.get("IMU_GYRO_CUTOFF", 0.0)
        cycle = 1 / max(own.get("IMU_GYRO_RATEMAX", 400.0), SLOWEST)
        output = own.get("MC_YAW_TQ_CUTOFF", 0.0) if axis == "yaw" else 0.0
    more = {
        "ff": own.get(f"{rate}FF", 0.0),
        "output_filter": output,
        "gyro_filter": gyro,
        "cycle": cycle,
    }
    known = {
        "names": names,
        "parameters": own,
        "weights": tuple(map(float, weights)),
        "mixer": mixer,
    }
    return Controller(
        axis,
        spin=(begin, end),
        derivative_of_error=ardupilot,
        **values,  # type: ignore[arg-type]
        **more,  # type: ignore[arg-type]
        **known,  # type: ignore[arg-type]
    )


def _required(parameters: Mapping[str, float], *names: str) -> list[float]:
    if missing := [name for name in names if name not in parameters]:
        raise NotLearnable(f"The log has no {', '.join(missing)}.", ASK)
    return [parameters[name] for name in names]


def _allocation(parameters: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
    """PX4's mixer by axis: the inverse of the motors' torques and thrust, normalised as the control allocator does."""
    four = range(MOTORS)
    x, y, moment = (
        _required(parameters, *(f"CA_ROTOR{n}_{name}" for n in four)) for name in ("PX", "PY", "KM")
    )
    tilts = [parameters.get(f"CA_ROTOR{n}_A{name}", 0.0) for n in four for name in "XY"]
    sizes = {parameters.get(f"CA_ROTOR{n}_CT", 0.0) for n in four}
    effects = np.array([np.negative(y), x, moment, np.ones(MOTORS)])
    other = (
        parameters.get("CA_ROTOR_COUNT") != MOTORS
        or parameters.get("CA_AIRFRAME", 0.0)
        or any(tilts)
    )
    if other or len(sizes) > 1 or np.linalg.cond(effects) > 1e6:
        raise NotLearnable(
            "The mixer is not known: this needs four upright motors alike (CA_AIRFRAME 0, CA_ROTORn_*)."
        )
    inverse = np.linalg.inv(effects)[:, :3]
    tilting = np.abs(inverse[:, :2]) > 1e-3 * np.abs(inverse).max()
    most = np.sqrt((inverse[:, :2] ** 2).sum(axis=0) / (tilting.sum(axis=0) / 2)).max()
    scaled = inverse / [most, most, inverse[:, 2].max()]
    return {
        axis: tuple(column)
        for axis, column in zip(("roll", "pitch", "yaw"), scaled.T.tolist(), strict=True)
    }
