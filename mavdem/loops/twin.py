"""Twin: the vehicle that a log shows, as simulators fly it: an X of four motors, in SI units."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng
from scipy.constants import g as GRAVITY  # noqa: N812

from mavdem.arrays import Array
from mavdem.confidence import Interval, coverage_factor
from mavdem.containers import Numbers
from mavdem.dataset.axes import AXES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, NamedFacts
from mavdem.facts.identifiability import Status
from mavdem.facts.loops import Twins
from mavdem.immutable import ImmutableResult
from mavdem.ingest.motors import Position
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.autopilot_parameters import (
    DEFAULT_LOOP_RATES,
    LOOP_RATE_PARAMETERS,
    MAX_LOOP_RATE,
)
from mavdem.loops.axis_loops import Loop, LoopsByAxis
from mavdem.loops.controllers import controller_from_parameters
from mavdem.loops.measured_response import interpolated_setpoint
from mavdem.plant.parameters import wind_torque_density
from mavdem.wind_velocity.airflow import Drag
from mavdem.wind_velocity.estimation import WindVelocity

TORQUE_SIGNS = {
    "roll": (-1.0, 1.0, 1.0, -1.0),
    "pitch": (1.0, -1.0, 1.0, -1.0),
    "yaw": (1.0, 1.0, -1.0, -1.0),
}
"""Of the motors' torque about each axis: an X as ArduPilot and PX4 count it, 1 of yaw counterclockwise from above."""
# m kg^(-1/3), of a 3DR Iris: arms grow with the cube root of the mass; kg where nobody says it
ARM = 0.15
MASS = 1.5
MOMENT = 0.1  # torque of a common propeller by its thrust, over the arm


@dataclass(frozen=True, eq=False)
class Twin(ImmutableResult):
    """A vehicle for simulators, with how sure each of its attributes is as ``notes`` by name."""

    autopilot: str  # "px4" or "ardupilot"
    mass: float  # kg
    inertia: Numbers  # (3,) about forward, right and down, kg m²
    arm: Position  # how far forward, and right, of the centre of mass its motors are, m
    hover: float  # share of the motors' range in hover
    spin: Interval  # shares of that range at which thrust begins and ends
    expo: float  # share of a motor's thrust that is quadratic in that of the range, the rest linear
    moment: float  # torque of a propeller by its thrust, m
    damping: Numbers  # (3,) of the rates, 1/s
    lag: float  # time constant of the motors, s
    delay: float  # from the motion to the motors' command, without the hold over a control cycle, s
    noise: float  # standard deviation of a measured rate, rad/s
    drag: Drag  # by its source that of typical vehicles, where the flight does not show it
    wind_speed: float | None  # mean of the flight, m/s; None where it is not known
    wind_direction: float | None  # degrees that it comes from
    parameters: Parameters  # of the autopilot's rate and attitude control, by name
    notes: NamedFacts

    def replayed(self, dt: float, setpoints: Array, torque: Array, seed: int = 0) -> Array:
        """Returns how the simulator flies it, as :func:`sitl_scenarios.simulation.replayed`.

        Raises:
            ValueError: the simulator cannot fly it.
        """
        from mavdem.report.vehicle_files import vehicle_text
        from sitl_scenarios.files import scenario_of
        from sitl_scenarios.simulation import replayed

        vehicle = tomllib.loads(vehicle_text(self, ".toml", ""))
        return replayed(scenario_of(vehicle | {"seed": seed}), dt, setpoints, torque)

    @property
    def command(self) -> float:
        """In hover, as a share of what is between where thrust begins and ends."""
        begin, end = self.spin
        return (self.hover - begin) / (end - begin)

    @property
    def slope(self) -> float:
        """Of one motor's thrust by the share of its range, in hover, N."""
        begin, end = self.spin
        thrust = self.command * (1 - self.expo + self.expo * self.command) * (end - begin)
        return self.mass * GRAVITY / 4 / thrust * (1 - self.expo + 2 * self.expo * self.command)


