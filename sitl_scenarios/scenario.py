"""Scenario: pydantic models of a scenario file's sections: vehicle, wind, excitation, sensors and faults of a flight.

A scenario file is the same in TOML, a table for each section; what it leaves out has the value given here. Directions
are degrees clockwise from north: wind comes *from* its direction, as in weather reports. ``mavdem fly --describe``
prints what each key means: the description of its pydantic field.
"""

from __future__ import annotations

from math import cos, log, radians, sin
from typing import Annotated, Literal

import numpy as np
from numpy.random import Generator, default_rng
from pydantic import (
    Field,
    FiniteFloat,
    NonNegativeFloat,
    PositiveFloat,
    model_validator,
)

from mavdem.loops.autopilot_parameters import DEFAULT_LOOP_RATES, LOOP_RATE_PARAMETERS
from sitl_scenarios.mishaps.specs import Mishap
from sitl_scenarios.motion import Array, Pair
from sitl_scenarios.rotors import Shape, rotor_count
from sitl_scenarios.section import (
    MAX_SECONDS,
    OR_INF,
    Motor,
    NotNegative,
    Positive,
    Section,
    Share,
    Size,
)

Left = Annotated[float, Field(gt=0, le=1)]
Millimetres = Annotated[float, Field(ge=-100, le=100)]


class Propeller(Section):
    """A propeller that chips in flight: it gives less thrust, and takes less torque."""

    motor: Motor = 0
    """Motor that turns it, counted from 1 as the autopilot does; 0: none"""
    start: NotNegative = 0.0
    """Seconds into the flight at which it chips"""
    thrust: Left = 0.85
    """Remaining share of its thrust, at the same speed"""
    torque: Left = 0.82
    """Remaining share of its torque; where blades get shorter, thrust goes with R⁴ and torque with R⁵."""


class Load(Section):
    """A load that shifts in flight, and the vehicle's centre of mass with it."""

    start: NotNegative = 0.0
    """Seconds into the flight at which it shifts"""
    forward: Millimetres = 0.0
    """How far the centre of mass moves forward, mm; back where negative"""
    right: Millimetres = 0.0
    """How far it moves to the right, mm; to the left where negative"""


MAX_WINDS = 16
"""Largest number of winds, and of moments, that are summed; a choice."""

Kernel = Annotated[float, Field(ge=1e-3, le=60)]
"""Seconds. What is shorter than the steps of the physics is white to them; what is longer changes in no flight."""
# Setpoint: degrees of roll or pitch, degrees/s of yaw rate
Angle = Annotated[float, Field(gt=0, le=30)]
Metres = Annotated[float, Field(ge=-500, le=500)]  # Length of a move
Frequency = Annotated[float, Field(gt=0, le=200)]  # Hz: half of the greatest rate of a stream
Speed = Annotated[float, Field(ge=0, le=60)]  # Wind, m/s: no hurricane's mean is greater

Direction = Annotated[
    float,
    Field(ge=-360, le=360, description="Where the wind comes from, degrees clockwise from north"),
]


def downwind_direction(direction: float) -> Array:
    """Returns the direction in which a wind blows.

    Args:
        direction: Direction that the wind comes from, degrees clockwise from north.

    Returns:
        Unit vector (3,), north-east-down.
    """
    angle = radians(direction)
    return np.array([-cos(angle), -sin(angle), 0.0])


Lag = Annotated[
    Annotated[float, Field(ge=0, le=1)] | None, OR_INF
]  # Time constant of a rotor's speed, s
Degrees = Annotated[float, Field(ge=-10, le=10)]
Drag = Annotated[tuple[Share, Share] | None, OR_INF]  # Along the body's x and y axes


SENSORS, WIND, MOMENT, STICKS, SHAKING, INSTRUMENTS, MISHAP = range(7)
"""Purposes of random numbers; winds, moments and sticks are numbered further, each in its own list."""


