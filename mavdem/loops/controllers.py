"""Controllers: what an autopilot's parameters say of one axis's rate and attitude controller, and of the mixer.

A demand of 1 is all that the mixer takes. Sources: ``AC_PID``, ``AP_NotchFilter_params``, ``AP_MotorsMatrix``,
``Thrust_Linearization`` and ``HarmonicNotchFilter`` of https://github.com/ArduPilot/ardupilot; ``RateControl``,
``ControlAllocation`` and ``VehicleAngularVelocity`` of https://github.com/PX4/PX4-Autopilot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.containers import JsonValues, Numbers
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import Controllers
from mavdem.immutable import ImmutableResult
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.plant.closed_loop.parameters import TYPICAL_VALUES

MOTORS = 4  # of the frames whose mixer is known
# Hz of a rate loop
MIN_LOOP_RATE = 50.0
MAX_LOOP_RATE = 1000.0
DEFAULT_LOOP_RATES = {"px4": 250.0, "ardupilot": 400.0}
"""Hz of the rate loop where nobody says it: PX4's in its simulators, ArduCopter's SCHED_LOOP_RATE by default."""
LOOP_RATE_PARAMETERS = {"px4": "IMU_GYRO_RATEMAX", "ardupilot": "SCHED_LOOP_RATE"}
"""The parameter of the rate loop's frequency, Hz."""
RANGES = {
    **dict.fromkeys(("p", "i", "d", "ff"), (0.0, 1e3)),
    "angle": (1e-3, 1e3),
    **dict.fromkeys(
        ("target_filter", "error_filter", "derivative_filter", "output_filter", "gyro_filter"),
        (0.0, 1e4),
    ),
    "cycle": (1e-5, 1 / MIN_LOOP_RATE),
    "expo": (-1.0, 1.0),
}
"""From the least to the most that each figure of a controller can be; a filter that is on has at least 0.1 Hz."""
OLD_X_FRAMES = (1.0, 2.0, 3.0)  # FRAME: X, V and H
OLD_SCALE = 1.27
OLD_SCALE_X = 0.9
"""What ArduCopter 3.4 multiplied the rate gains of earlier versions by (``convert_pid_parameters`` in ArduCopter's
``Parameters.cpp``): they were of 0.01 °/s and of 4500 for full demand, and in an X that turned less."""
TYPICAL_ROTOR_LAG = TYPICAL_VALUES["lag"]  # s, of common rotors' speeds
ROTOR_LAG_CORRECTION = 0.5
"""Of what lagging speeds change: all of it made effects at limits as much too small as none of it too large, on half of
the flights of ``tools/validation/loops.py``. Why it is half is not known."""
UNMODELLED_PARAMETERS = {
    "SMAX": Controllers.SLEW_LIMITED,
    "PDMX": Controllers.SUM_LIMITED,
    "FSTRATE_ENABLE": Controllers.RATE_LOOP_FASTER,
    "MOT_BAT_VOLT_MAX": Controllers.MIXER_BY_VOLTAGE,
    "MC_BAT_SCALE_EN": Controllers.DEMAND_BY_VOLTAGE,
    "IMU_GYRO_DNF_EN": Controllers.NOTCHES_UNMODELLED,
}
"""By the parameter that is not 0, or its end where each axis has its own."""
NOTCHES = ("INS_HNTCH_", "INS_HNTC2_", "INS_HNTC3_", "INS_NOTCH_")
"""How the parameters of ArduPilot's notch filters of the gyro begin; the last was a single one, before 4.2."""


class Notch(NamedTuple):
    """A notch filter; ``bandwidth`` over ``frequency`` is that of its poles, the inverse of its Q."""

    frequency: float  # of its centre, Hz
    bandwidth: float  # Hz, between the frequencies that lose half of their power where it is deep
    attenuation: float  # dB at its centre, perhaps infinite