def build_twin(
    loops: LoopsByAxis,
    px4: bool,
    hover: float,
    air: WindVelocity | None,
    drag: Drag,
    mass: float | None,
) -> Twin:
    """Returns the twin of a vehicle from its ``loops`` by axis.

    Pitch is taken to be like roll, and yaw like that of common propellers, where they are not there. ``hover`` is the
    share of the motors' range, ``air`` what the flight says of the wind; ``drag`` is its own, or what is known without.
    The motion has the product of mass, arm and 1/inertia only: the ``mass``, kg, is assumed unless given, and the arm
    by it, unless PX4's parameters have it.
    Raises ``NotLearnable``: no hover.
    """
    roll = loops["roll"]
    controller = roll.controller
    begin, end = controller.spin_range
    if not max(0.1, begin) < hover < end:
        raise NotLearnable(Twins.NO_HOVER, share=hover)
    wind = (
        air if air is not None and air.speed_identifiable and air.direction_identifiable else None
    )
    autopilot = "px4" if px4 else "ardupilot"
    weight = mass or MASS
    arm, is_measured = _arm(controller.parameters, weight)
    own, cycle = _parameters(controller.parameters, autopilot)
    motors = [loop.dynamics[0, 1:] for axis, loop in loops.items() if axis != "yaw"]
    lag, late = (np.mean(motors, axis=0) - [0.0, cycle / 2]).tolist()  # the hold is flown
    damping = {"pitch": roll.plant.damping, "yaw": 0.0}
    damping |= {axis: loop.plant.damping for axis, loop in loops.items()}
    body = Twin(
        autopilot=autopilot,
        mass=weight,
        inertia=(),
        arm=arm,
        hover=hover,
        spin=controller.spin_range,
        expo=min(max(controller.thrust_expo, 0.0), 1.0),
        moment=MOMENT * arm[1],
        damping=tuple(damping[axis] for axis in TORQUE_SIGNS),
        lag=max(lag + min(late, 0.0), 0.0),
        delay=max(late, 0.0),
        noise=roll.plant.noise,
        drag=drag,
        wind_speed=None if wind is None else wind.speed,
        wind_direction=None if wind is None else wind.direction,
        parameters=own,
        notes=_notes(loops, bool(mass), is_measured, drag),
    )
    inertia = {axis: _inertia(body, axis, loop) for axis, loop in loops.items()}
    sizes = inertia["roll"], inertia.get("pitch", inertia["roll"])
    moment = sum(sizes) / inertia["yaw"] if "yaw" in inertia else body.moment
    return replace(body, inertia=(*sizes, sum(sizes)), moment=moment)


def _arm(parameters: Parameters, mass: float) -> tuple[Position, bool]:
    """How far forward and right the motors are, m, and whether the parameters have it."""
    places = np.array(
        [
            [parameters.get(f"CA_ROTOR{n}_P{coordinate}", 0.0) for n in range(4)]
            for coordinate in "XY"
        ]
    )
    if places.all() and np.abs(places).max() != 1.0:  # of 1 m they are no metres
        ahead, aside = np.abs(places).mean(axis=1).tolist()
        return (ahead, aside), True
    assumed = ARM * mass ** (1 / 3)
    return (assumed, assumed), False


def _parameters(logged: Parameters, autopilot: str) -> tuple[Parameters, float]:
    """The parameters that the simulation flies, and the control cycle, s."""
    name = LOOP_RATE_PARAMETERS[autopilot]
    rate = min(logged.get(name, 0.0) or DEFAULT_LOOP_RATES[autopilot], MAX_LOOP_RATE)
    kept = {name: value for name, value in logged.items() if not name.startswith("CA_")}
    return kept | {name: rate}, 1 / rate


def _inertia(body: Twin, axis: str, loop: Loop) -> float:
    """Of the axis, kg m², by what a demand turns and what it changes of the motors' thrust; of yaw, over its moment."""
    ahead, aside = body.arm
    square = {"CA_ROTOR_COUNT": 4.0, "FRAME_CLASS": 1.0}
    for n, (left, front, spin) in enumerate(zip(*TORQUE_SIGNS.values(), strict=True)):
        rotor = f"CA_ROTOR{n}_P"
        square |= {f"{rotor}X": ahead * front, f"{rotor}Y": -aside * left, f"CA_ROTOR{n}_KM": spin}
    controller = controller_from_parameters({**body.parameters, **square}, axis, TORQUE_SIGNS[axis])
    moved = np.abs(controller.outputs_per_demand([body.hover] * 4)).sum()
    lever = {"roll": aside, "pitch": ahead, "yaw": 1.0}[axis]
    return lever * body.slope * moved / loop.effectiveness[0]