class BodySpec(Section):
    """A body of one's own, such as one learned from a log, in place of a published one.

    Inertia is about forward, right and down, kg m²; arm is the distance of the rotors of the X forward and to the
    right, m; damping acts on the three rates by themselves, 1/s.
    """

    mass: Positive
    """Mass, kg"""
    inertia: Annotated[tuple[PositiveFloat, PositiveFloat, PositiveFloat], OR_INF]
    arm: Annotated[tuple[PositiveFloat, PositiveFloat], OR_INF]
    hover: float = Field(gt=0.1, lt=1)
    """Share of the motors' range in hover"""
    torque: Left
    """Torque of a rotor over its thrust, m"""
    spin: Annotated[tuple[Share, Share], OR_INF] = (0.0, 1.0)
    """Shares of the motors' range at which thrust begins and ends."""
    damping: Annotated[tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat], OR_INF] = (
        0.0,
        0.0,
        0.0,
    )


class VehicleSpec(Section):
    """The vehicle."""

    model: Literal["ardrone2", "iris", "crazyflie"] = "iris"
    """AR.Drone 2.0, 3DR Iris or Crazyflie 2"""
    frame: Shape = "x"
    """Arrangement of the rotors; frames of more than four are larger, with the same rotors"""
    battery_sag: float = Field(0.0, ge=0, lt=0.5)
    """Share of the voltage, and of the rotors' speed, that the battery loses from the flight's beginning to its end."""
    rotor_drag: bool = True
    """Whether rotors in wind drag the vehicle along and tilt it; if not, its hull still does."""
    drag_linear: Drag = None
    """Linear drag along body x and y, 1/s in hover, in place of the rotors' published one; inf: as published."""
    drag_quadratic: Drag = None
    """Quadratic drag along body x and y, 1/m, in place of the hull's published one; inf: as published."""
    quadratic_thrust: Annotated[Share | None, OR_INF] = None
    """Share of the thrust that is quadratic in the command, the rest linear; inf: rotor speed linear in it."""
    lag_up: Lag = None
    """Time constant of a rotor that speeds up, s; inf: as published"""
    lag_down: Lag = None
    """Time constant of a rotor that slows down, s; inf: as published"""
    mixer: Literal["", "x", "plus"] = ""
    """Frame that the autopilot is set to, where that is a wrong one: it exchanges roll and pitch, and may oscillate."""
    rate_gain: Positive = 1.0
    """Multiple of the rate loop's gain that suits the vehicle"""
    inertia_scale: Positive = 1.0
    """Multiple of the published moments of inertia; the autopilot is tuned for it."""
    body: Annotated[BodySpec | None, OR_INF] = None
    """Mass, inertia, arm, hover, torque and damping of a vehicle of one's own, in place of the model's"""
    parameters: dict[str, FiniteFloat] = {}
    """The autopilot's parameters of rate and attitude control, in place of those that suit the vehicle"""
    weak_motor: Motor = 0
    """Motor, counted from 1 as the autopilot does, that loses thrust; 0: none."""
    weak_from: NotNegative = 0.0
    """Seconds into the flight from which it is weak"""
    weak_thrust: Left = 0.65
    """Remaining share of its thrust"""

    @property
    def layout(self) -> Shape:
        """Frame that the autopilot is set to: the one of ``mixer`` if it is given, otherwise the vehicle's own."""
        return self.mixer or self.frame


class SteadyWind(Section):
    """Wind that never changes."""

    kind: Literal["steady"]
    speed: Speed
    """Speed of the wind, m/s"""
    direction: Direction = 90.0


class GaussianWind(Section):
    """The paper's noise: white noise through a Gaussian kernel; the autocorrelation is exp(−τ²/4s²)."""

    kind: Literal["gaussian"]
    sd: Speed
    """Standard deviation along each axis, m/s"""
    s: Kernel
    """Standard deviation of the kernel, s"""


