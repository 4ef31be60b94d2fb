"""Scenario: what is flown, in what wind, and who tells of it how: everything that decides a simulated flight.

A scenario file is the same in TOML, a table for each section; what it leaves out has the value given here. Directions
are degrees clockwise from north: wind comes *from* its direction, as in weather reports. What is said of each key here,
``mavdem fly --describe`` says too: it is the description of the pydantic field.
"""

from __future__ import annotations

from math import inf
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from sitl_scenarios.places import place

LONGEST = 7200.0
"""Seconds of a flight: an hour is much, and two are enough."""

MOST = 16
"""Winds, and moments, that are summed."""

Positive = Annotated[float, Field(gt=0, le=LONGEST)]
NotNegative = Annotated[float, Field(ge=0, le=LONGEST)]

Kernel = Annotated[float, Field(ge=1e-3, le=60)]
"""Seconds. What is shorter than the steps of the physics is white to them; what is longer changes in no flight."""

Angle = Annotated[float, Field(gt=0, le=30)]
"""Degrees of roll that are asked for."""

Frequency = Annotated[float, Field(gt=0, le=200)]
"""Hz: half of the greatest rate of a stream."""

Speed = Annotated[float, Field(ge=0, le=60)]
"""Of wind, m/s: no hurricane's mean is greater."""

Direction = Annotated[float, Field(ge=-360, le=360)]

Share = Annotated[float, Field(ge=0, le=1)]

_OrInf = BeforeValidator(lambda given: None if given == inf else given)
"""Beside None, the time that never comes: TOML has no word for None, JSON none for infinity."""


class _Section(BaseModel):
    """A part of a scenario: immutable, without keys it does not know, and without text for numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)


class Vehicle(_Section):
    """Who flies."""

    model: Literal["ardrone2", "iris", "crazyflie"] = "iris"
    """AR.Drone 2.0, 3DR Iris or Crazyflie 2."""
    frame: Literal["x", "plus"] = "x"
    """Where the rotors are."""
    battery_sag: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Share of the rotors' speed that the battery loses from the beginning of the flight to its end."""
    rotor_drag: bool = True
    """Whether rotors in wind drag the vehicle along and tilt it; if not, its hull still does."""


class Steady(_Section):
    """Wind that never changes."""

    kind: Literal["steady"]
    speed: Speed
    """Of the wind, m/s."""
    direction: Direction = 90.0
    """It comes from, degrees clockwise from north."""


class Gaussian(_Section):
    """The paper's noise: white noise through a Gaussian kernel; the autocorrelation is exp(−τ²/4s²)."""

    kind: Literal["gaussian"]
    sd: Annotated[float, Field(ge=0, le=20)]
    """Standard deviation along each axis, m/s."""
    s: Kernel
    """Standard deviation of the kernel, s."""


class Dryden(_Section):
    """Turbulence of the Dryden spectra at low altitude (MIL-F-8785C) about a mean wind.

    The military grades of ``wind_at_20_feet`` are 7.7, 15.4 and 23.2 (15, 30 and 45 kt: light, moderate and severe).
    """

    kind: Literal["dryden"]
    speed: Speed
    """Of the mean wind, m/s, which counts as wind too."""
    direction: Direction = 90.0
    """The mean wind comes from, degrees clockwise from north."""
    wind_at_20_feet: Speed = 7.7
    """What the intensity follows from, m/s: 7.7 is light, 15.4 moderate, 23.2 severe."""


class VonKarman(_Section):
    """Turbulence of the von Kármán spectra; keys as of ``Dryden``."""

    kind: Literal["von_karman"]
    speed: Speed
    """Of the mean wind, m/s, which counts as wind too."""
    direction: Direction = 90.0
    """The mean wind comes from, degrees clockwise from north."""
    wind_at_20_feet: Speed = 7.7
    """What the intensity follows from, m/s: 7.7 is light, 15.4 moderate, 23.2 severe."""