@dataclass(frozen=True, kw_only=True)
class Controller(ImmutableResult):
    """The rate and the attitude controller of one axis; cut-offs are in Hz, 0 where there is no filter."""

    axis: str  # "roll", "pitch" or "yaw"
    p: float  # with i, d: demand per rad/s, rad and rad/s² of the error
    i: float
    d: float
    ff: float  # demand per rad/s of the setpoint
    derivative_ff: float = 0.0  # and per rad/s² of it
    angle: float  # rate setpoint per error of the angle, 1/s
    target_filter: float = 0.0  # with error_, derivative_, output_filter: of first-order low-passes
    error_filter: float = 0.0
    derivative_filter: float = 0.0
    output_filter: float = 0.0
    target_notches: tuple[Notch, ...] = ()  # before these low-passes
    error_notches: tuple[Notch, ...] = ()
    # of the gyro's second-order low-pass and its notch filters, behind which rates are logged; at gyro_rate, Hz
    gyro_filter: float
    notches: tuple[Notch, ...] = ()
    gyro_rate: float = 1000.0
    derivative_of_error: bool  # ArduPilot differentiates the error, PX4 the rate alone
    cycle: float  # s
    # (4,) thrust that a demand of 1 adds to each motor, as a share of its most
    mixer: Numbers
    expo: float  # quadratic share of the thrust curve that the autopilot undoes
    # shares of the output's range at which thrust begins and ends
    spin: tuple[float, float] = (0.0, 1.0)
    names: Mapping[str, str]  # the parameter behind "p", "i", "d" and so on
    parameters: Parameters  # all that it was made of
    # (4,) likewise, of the motors in the axis's torque, with ArduPilot
    weights: Numbers = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            slow = name.endswith("filter") and 0 < value < 0.1
            if slow or not low <= value <= high:
                parameter = self.names.get(name, name.replace("_", " "))
                raise NotLearnable(Controllers.PARAMETER_IMPOSSIBLE, name=parameter, value=value)

    @property
    def cautions(self) -> Facts:
        """What is not modelled."""
        own = self.parameters
        rate = self.names["p"][:-1]
        names = {
            end if "_" in end else rate + end: code for end, code in UNMODELLED_PARAMETERS.items()
        }
        for prefix in NOTCHES:
            # it is on and follows what parameters do not have: motors' speeds, or peaks of a spectrum
            if own.get(f"{prefix}ENABLE") and own.get(f"{prefix}MODE", 0.0) > 1:
                names[f"{prefix}MODE"] = Controllers.NOTCHES_MOVING
        return tuple(Fact(code, name=name) for name, code in names.items() if own.get(name))

    def outputs_per_demand(self, shares: Sequence[float]) -> Numbers:
        """Returns (4,) how far a demand of 1 moves outputs that are at ``shares`` of their range, as such shares."""
        begin, end = self.spin
        thrust = self._thrust(np.asarray(shares))
        # The curve is nowhere flatter than a tenth of the straight one.
        steepness = 1 - self.expo + 2 * self.expo * thrust
        slopes = (end - begin) / np.maximum(steepness, 0.1)
        return tuple((slopes * self.mixer).tolist())

    def demand_from_outputs(self, shares: Array, step: float = 0.0) -> Array:
        """Returns (T,) the demand, up to a constant, that brings outputs to ``shares`` (T, r) of their range.

        By the curve that the autopilot undoes: a straight one takes demands about other axes for some about this one.
        With a ``step`` between them, s, it is the demand of the same torque by thrusts that lag evenly.
        """
        if shares.shape[1] == 1:
            return 2 * shares[:, 0]  # from -1 to 1
        thrust = self._thrust(shares)
        thrust = (1 - self.expo + self.expo * thrust) * thrust
        if 0 < step < TYPICAL_ROTOR_LAG:
            thrust = thrust - ROTOR_LAG_CORRECTION * _behind(np.sqrt(thrust), step) ** 2
        mixer = np.array(self.mixer)
        return thrust @ mixer / (mixer @ mixer)

    def _thrust(self, shares: Array) -> Array:
        """As a straight curve has it."""
        begin, end = self.spin
        return np.clip((shares - begin) / (end - begin), 0.0, 1.0)

    def at_limit(self, shares: Array, stop: float = 1.0) -> Flags:
        """Returns (T,) whether some output, at ``shares`` (T, r) of the range, is within 0.5 % of its end or stop."""
        begin, end = (0.0, 1.0) if shares.shape[1] == 1 else self.spin
        at_limit = (shares <= begin + 0.005) | (shares >= min(end, stop) - 0.005)
        return np.asarray(at_limit.any(axis=1))

    def with_parameters(self, parameters: Parameters) -> Controller:
        """Returns the controller with other values of some ``parameters``, by name."""
        return controller_from_parameters(
            {**self.parameters, **parameters}, self.axis, self.weights
        )