class TurbulentWind(Section):
    """Turbulence of the Dryden or the von Kármán spectra at low altitude (MIL-F-8785C) about a mean wind.

    The military grades of ``wind_at_20_feet`` are 7.7, 15.4 and 23.2 (15, 30 and 45 kt: light, moderate and severe).
    """

    kind: Literal["dryden", "von_karman"]
    speed: Speed
    """Speed of the mean wind, m/s, which is part of the true wind"""
    direction: Direction = 90.0
    wind_at_20_feet: Speed = 7.7
    """Wind at 20 feet, from which the intensity follows, m/s: 7.7 is light, 15.4 moderate, 23.2 severe."""


class Gust(Section):
    """A 1-cosine gust (MIL-F-8785C)."""

    kind: Literal["gust"]
    start: NotNegative
    """Seconds into the flight at which it begins"""
    speed: Speed
    """Greatest speed, m/s"""
    direction: Direction = 90.0
    rise: Positive = 1.0
    """Seconds from its beginning to its greatest speed"""
    hold: Annotated[NotNegative | None, OR_INF] = 0.0
    """Seconds at its greatest speed, before it falls as it rose; inf: it never falls."""


class Jet(Section):
    """A blower's jet through the place where the vehicle hovers; entering and leaving its edge colours the wind."""

    kind: Literal["jet"]
    speed: Speed
    """Speed on its axis where it leaves the blower, m/s"""
    direction: Direction = 90.0
    distance: Positive = 2.0
    """Distance of the blower from the place of the hover, m"""
    diameter: Positive = 0.5
    """Diameter of the blower's mouth, m"""
    turbulence: Share = 0.2
    """Standard deviation of the speed, as a share of the local mean"""
    s: Kernel = 0.05
    """Standard deviation of the turbulence's kernel, s, as of a gaussian wind"""
    offset: Metres = 0.0
    """Distance of the jet's axis to the right of the place of the hover, seen along the jet, m"""


class Profile(Section):
    """Profile of all winds but jets: growth and turn with height (Kaimal and Finnigan 1994, ch. 1), turn in time."""

    law: Literal["none", "log"] = "none"
    """Law of the speed; log is log(z/roughness) / log(reference/roughness) at the height z"""
    reference: float = Field(10.0, ge=1, le=100)
    """Height at which the winds have their stated speed and direction, m"""
    roughness: float = Field(0.03, gt=0, lt=1)
    """Roughness length of the logarithmic law, m; that of grass is 0.03"""
    veer: Degrees = 0.0
    """Clockwise turn with height, degrees/m"""
    turn: Degrees = 0.0
    """Clockwise turn in time, from arming, degrees/s"""

    def at(self, height: float, time: float) -> Pair:
        """Returns the rotation and the scaling by which the winds differ from those given at the reference height.

        The speed grows with the logarithm of the height where ``law`` is "log". The direction turns with height (veer)
        and with time.

        Args:
            height: Height above the ground, m.
            time: Time since arming, s.

        Returns:
            Cosine and sine of the clockwise turn of the wind, both times the ratio of its speed to that given: the
            elements of the matrix that rotates and scales the wind in one step.
        """
        z = max(height, 0.0)
        speed_ratio = 1.0
        if self.law == "log":
            # The logarithmic law has no wind below the roughness length.
            log_height = log(max(z / self.roughness, 1.0))
            speed_ratio = log_height / log(self.reference / self.roughness)
        turn_degrees = self.veer * (z - self.reference) + self.turn * time
        angle = radians(turn_degrees)
        return speed_ratio * cos(angle), speed_ratio * sin(angle)


Wind = Annotated[
    SteadyWind | GaussianWind | TurbulentWind | Gust | Jet, Field(discriminator="kind")
]


Axis = Literal["roll", "pitch", "yaw"]
AXES: tuple[Axis, ...] = ("roll", "pitch", "yaw")


class Moment(Section):
    """A coloured moment on the body, whatever the wind."""

    axis: Axis = "roll"
    """Axis about which it turns the vehicle"""
    sd: Size
    """Standard deviation, N m"""
    s: Kernel
    """Standard deviation of the kernel, s, as of a gaussian wind"""