class Gust(_Section):
    """A 1-cosine gust (MIL-F-8785C)."""

    kind: Literal["gust"]
    start: NotNegative
    """Seconds into the flight."""
    speed: Speed
    """Its greatest, m/s."""
    direction: Direction = 90.0
    """It comes from, degrees clockwise from north."""
    rise: Annotated[float, Field(ge=1e-3, le=LONGEST)] = 1.0
    """Seconds from its beginning to its greatest, where it stays."""
    hold: Annotated[NotNegative | None, _OrInf] = 0.0
    """Seconds it stays there before it falls as it rose; inf: for good."""


class Jet(_Section):
    """A blower's jet through the place where the vehicle hovers; entering and leaving its edge colours the wind."""

    kind: Literal["jet"]
    speed: Speed
    """On the axis where it leaves the blower, m/s."""
    direction: Direction = 90.0
    """It comes from, degrees clockwise from north."""
    distance: Annotated[float, Field(ge=0.01, le=100)] = 2.0
    """From the blower to where the vehicle hovers, m."""
    diameter: Annotated[float, Field(ge=0.01, le=10)] = 0.5
    """Of the blower's mouth, m."""
    turbulence: Share = 0.2
    """Standard deviation of the speed in the jet, as a share of the local mean."""
    s: Kernel = 0.05
    """Of the kernel of that turbulence, s, as of a gaussian wind."""
    offset: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Of the jet's axis to the right of where the vehicle hovers, seen along the jet, m."""


Wind = Annotated[Steady | Gaussian | Dryden | VonKarman | Gust | Jet, Field(discriminator="kind")]


class Moment(_Section):
    """A coloured moment on the body, whatever the wind."""

    axis: Literal["roll", "pitch", "yaw"] = "roll"
    """It turns the vehicle about."""
    sd: Annotated[float, Field(ge=0, le=10)]
    """Standard deviation, N m."""
    s: Kernel
    """Standard deviation of the kernel, s, as of a gaussian wind."""


class Doublets(_Section):
    """The stick to the right, then to the left, again and again."""

    kind: Literal["doublets"]
    amplitude: Angle = 8.0
    """Of roll, degrees."""
    width: Positive = 0.4
    """Seconds to each side; at most half of the period."""
    period: Positive = 5.0
    """Seconds from one to the next."""


class Chirp(_Section):
    """A sine of roll whose frequency rises, again and again."""

    kind: Literal["chirp"]
    amplitude: Angle = 3.0
    """Of roll, degrees."""
    lowest: Frequency = 0.2
    """Hz, at the beginning."""
    highest: Frequency = 5.0
    """Hz, at the end; below half of the stream's rate."""
    period: Positive = 20.0
    """Seconds from one to the next."""


class Multisine(_Section):
    """Sines of roll together, of even power, with Schroeder's phases."""

    kind: Literal["multisine"]
    sd: Angle = 2.0
    """Standard deviation of all together, degrees."""
    lowest: Frequency = 0.2
    """Hz; at least one turn in a period."""
    highest: Frequency = 5.0
    """Hz; below half of the stream's rate."""
    period: Positive = 20.0
    """Seconds after which they repeat."""


class Steps(_Section):
    """Sideways steps, there and back, again and again."""

    kind: Literal["steps"]
    distance: Annotated[float, Field(gt=0, le=100)] = 2.0
    """To the right, m."""
    period: Positive = 6.0
    """Seconds from one to the next."""


Excitation = Annotated[Doublets | Chirp | Multisine | Steps, Field(discriminator="kind")]


class Sensors(_Section):
    """White noise on what the autopilot knows, and how late it knows it."""

    rate_sd: Annotated[float, Field(ge=0, le=10)] = 0.005
    """Standard deviation of each body rate, rad/s."""
    attitude_sd: Share = 0.001
    """Standard deviation of roll, pitch and yaw, rad."""
    position_sd: Annotated[float, Field(ge=0, le=100)] = 0.02
    """Standard deviation of each coordinate, m."""
    velocity_sd: Annotated[float, Field(ge=0, le=100)] = 0.02
    """Standard deviation of each velocity, m/s."""
    delay: Annotated[float, Field(ge=0, le=0.05)] = 0.004
    """Seconds from the motion to the motors' command."""