def _notes(loops: LoopsByAxis, is_given: bool, is_measured: bool, drag: Drag) -> dict[str, Fact]:
    """How sure the attributes are, by name; of mass and arm whether they are given, or measured."""
    effects = {
        axis: Fact(
            Twins.EFFECT_NOTE,
            share=coverage_factor() * np.std(loop.effectiveness) / loop.effectiveness[0],
            is_biased=bool(loop.plant.bias),
        )
        for axis, loop in loops.items()
    }
    plant = loops["roll"].plant
    attributes = {
        name: None
        if plant.status[name] is Status.NOT_IDENTIFIABLE
        else getattr(plant.interval(), name)
        for name in ("damping", "lag")
    }
    notes = {
        "mass": Fact(Twins.MASS_NOTE, is_given=is_given),
        "arm": Fact(Twins.ARM_NOTE, is_given=is_measured),
        "inertia": Fact(Twins.INERTIA_NOTE, roll=effects["roll"], pitch=effects.get("pitch")),
        "moment": effects.get("yaw", Fact(Twins.MOMENT_NOTE)),
        "damping": Fact(Twins.DAMPING_NOTE, damping=attributes["damping"]),
        "lag": Fact(Twins.LAG_NOTE, lag=attributes["lag"]),
    }
    names = "linear", "quadratic"
    ends = {f"drag_{name}_interval": drag.interval(name).mean(axis=1).tolist() for name in names}
    figures = {**ends, "source": drag.source}
    return notes | {
        f"drag_{name}": Fact(Twins.DRAG_NOTE, subject=name, **figures) for name in names
    }


RATE_BANDS = (0.3, 0.6, 1.2, 2.4, 4.8, 8.0)  # Hz: octaves, and what is left of the last
# s of a spectrum's windows, left out at the beginning, and flown
WINDOW = 20.0
SETTLING_SECONDS = 3.0
LONGEST = 120.0
FLIGHTS = 3  # of the twin, each in other wind of the same spectrum


class ReplaySegment(NamedTuple):
    """What is flown again of one axis: a segment of its record's ``outputs``, with ``setpoints`` (T, 2).

    They are of angle and rate. The rate, rad/s, is beside what the angle's error asks for; of yaw it is all, and the
    angle is 0.
    """

    outputs: Array
    setpoints: Array


def replay_segments(loops: LoopsByAxis) -> dict[str, ReplaySegment]:
    """Returns by axis the longest segment of the flight, where its setpoints were recorded; none without those of roll.

    Pitch and yaw are there where they were learned from the segments of roll; yaw where it was steered.
    """
    by_axis = dict[str, ReplaySegment]()
    roll = loops["roll"].record
    longest = np.argmax(roll.lengths)
    start = roll.segment_starts[longest]
    segment = slice(start, start + min(roll.lengths[longest], round(LONGEST / roll.dt)))
    for axis, loop in loops.items():
        is_alike = loop.record.lengths == roll.lengths and loop.record.begins == roll.begins
        if is_alike and (again := _again(loop, segment)) is not None:
            by_axis[axis] = again
    return by_axis if "roll" in by_axis else {}


def _again(loop: Loop, segment: slice) -> ReplaySegment | None:
    record = loop.record
    names = [f"{loop.axis} setpoint", f"{loop.axis} rate setpoint"][loop.axis == "yaw" :]
    if record.setpoints is None or not set(names) <= set(record.setpoint_names):
        return None
    columns = [record.setpoint_names.index(name) for name in names]
    asked = record.setpoints[segment, columns]
    finite = np.isfinite(asked).all(axis=1)
    if finite.mean() < 0.5:
        return None
    at = np.arange(len(asked))
    *angles, rate = (
        interpolated_setpoint(np.interp(at, at[finite], column[finite])) for column in asked.T
    )
    outputs = record.outputs[segment]
    if not angles:
        # A heading that is only held is turned by roll and pitch of a leaned vehicle.
        is_steered = rate.std() > 0.8 * outputs.std()
        return ReplaySegment(outputs, np.column_stack([0 * rate, rate])) if is_steered else None
    # Only ArduPilot's ATTITUDE_TARGET leaves out what the angle's error asks for.
    corrected = loop.controller.angle_gain * (angles[0] - outputs[:, 0])
    ahead = np.gradient(angles[0], record.dt)
    apart = [np.std(rate - wanted) for wanted in (ahead, corrected + ahead, corrected)]
    if not loop.controller.derivative_of_error or np.argmin(apart):
        rate = rate - corrected
    return ReplaySegment(outputs, np.column_stack([angles[0], rate]))