class Doublets(Section):
    """A demand to one side, then to the other, again and again."""

    kind: Literal["doublets"]
    axis: Axis | Literal["all"] = "roll"
    """Axis of the demand: an angle of roll or pitch, a rate of yaw, or all three, one after another"""
    amplitude: Angle = 8.0
    """Amplitude, degrees of roll or pitch, degrees/s of the yaw rate"""
    width: Positive = 0.4
    """Seconds to each side; at most half of the period"""
    period: Positive = 5.0
    """Seconds from one to the next"""


class Chirp(Section):
    """A sine whose frequency rises, again and again."""

    kind: Literal["chirp"]
    axis: Axis = "roll"
    """Axis of the demand: an angle of roll or pitch, or a rate of yaw"""
    amplitude: Angle = 3.0
    """Amplitude, degrees of roll or pitch, degrees/s of the yaw rate"""
    lowest: Frequency = 0.2
    """Frequency at the beginning, Hz"""
    highest: Frequency = 5.0
    """Frequency at the end, Hz"""
    period: Positive = 20.0
    """Seconds from one to the next"""


class Multisine(Section):
    """Sines together, of even power, with Schroeder's phases; on all axes no two share a frequency."""

    kind: Literal["multisine"]
    axis: Axis | Literal["all"] = "roll"
    """Axis of the demand: an angle of roll or pitch, a rate of yaw, or all three, with every third sine each"""
    sd: Angle = 2.0
    """Standard deviation of the sum of an axis's sines, degrees of roll and pitch, degrees/s of the yaw rate"""
    lowest: Frequency = 0.2
    """Lowest frequency, Hz; at least one cycle in a period"""
    highest: Frequency = 5.0
    """Highest frequency, Hz"""
    period: Positive = 20.0
    """Seconds after which they repeat"""


class Steps(Section):
    """Sideways steps, there and back, again and again."""

    kind: Literal["steps"]
    distance: Positive = 2.0
    """Distance to the right, m"""
    period: Positive = 6.0
    """Seconds from one to the next"""


class Sticks(Section):
    """A pilot's sticks: irregular demands, as slow as a hand; RC_CHANNELS shows them."""

    kind: Literal["sticks"]
    axis: Axis | Literal["all"] = "roll"
    """Axis of the demand: an angle of roll or pitch, a rate of yaw, or all three, independently"""
    sd: Angle = 4.0
    """Standard deviation of each axis' demand, degrees of roll and pitch, degrees/s of the yaw rate"""
    s: Kernel = 0.25
    """Standard deviation of the demand's kernel, s, as of a gaussian wind; its power falls to half at 0.13/s Hz."""


class Move(Section):
    """A leg, a climb and a turn at once, from where the move before ended, and the hover after it."""

    north: Metres = 0.0
    """Distance of the leg to the north, m"""
    east: Metres = 0.0
    """Distance of the leg to the east, m"""
    up: Metres = 0.0
    """Height of the climb, m"""
    speed: Positive = 4.0
    """Speed along the leg, m/s; it begins and brakes with 2.5 m/s²"""
    turn: float = Field(0.0, ge=-3600, le=3600)
    """Turn of the heading, degrees clockwise"""
    rate: Positive = 30.0
    """Rate of the turn, degrees/s"""
    hover: NotNegative = 3.0
    """Seconds of hover after it"""


class Course(Section):
    """Legs, climbs and turns one after another, back to where they began; as often as the hover lasts."""

    kind: Literal["course"]
    moves: tuple[Move, ...] = Field(min_length=1, max_length=100)
    """Flown in this order"""


Excitation = Annotated[
    Doublets | Chirp | Multisine | Steps | Sticks | Course, Field(discriminator="kind")
]