class Stream(_Section):
    """What the autopilot sends."""

    speaks: Literal["px4", "ardupilot"] = "px4"
    """Whose messages, units and parameters."""
    rate: Annotated[float, Field(ge=0.1, le=400)] = 100.0
    """Hz of attitude and of motor outputs; other messages that come often come at a quarter of it."""
    rates: dict[str, Annotated[float, Field(ge=0, le=400)]] = {}
    """Hz by the name of a message, instead: {ATTITUDE = 50, SYS_STATUS = 1}."""
    system: Annotated[int, Field(ge=1, le=250)] = 1
    """Its MAVLink system id."""
    version: Literal[1, 2] = 2
    """Of MAVLink's frames."""


class Faults(_Section):
    """What the link does to the stream, by chance."""

    loss: Share = 0.0
    """Share of the messages that are lost."""
    delay: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Seconds that each is late."""
    jitter: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Up to so many seconds more."""
    reordered: Share = 0.0
    """Share of the messages that are overtaken by the one after."""
    reboot: Annotated[Positive | None, _OrInf] = None
    """Seconds into the flight at which the autopilot begins anew, in the air, with a clock from zero; inf: never."""


class Scenario(_Section):
    """A flight from arming to disarming: climb, hover as the sections say, land."""

    description: str = ""
    """One sentence that says what it is."""
    duration: Annotated[float, Field(ge=15, le=LONGEST)] = 60.0
    """Seconds from arming to disarming."""
    height: Annotated[float, Field(gt=0.5, le=100)] = 5.0
    """Of the hover, m."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Of everything random."""
    vehicle: Vehicle = Vehicle()
    wind: Annotated[tuple[Wind, ...], Field(max_length=MOST)] = ()
    """Summed."""
    moments: Annotated[tuple[Moment, ...], Field(max_length=MOST)] = ()
    """Summed."""
    excitation: Excitation | None = None
    sensors: Sensors = Sensors()
    stream: Stream = Stream()
    faults: Faults = Faults()

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        """What no key can be wrong in by itself."""
        for number, wind in enumerate(self.wind):
            if isinstance(wind, Gaussian | Jet) and wind.s >= self.duration:
                raise ValueError(_too_long(place(["wind", number, "s"]), wind.s, self.duration))
            if isinstance(wind, Gust) and wind.start >= self.duration:
                raise ValueError(_too_long(place(["wind", number, "start"]), wind.start, self.duration))
        for number, moment in enumerate(self.moments):
            if moment.s >= self.duration:
                raise ValueError(_too_long(place(["moments", number, "s"]), moment.s, self.duration))
        excitation = self.excitation
        if excitation is not None and excitation.period >= self.duration:
            raise ValueError(_too_long("excitation.period", excitation.period, self.duration))
        if isinstance(excitation, Doublets) and 2 * excitation.width > excitation.period:
            raise ValueError(
                f"excitation.width must be at most half of excitation.period, {excitation.period / 2:g} s, "
                f"not {excitation.width:g}"
            )
        if isinstance(excitation, Chirp | Multisine):
            if excitation.lowest > excitation.highest:
                raise ValueError(
                    f"excitation.lowest must be at most excitation.highest, {excitation.highest:g} Hz, "
                    f"not {excitation.lowest:g}"
                )
            if excitation.highest >= self.stream.rate / 2:
                raise ValueError(
                    f"excitation.highest must be below half of stream.rate, {self.stream.rate / 2:g} Hz, "
                    f"not {excitation.highest:g}"
                )
        if isinstance(excitation, Multisine) and excitation.lowest * excitation.period < 1:
            raise ValueError(
                f"excitation.lowest must be at least one turn in excitation.period, {1 / excitation.period:g} Hz, "
                f"not {excitation.lowest:g}"
            )
        if self.faults.reboot is not None and self.faults.reboot >= self.duration:
            raise ValueError(_too_long("faults.reboot", self.faults.reboot, self.duration))
        return self


def _too_long(key: str, given: float, duration: float) -> str:
    return f"{key} must be less than the duration of the flight, {duration:g} s, not {given:g}"