def _behind(speeds: Array, step: float) -> Array:
    """(T, r) by how much rotors are slower than the ``speeds`` that they are to have, a ``step`` of s apart.

    Speeds lag, and thrusts are their squares: a thrust of x² changes like one that lags behind y² - (y - x)², for the
    speed y that is asked for.
    """
    from scipy.signal import lfilter  # it takes half a second to import

    keeps = np.exp(-step / TYPICAL_ROTOR_LAG)
    reached, _ = lfilter([0.0, 1 - keeps], [1.0, -keeps], speeds, axis=0, zi=speeds[:1])
    return speeds - reached


def controller_from_parameters(
    parameters: Parameters, axis: str = "roll", weights: Sequence[float] = ()
) -> Controller:
    """Returns the controller that an autopilot's ``parameters`` describe, of which ``CONTROL_PARAMETERS`` count.

    ``weights`` (4,) are those of the motors in the axis's torque, of any size; PX4's parameters have them. A single one
    is of the demand itself. Raises ``NotLearnable``: a parameter is missing, or the firmware or the mixer is not known.
    """
    own = {
        name: float(value)
        for name, value in parameters.items()
        if CONTROL_PARAMETERS.match(name) and isfinite(value)
    }
    given = tuple(map(float, weights))
    if any(name.startswith(("ATC_RAT_", "RATE_RLL_")) for name in own):
        values = _ardupilot(own, axis, given)
    elif any(name.startswith("MC_") for name in own):
        values = _px4(own, axis, len(given) == 1)
    else:
        raise NotLearnable(Controllers.NO_GAINS)
    return Controller(axis=axis, parameters=own, weights=given, **values)


def _ardupilot(own: Parameters, axis: str, weights: Numbers) -> JsonValues:
    """The fields of an ArduPilot's controller."""
    short = {"roll": "RLL", "pitch": "PIT", "yaw": "YAW"}[axis]
    rate = f"ATC_RAT_{short}_"
    filters = {"target_filter": "FLTT", "error_filter": "FLTE", "derivative_filter": "FLTD"}
    if f"{rate}FILT" in own:  # before ArduCopter 4.0 one filter, of the error, was for all
        filters = {"error_filter": "FILT"}
    angle = f"ATC_ANG_{short}_P"
    is_old = f"{rate}P" not in own and f"RATE_{short}_P" in own
    if is_old:
        rate = f"RATE_{short}_"
        angle = f"STB_{short}_P"
        filters = {"error_filter": "FILT_HZ"}
    names = {"p": f"{rate}P", "i": f"{rate}I", "d": f"{rate}D", "angle": angle}
    names |= {name: rate + end for name, end in filters.items()} | {"expo": "MOT_THST_EXPO"}
    values_of = _gains(own, names, rate)
    if is_old:
        is_x = len(weights) != 1 and own.get("FRAME") in OLD_X_FRAMES
        scale = OLD_SCALE_X if is_x else OLD_SCALE
        values_of |= {gain: scale * values_of[gain] for gain in "pid"}
    values_of |= {
        "gyro_filter": own.get("INS_GYRO_FILTER", 0.0),
        "gyro_rate": 1000 * 2 ** np.clip(own.get("INS_GYRO_RATE", 0.0), 0.0, 3.0),
        "notches": tuple(notch for prefix in NOTCHES for notch in _harmonic_notches(own, prefix)),
        "derivative_ff": own.get(f"{rate}D_FF", 0.0),
        "target_notches": tuple(_pid_notches(own, f"{rate}NTF")),
        "error_notches": tuple(_pid_notches(own, f"{rate}NEF")),
        "derivative_of_error": True,
        "cycle": 1 / max(own.get("SCHED_LOOP_RATE", 400.0), MIN_LOOP_RATE),
        "mixer": (1.0,),
    }
    if len(weights) != 1:
        if is_old:  # of a quadrotor, as its firmware was; THR_MIN is in thousandths
            begin, end = _required(own, "THR_MIN", "MOT_THST_MAX")
            begin /= 1000
            frame = 1.0
        else:
            begin, end, frame = _required(own, "MOT_SPIN_MIN", "MOT_SPIN_MAX", "FRAME_CLASS")
        if frame != 1 or len(weights) != MOTORS or not any(weights) or not begin < end:
            raise NotLearnable(Controllers.MIXER_UNKNOWN, autopilot="ardupilot")
        largest = max(map(abs, weights))
        values_of["mixer"] = tuple(weight / largest / 2 for weight in weights)
        values_of["spin"] = (begin, end)
    return values_of