def compare_twin_with_flight(twin: Twin, loops: LoopsByAxis) -> dict[str, dict[str, list[float]]]:
    """Returns by axis how :func:`alike` the flight of the ``loops`` and the ``twin`` on its setpoints are.

    None without setpoints of roll. Raises NotLearnable: the twin cannot fly.
    """
    again = replay_segments(loops)
    flown = [fly_twin(twin, loops, again, seed) for seed in range(FLIGHTS if again else 0)]
    return {
        axis: alike(loops[axis], loop.outputs, [motion[:, AXES.index(axis)] for motion in flown])
        for axis, loop in again.items()
    }


def fly_twin(
    twin: Twin, loops: LoopsByAxis, again: Mapping[str, ReplaySegment], seed: int = 0
) -> Array:
    """Returns (T, 3, 2) angles and rates of the ``twin`` on the setpoints of a flight, rad, in wind by the ``seed``.

    Raises NotLearnable: it cannot fly.
    """
    samples = len(again["roll"].outputs)
    setpoints = np.zeros((samples, len(AXES), 2))
    blown = np.zeros((samples, len(AXES)))
    noise = default_rng(seed)
    for axis, loop in again.items():
        setpoints[:, AXES.index(axis)] = loop.setpoints
        blown[:, AXES.index(axis)] = torque(loops[axis], samples, noise)
    try:
        motion: Array = twin.replayed(loops["roll"].record.dt, setpoints, blown, seed)
    except ValueError as error:
        raise NotLearnable(Twins.CANNOT_FLY, because=error) from None
    return motion


def torque(loop: Loop, samples: int, noise: np.random.Generator) -> Array:
    """Returns (samples,) of the wind's torque on an axis, rad/s², Gaussian with the spectrum that was learned."""
    frequency = np.fft.rfftfreq(samples, loop.record.dt).astype(np.float64)
    power = wind_torque_density(loop.plant, frequency) * (frequency > 0)
    real, imaginary = noise.standard_normal((2, len(power)))
    size = np.sqrt(power * samples / (4 * loop.record.dt))
    return np.fft.irfft(size * (real + 1j * imaginary), samples)


def alike(loop: Loop, outputs: Array, flown: Sequence[Array]) -> dict[str, list[float]]:
    """Returns figures of ``outputs`` and of angle and rate (T, 2), rad and rad/s, that were ``flown`` again.

    Levels of the rate's spectrum in ``RATE_BANDS``, the twin's over the recorded in dB; mean and sd of the angle but
    for yaw, and sd of the rate, in degrees.
    """
    from scipy.signal import detrend, welch  # it takes half a second to import

    dt = loop.record.dt
    every = np.array([outputs, *(motion[:, -outputs.shape[1] :] for motion in flown)])
    every = every[:, round(SETTLING_SECONDS / dt) :]
    length = int(min(WINDOW / dt, every.shape[1] / 2))
    frequency, power = welch(every[..., -1], 1 / dt, nperseg=length, detrend=detrend)
    places = np.digitize(frequency, RATE_BANDS)
    level = np.array([power[:, places == n].mean(axis=1) for n in range(1, len(RATE_BANDS))])
    ratio = level[:, 1:].mean(axis=1) / level[:, 0]
    values = {"rate": np.degrees(every[..., -1].std(axis=1))}
    if loop.axis != "yaw":
        angles = np.degrees(every[..., 0])
        values |= {"lean": angles.mean(axis=1), "sway": angles.std(axis=1)}
    shares = {name: [of_flights[0], of_flights[1:].mean()] for name, of_flights in values.items()}
    return {"levels": (10 * np.log10(ratio)).tolist(), **shares}