class Sensors(Section):
    """White noise and delay of the autopilot's estimates."""

    rate_sd: Size = 0.005
    """Standard deviation of each body rate, rad/s"""
    attitude_sd: Share = 0.001
    """Standard deviation of roll, pitch and yaw, rad"""
    position_sd: Size = 0.02
    """Standard deviation of each coordinate, m"""
    velocity_sd: Size = 0.02
    """Standard deviation of each velocity, m/s"""
    delay: float = Field(0.004, ge=0, le=0.05)
    """Seconds from the motion to the motors' command"""
    misalignment: tuple[Degrees, Degrees] = (0.0, 0.0)
    """Degrees of roll and pitch that the autopilot reads on a level vehicle."""


class Shaking(Section):
    """Vibration of the gyro, before its filters, by sound rotors and by the frame."""

    gyro: Size = 0.0
    """Amplitude about each axis by each rotor in hover, rad/s"""
    balance: Share = 0.5
    """Share of it at once per turn, by rotors out of balance; the rest is once per blade"""
    blades: int = Field(2, ge=2, le=8)
    """Number of blades of each rotor"""
    frame: Size = 0.0
    """Frequency at which the frame resonates, Hz; 0: it does not"""
    frame_gyro: Size = 0.0
    """Standard deviation of the gyro by the frame's resonance, rad/s"""


class StreamSpec(Section):
    """What the autopilot sends."""

    autopilot: Literal["px4", "ardupilot"] = "px4"
    """Autopilot whose messages, units and parameters are sent"""
    rate: float = Field(100.0, ge=0.1, le=400)
    """Rate of attitude and of motor outputs, Hz; other frequent messages come at a quarter of it."""
    rates: dict[str, Annotated[float, Field(ge=0, le=1000)]] = {}
    """Rates by the name of a message, Hz, as {ATTITUDE = 50, SYS_STATUS = 1}; 0: only after a request."""
    only_when_asked: bool = False
    """Whether all but HEARTBEAT and ``rates`` comes only after a request, as where ArduPilot's SRn_ are 0"""
    system: int = Field(1, ge=1, le=250)
    """Its MAVLink system id"""
    instruments: bool = False
    """Whether barometer, satellites, vibration, power and estimator are sent too, at the rates of a ground station"""


class Faults(Section):
    """What the link does to the stream, by chance."""

    loss: Share = 0.0
    """Share of the messages that are lost"""
    delay: Size = 0.0
    """Delay of each message, s"""
    jitter: Size = 0.0
    """Largest further random delay, s"""
    reordered: Share = 0.0
    """Share of the messages that are overtaken by the one after"""
    reboot: Annotated[Positive | None, OR_INF] = None
    """Seconds into the flight at which the autopilot reboots in flight, clock and rates too; inf: never."""
    outage: Annotated[Positive | None, OR_INF] = None
    """Seconds into the flight at which the link is lost, in both directions; inf: never."""
    outage_seconds: Positive = 10.0
    """Seconds until the link is back"""
    clock_jump: Annotated[Positive | None, OR_INF] = None
    """Seconds into the flight at which the boot clock jumps ahead, as a paused simulator's does; inf: never."""
    clock_jump_seconds: Positive = 300.0
    """Seconds by which the clock jumps"""
    mavproxy_rate: Size = 0.0
    """Hz to which another ground station sets all streams every 15 s, as MAVProxy does with 4; 0: there is none."""


QUADROTOR_MOTORS = 4
"""Number of motors of a quadrotor."""

POSITION_TOLERANCE = 1e-6
"""Largest distance between the beginning and the end of a course, m, along each axis: for rounding only."""

MIN_COURSE_HEIGHT = 0.5
"""Smallest height of a course above the ground, m; a choice."""


