"""Scenario: what is flown, in what wind, and who tells of it how: everything that decides a simulated flight.

A scenario file is the same in TOML, a table for each section; what it leaves out has the value given here. Directions
are degrees clockwise from north: wind comes *from* its direction, as in weather reports.
"""

from __future__ import annotations

from math import inf
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Angle = Annotated[float, Field(gt=0, le=30)]
"""Degrees of roll that are asked for."""

Speed = Annotated[float, Field(ge=0, le=60)]
"""Of wind, m/s: no hurricane's mean is greater."""

Share = Annotated[float, Field(ge=0, le=1)]

_OrInf = BeforeValidator(lambda given: None if given == inf else given)
"""Beside None, the time that never comes: TOML has no word for None, JSON none for infinity."""


class _Section(BaseModel):
    """A part of a scenario: immutable, without keys it does not know, and without text for numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Vehicle(_Section):
    """Who flies.

    Attributes:
        model: one of the vehicles of ``sitl_scenarios.vehicles``.
        frame: where the rotors are.
        battery_sag: share of the rotors' speed that the battery loses from the beginning of the flight to its end.
        rotor_drag: whether rotors in wind drag the vehicle along and tilt it; if not, its hull still does.
    """

    model: Literal["ardrone2", "iris", "crazyflie"] = "iris"
    frame: Literal["x", "plus"] = "x"
    battery_sag: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    rotor_drag: bool = True


class Steady(_Section):
    """Wind that never changes: ``speed`` m/s from ``direction`` degrees."""

    kind: Literal["steady"]
    speed: Speed
    direction: Finite = 90.0


class Gaussian(_Section):
    """The paper's noise: white noise through a Gaussian kernel, standard deviation ``sd`` m/s along each axis.

    Attributes:
        s: standard deviation of the kernel, s; the autocorrelation is exp(−τ²/4s²).
    """

    kind: Literal["gaussian"]
    sd: Annotated[float, Field(ge=0, le=20)]
    s: Positive


class Dryden(_Section):
    """Turbulence of the Dryden spectra at low altitude (MIL-F-8785C) about a mean wind.

    Attributes:
        speed: of the mean wind, m/s, which counts as wind too.
        direction: the mean wind comes from, degrees.
        wind_at_20_feet: what the intensity follows from, m/s; the military grades are 7.7, 15.4 and 23.2 (15, 30 and
            45 kt: light, moderate and severe).
    """

    kind: Literal["dryden"]
    speed: Speed
    direction: Finite = 90.0
    wind_at_20_feet: Speed = 7.7


class VonKarman(_Section):
    """Turbulence of the von Kármán spectra; attributes as of ``Dryden``."""

    kind: Literal["von_karman"]
    speed: Speed
    direction: Finite = 90.0
    wind_at_20_feet: Speed = 7.7


class Gust(_Section):
    """A 1-cosine gust (MIL-F-8785C).

    Attributes:
        start: seconds into the flight.
        speed: its greatest, m/s.
        direction: it comes from, degrees.
        rise: seconds from its beginning to its greatest, where it stays.
        hold: seconds it stays there before it falls as it rose; None, or ``inf``: for good.
    """

    kind: Literal["gust"]
    start: NotNegative
    speed: Speed
    direction: Finite = 90.0
    rise: Positive = 1.0
    hold: Annotated[NotNegative | None, _OrInf] = 0.0


class Jet(_Section):
    """A blower's jet through the place where the vehicle hovers; entering and leaving its edge makes the wind coloured.

    Attributes:
        speed: on the axis where it leaves the blower, m/s.
        direction: it comes from, degrees.
        distance: from the blower to where the vehicle hovers, m.
        diameter: of the blower's mouth, m.
        turbulence: standard deviation of the speed in the jet, as a share of the local mean.
        s: of the kernel of that turbulence, s, as in ``Gaussian``.
        offset: of the jet's axis to the right of where the vehicle hovers, seen along the jet, m.
    """

    kind: Literal["jet"]
    speed: Speed
    direction: Finite = 90.0
    distance: Positive = 2.0
    diameter: Positive = 0.5
    turbulence: Annotated[float, Field(ge=0, le=1)] = 0.2
    s: Positive = 0.05
    offset: Finite = 0.0


Wind = Annotated[Steady | Gaussian | Dryden | VonKarman | Gust | Jet, Field(discriminator="kind")]


class Moment(_Section):
    """A coloured moment on the body, whatever the wind: ``sd`` N m about ``axis``, colour ``s`` as in ``Gaussian``."""

    axis: Literal["roll", "pitch", "yaw"] = "roll"
    sd: NotNegative
    s: Positive


class Doublets(_Section):
    """The stick to the right, then to the left: ``amplitude`` degrees for ``width`` s each, every ``period`` s."""

    kind: Literal["doublets"]
    amplitude: Angle = 8.0
    width: Positive = 0.4
    period: Positive = 5.0


class Chirp(_Section):
    """A sine of ``amplitude`` degrees whose frequency rises from ``lowest`` to ``highest`` Hz every ``period`` s."""

    kind: Literal["chirp"]
    amplitude: Angle = 3.0
    lowest: Positive = 0.2
    highest: Positive = 5.0
    period: Positive = 20.0


class Multisine(_Section):
    """Sines of even power from ``lowest`` to ``highest`` Hz with Schroeder's phases, ``sd`` degrees together."""

    kind: Literal["multisine"]
    sd: Angle = 2.0
    lowest: Positive = 0.2
    highest: Positive = 5.0
    period: Positive = 20.0