def _harmonic_notches(own: Parameters, prefix: str) -> Iterator[Notch]:
    """Of a filter that is on: one that follows the throttle is where it hovers, another moving one at its lowest.

    Two or three beside each other, as its options may have them, are as late as the single one, within 3° at a quarter
    of its frequency.
    """
    if not own.get(f"{prefix}ENABLE"):
        return
    base, bandwidth, depth = _required(own, *(prefix + end for end in ("FREQ", "BW", "ATT")))
    base = max(base, 0.52 * bandwidth)
    if base <= 0:
        return
    mode = own.get(f"{prefix}MODE", 0.0)  # 1 the throttle, 3 motors' speeds, 4 peaks of spectra
    reference = own.get(f"{prefix}REF", 0.0)
    centre = base
    if mode == 1 and reference > 0:
        throttle = own.get("MOT_THST_HOVER", reference) / reference
        centre *= max(own.get(f"{prefix}FM_RAT", 1.0), sqrt(max(throttle, 0.0)))
    # each motor, or each of three peaks, with notches of its own
    each = int(own.get(f"{prefix}OPTS", 0.0)) & 2
    sources = {3.0: MOTORS, 4.0: 3}.get(mode, 1) if each else 1
    for notch in _harmonics(centre, bandwidth / base, depth, own.get(f"{prefix}HMNCS", 1.0)):
        yield from [notch] * sources


def _pid_notches(own: Parameters, name: str) -> Iterator[Notch]:
    """Of setpoint or error: the parameter of this ``name`` has the number of the filter, if any."""
    number = int(own.get(name, 0.0))
    prefix = f"FILT{number}_"
    if not number or own.get(f"{prefix}TYPE") == 0:
        return
    ends = "NOTCH_FREQ", "NOTCH_Q", "NOTCH_ATT"
    frequency, quality, depth = _required(own, *(prefix + end for end in ends))
    if frequency and depth and quality > 0.5:  # else it is off
        harmonics = own.get(f"{prefix}NOTCH_HMNC", 1.0)
        yield from _harmonics(frequency, 1 / quality, depth, harmonics)


def _harmonics(centre: float, bandwidth: float, depth: float, harmonics: float) -> Iterator[Notch]:
    """A notch at each of a mask of ``harmonics``; the ``bandwidth`` is the firmware's, over the frequency.

    One without frequency, width or depth is off.
    """
    if min(centre, bandwidth, depth) <= 0:
        return
    half = bandwidth / 2
    width = half * (2 - half) / (1 - half)
    for harmonic in range(1, 17):
        if int(harmonics) >> (harmonic - 1) & 1:
            frequency = harmonic * centre
            yield Notch(frequency, width * frequency, depth)