class Scenario(Section):
    """A flight from arming to disarming: climb, hover with the excitation and in the wind given, land."""

    description: str = ""
    """One sentence about the scenario"""
    duration: float = Field(60.0, ge=15, le=MAX_SECONDS)
    """Seconds from arming to disarming"""
    flights: int = Field(1, ge=1, le=100)
    """Number of take-offs, each for the duration; faults count from the first."""
    height: float = Field(5.0, gt=0.5, le=100)
    """Height of the hover, m"""
    seed: int = Field(0, ge=0, lt=2**32)
    """Random seed"""
    vehicle: VehicleSpec = VehicleSpec()
    wind: Annotated[tuple[Wind, ...], Field(max_length=MAX_WINDS)] = ()
    """Several are added up"""
    profile: Profile = Profile()
    moments: Annotated[tuple[Moment, ...], Field(max_length=MAX_WINDS)] = ()
    """Several are added up"""
    excitation: Excitation | None = None
    sensors: Sensors = Sensors()
    shaking: Shaking = Shaking()
    stream: StreamSpec = StreamSpec()
    faults: Faults = Faults()
    propeller: Propeller = Propeller()
    load: Load = Load()
    mishap: Annotated[Mishap | None, OR_INF] = None
    """What goes wrong; inf: nothing does"""

    def with_parameter(self, name: str, value: float) -> Scenario:
        """Returns the scenario with another value of a parameter of its autopilot, which is not checked."""
        parameters = self.vehicle.parameters | {name: value}
        vehicle = self.vehicle.model_copy(update={"parameters": parameters})
        return self.model_copy(update={"vehicle": vehicle})

    @property
    def has_instruments(self) -> bool:
        """Whether instruments are simulated: they are sent, or a mishap shows in them."""
        return self.stream.instruments or self.mishap is not None

    @property
    def cycle(self) -> float:
        """Period of the autopilot's control loop, s: by its loop rate among the parameters, or its default."""
        autopilot = self.stream.autopilot
        default_rate = DEFAULT_LOOP_RATES[autopilot]
        loop_rate = self.vehicle.parameters.get(LOOP_RATE_PARAMETERS[autopilot], default_rate)
        return 1 / loop_rate

    def random(self, *purpose: int) -> Generator:
        """Makes the random number generator for one purpose, independent of those for all others.

        Args:
            purpose: One of ``SENSORS``, ``WIND``, ``MOMENT``, ``STICKS``, ``SHAKING``, ``INSTRUMENTS`` and ``MISHAP``,
                and the number of the wind, moment or axis in its list.

        Returns:
            The generator; the same seed and purpose give the same numbers.
        """
        return default_rng(np.random.SeedSequence(self.seed, spawn_key=purpose))

    @model_validator(mode="after")
    def _check_consistency(self) -> Scenario:
        """Checks values of the scenario against each other, which pydantic cannot do field by field.

        Returns:
            The scenario itself, as pydantic requires.

        Raises:
            ValueError: The mixer is for another number of motors, a doublet is longer than its period, a range of
                frequencies is reversed, or a course does not end where it began or comes too near to the ground.
        """
        if self.vehicle.mixer and rotor_count(self.vehicle.frame) != QUADROTOR_MOTORS:
            raise ValueError("vehicle.mixer is for quadrotors only")
        match self.excitation:
            case Doublets(width=width, period=period) if 2 * width > period:
                raise ValueError(
                    "excitation.width must be at most half of excitation.period, "
                    f"{period / 2:g} s, not {width:g}"
                )
            case Chirp(lowest=lowest, highest=highest) | Multisine(lowest=lowest, highest=highest):
                if lowest > highest:
                    raise ValueError(
                        "excitation.lowest must be at most excitation.highest, "
                        f"{highest:g} Hz, not {lowest:g}"
                    )
            case Course(moves=moves):
                legs = [(move.north, move.east, move.up) for move in moves]
                # Position after each move, north, east and up from the hover, m.
                positions = np.cumsum(legs, axis=0)
                if abs(positions[-1]).max() > POSITION_TOLERANCE:
                    raise ValueError("the course must end where it began")
                lowest = self.height + positions[:, 2].min()
                if lowest < MIN_COURSE_HEIGHT:
                    raise ValueError(
                        f"the course must stay {MIN_COURSE_HEIGHT:g} m above the ground, not {lowest:g}"
                    )
        return self