class Steps(_Section):
    """Sideways steps of ``distance`` m, there and back, every ``period`` s."""

    kind: Literal["steps"]
    distance: Annotated[float, Field(gt=0, le=100)] = 2.0
    period: Positive = 6.0


Excitation = Annotated[Doublets | Chirp | Multisine | Steps, Field(discriminator="kind")]


class Sensors(_Section):
    """Standard deviations of white noise on what the autopilot knows, and how late it knows it.

    Attributes:
        rate_sd: rad/s, of each body rate.
        attitude_sd: rad, of roll, pitch and yaw.
        position_sd: m, of each coordinate; velocity_sd: m/s.
        delay: seconds from the motion to the motors' command.
    """

    rate_sd: NotNegative = 0.005
    attitude_sd: NotNegative = 0.001
    position_sd: NotNegative = 0.02
    velocity_sd: NotNegative = 0.02
    delay: Annotated[float, Field(ge=0, le=0.05)] = 0.004


class Stream(_Section):
    """What the autopilot sends.

    Attributes:
        speaks: whose messages, units and parameters.
        rate: Hz, of attitude and of motor outputs, and four times that of any other message that comes often.
        rates: Hz by the name of a message, instead.
        system: its MAVLink system id.
        version: of MAVLink's frames.
    """

    speaks: Literal["px4", "ardupilot"] = "px4"
    rate: Annotated[float, Field(gt=0, le=400)] = 100.0
    rates: dict[str, Annotated[float, Field(ge=0, le=400)]] = {}
    system: Annotated[int, Field(ge=1, le=250)] = 1
    version: Literal[1, 2] = 2


class Faults(_Section):
    """What the link does to the stream, by chance.

    Attributes:
        loss: share of the messages that are lost.
        delay: seconds that each is late; jitter: up to so many more.
        reordered: share of the messages that are overtaken by the one after.
        reboot: seconds into the flight at which the autopilot begins anew, in the air, with a clock from zero; None,
            or ``inf``: never.
    """

    loss: Share = 0.0
    delay: NotNegative = 0.0
    jitter: NotNegative = 0.0
    reordered: Share = 0.0
    reboot: Annotated[Positive | None, _OrInf] = None


class Scenario(_Section):
    """A flight from arming to disarming: climb, hover as the sections say, land.

    Attributes:
        description: one sentence for ``mavdem fly --list``.
        duration: seconds from arming to disarming.
        height: of the hover, m.
        seed: of everything random.
        wind: summed.
        moments: summed.
    """

    description: str = ""
    duration: Annotated[float, Field(ge=15, le=7200)] = 60.0
    height: Annotated[float, Field(gt=0.5, le=100)] = 5.0
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    vehicle: Vehicle = Vehicle()
    wind: tuple[Wind, ...] = ()
    moments: tuple[Moment, ...] = ()
    excitation: Excitation | None = None
    sensors: Sensors = Sensors()
    stream: Stream = Stream()
    faults: Faults = Faults()

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        """What no key can be wrong in by itself."""
        for place, wind in enumerate(self.wind):
            if isinstance(wind, Gaussian | Jet) and wind.s >= self.duration:
                raise ValueError(_too_long(f"wind.{place}.s", wind.s, self.duration))
            if isinstance(wind, Gust) and wind.start >= self.duration:
                raise ValueError(_too_long(f"wind.{place}.start", wind.start, self.duration))
        for place, moment in enumerate(self.moments):
            if moment.s >= self.duration:
                raise ValueError(_too_long(f"moments.{place}.s", moment.s, self.duration))
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