def _px4(own: Parameters, axis: str, is_demand: bool) -> JsonValues:
    """The fields of a PX4's controller."""
    rate = f"MC_{axis.upper()}RATE_"
    names = {"p": f"{rate}P", "i": f"{rate}I", "d": f"{rate}D", "angle": f"MC_{axis.upper()}_P"}
    names |= {"derivative_filter": "IMU_DGYRO_CUTOFF", "expo": "THR_MDL_FAC"}
    values_of = _gains(own, names, rate)
    values_of |= {gain: own.get(f"{rate}K", 1.0) * values_of[gain] for gain in "pid"}
    notches = [
        Notch(own.get(f"IMU_GYRO_{name}", 0.0), own.get(f"IMU_GYRO_{number}_BW", 0.0), inf)
        for number, name in (("NF0", "NF0_FRQ"), ("NF1", "NF1_FRQ"), ("NF", "NF_FREQ"))
    ]
    return values_of | {
        "notches": tuple(notch for notch in notches if notch.frequency > 0 and notch.bandwidth > 0),
        # its drivers filter at the rate of the sensor's own buffer
        "gyro_rate": 8000.0,
        "output_filter": own.get("MC_YAW_TQ_CUTOFF", 0.0) if axis == "yaw" else 0.0,
        "gyro_filter": own.get("IMU_GYRO_CUTOFF", 0.0),
        "derivative_of_error": False,
        "cycle": 1 / max(own.get("IMU_GYRO_RATEMAX", 400.0), MIN_LOOP_RATE),
        "mixer": (1.0,) if is_demand else _allocation(own)[axis],
    }


def _gains(own: Parameters, names: Mapping[str, str], rate: str) -> JsonValues:
    values = dict(zip(names, _required(own, *names.values()), strict=True))
    return {"names": names, "ff": own.get(f"{rate}FF", 0.0), **values}


def _required(parameters: Parameters, *names: str) -> list[float]:
    missing = [name for name in names if name not in parameters]
    if missing:
        raise NotLearnable(Controllers.PARAMETERS_MISSING, names=missing)
    return [parameters[name] for name in names]


def _allocation(parameters: Parameters) -> dict[str, Numbers]:
    """PX4's mixer by axis: the inverse of the motors' torques and thrust, normalised as the control allocator does."""
    rotors = [f"CA_ROTOR{number}_" for number in range(MOTORS)]
    x, y, moment = (
        _required(parameters, *(rotor + name for rotor in rotors)) for name in ("PX", "PY", "KM")
    )
    tilts = [parameters.get(f"{rotor}A{name}", 0.0) for rotor in rotors for name in "XY"]
    sizes = {parameters.get(f"{rotor}CT", 0.0) for rotor in rotors}
    effects = np.array([np.negative(y), x, moment, np.ones(MOTORS)])
    other = (
        parameters.get("CA_ROTOR_COUNT") != MOTORS
        or parameters.get("CA_AIRFRAME", 0.0)
        or any(tilts)
    )
    unknown = NotLearnable(Controllers.MIXER_UNKNOWN, autopilot="px4")
    if other or len(sizes) > 1 or np.linalg.cond(effects) > 1e6:
        raise unknown
    inverse = np.linalg.inv(effects)[:, :3]
    smallest = 1e-3 * np.abs(inverse).max()
    tilting = np.abs(inverse[:, :2]) > smallest
    if not tilting.any(axis=0).all():
        raise unknown
    squares = (inverse[:, :2] ** 2).sum(axis=0)
    pairs = tilting.sum(axis=0) / 2
    most = np.sqrt(squares / pairs).max()
    scaled = inverse / [most, most, inverse[:, 2].max()]
    return dict(zip(("roll", "pitch", "yaw"), map(tuple, scaled.T.tolist()), strict=True))
