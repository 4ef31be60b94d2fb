"""Wind of a simulated flight: steady wind, gusts, turbulence and jets of blowers, summed for each control cycle."""

from collections.abc import Callable
from functools import partial
from math import cos, exp, log, pi

import numpy as np
from numpy.random import Generator

from sitl_scenarios.dynamics import AirState
from sitl_scenarios.motion import Array
from sitl_scenarios.rotors import rotor_frame
from sitl_scenarios.scenario import (
    MOMENT,
    WIND,
    GaussianWind,
    Gust,
    Jet,
    Scenario,
    SteadyWind,
    TurbulentWind,
    Wind,
    downwind_direction,
)
from sitl_scenarios.turbulence import (
    dryden_longitudinal,
    dryden_transverse,
    gaussian_noise,
    longitudinal_autocorrelation,
    transverse_autocorrelation,
    turbulence_scales,
    von_karman_noise,
)
from sitl_scenarios.vectors import Vector3
from sitl_scenarios.vehicles import airframe

CORE_DIAMETERS = 6.0
"""Length of a jet's potential core by the diameter of its mouth: at its end the speed on the axis begins to fall."""

JET_SPREAD = 0.094
"""Half-width of a jet at half its axial speed, by the distance from its mouth (S. B. Pope, "Turbulent Flows", 2000)."""

BLOCK_ROWS = 1000
"""Rows of an array that are converted into floats at once."""

Process = Callable[[float, float, int, Generator], Array]
"""Random process of variance 1, as a function of time constant (s), period (s), number of samples and generator."""


def jet_speed(jet: Jet, axial_distance: float, radial_distance: float) -> float:
    """Returns the mean speed in a round turbulent jet.

    Beyond the potential core the speed on the axis falls as U_c/U₀ = 6 d/x, and the profile's half-width grows as
    r_½ = 0.094 x (S. B. Pope, "Turbulent Flows", 2000, section 5.1); in the core, up to x = 6 d, both are taken as at
    its end. The profile is Gaussian, a common approximation (J. Lee and V. Chu, "Turbulent Jets and Plumes", 2003) to
    Pope's (1 + (√2 − 1)(r/r_½)²)⁻²: they differ by 0.08 U_c at most, at 2 r_½. Radial speeds of the mean are left out,
    and so are gradients across the vehicle.

    Args:
        jet: Speed and diameter at the mouth.
        axial_distance: Distance from the mouth along the axis, m; behind the mouth, there is no wind.
        radial_distance: Distance from the axis, m.

    Returns:
        Speed along the axis, m/s.
    """
    if axial_distance <= 0.0:
        return 0.0
    core_length = CORE_DIAMETERS * jet.diameter
    speed_on_axis = jet.speed * min(1.0, core_length / axial_distance)
    half_width = JET_SPREAD * max(axial_distance, core_length)
    return speed_on_axis * exp(-log(2) * (radial_distance / half_width) ** 2)


def gust_speed(gust: Gust, time: Array) -> Array:
    """Returns the speed of a 1-cosine gust (MIL-F-8785C), v/2 (1 − cos(π x)) with x from 0 to 1 during its rise.

    Args:
        gust: The gust, with its speed v, start, time of rise and time at full speed. It falls as it rose.
        time: Times since arming, s; (N,).

    Returns:
        (N,) speed, m/s.
    """
    # The fraction x of the rise.
    fraction = np.clip((time - gust.start) / gust.rise, 0.0, 1.0)
    # A gust without a hold never falls.
    if gust.hold is not None:
        fall_start = time - gust.start - gust.rise - gust.hold
        fraction = fraction - np.clip(fall_start / gust.rise, 0.0, 1.0)
    # The C library's cosine: NumPy's own chooses instructions by the machine, and the last bit with them.
    return np.array([gust.speed / 2 * (1 - cos(pi * x)) for x in fraction.tolist()])


class RowsByBlock:
    """Rows of an array as lists of floats, converted a block at a time: for single rows NumPy's calls are slow."""

    def __init__(self, values: Array) -> None:
        """Takes ``values`` (N, n)."""
        self._values = values
        self._first = 0
        self._block: list[list[float]] = []

    def row(self, index: int) -> list[float]:
        """Returns a row as n floats; rows are asked for one after another."""
        if not self._first <= index < self._first + len(self._block):
            self._first = index
            self._block = self._values[index : index + BLOCK_ROWS].tolist()
        return self._block[index - self._first]


class JetFlow:
    """Air of one horizontal jet: its mean and its turbulence in every cycle."""

    def __init__(self, jet: Jet, height: float, turbulence: Array) -> None:
        """Places the jet.

        Args:
            jet: Speed, direction, distance and diameter of the blower's jet.
            height: Height of its axis, m: as high as the hover.
            turbulence: Deviations of the speed along the jet, across it to the right, and down, as fractions of the
                local mean speed; (N, 3).
        """
        self._jet = jet
        self._height = height
        self._axis_north, self._axis_east, _ = downwind_direction(jet.direction).tolist()
        self._turbulence = RowsByBlock(turbulence)

    def wind_at(self, cycle: int, position: Vector3) -> Vector3:
        """Computes the velocity of the air of a jet in one cycle at one position: its mean and its turbulence there.

        The position is split into distances along the jet's axis and from it, which give the local mean speed.
        Turbulence is proportional to that speed, so that it fades at the edge of the jet as the mean does.

        Args:
            cycle: Number of the cycle, from 0.
            position: Position of the vehicle, NED, m.

        Returns:
            Velocity, NED, m/s.
        """
        axis_north = self._axis_north
        axis_east = self._axis_east
        # The origin is on the ground below the place of the hover, and the blower ``distance`` away from there.
        north, east, down = position
        axial_distance = self._jet.distance + north * axis_north + east * axis_east
        right_of_axis = east * axis_north - north * axis_east - self._jet.offset
        below_axis = down + self._height
        radial_distance = (right_of_axis * right_of_axis + below_axis * below_axis) ** 0.5
        mean_speed = jet_speed(self._jet, axial_distance, radial_distance)
        # Components along the jet, to its right and down, as fractions of the local mean speed: the mean itself is 1
        # along the jet.
        axial_turbulence, lateral, vertical = self._turbulence.row(cycle)
        axial = 1.0 + axial_turbulence
        return (
            mean_speed * (axial * axis_north - lateral * axis_east),
            mean_speed * (axial * axis_east + lateral * axis_north),
            mean_speed * vertical,
        )


class Weather:
    """The air of a flight: the sum of all winds and moments of a scenario, constant during each cycle."""

    def __init__(self, scenario: Scenario, dt: float, time: Array) -> None:
        """Draws all winds and moments but those that depend on the position: jets and the profile with height.

        Args:
            scenario: Winds, moments, profile and random seed.
            dt: Period of the cycles, s.
            time: Beginning of each cycle, s since arming; (N,).
        """
        samples = len(time)
        # One row for each cycle; columns are the fields of AirState.
        self._air = np.zeros((samples, len(AirState._fields)))
        self._jets: list[JetFlow] = []
        self._profile = scenario.profile
        self._time = time.tolist()
        # Each wind and moment has random numbers of its own: another one added does not change them.
        for number, wind in enumerate(scenario.wind):
            noise = scenario.random(WIND, number)
            if isinstance(wind, Jet):
                # Noise along, across and down.
                columns = [gaussian_noise(wind.s, dt, samples, noise) for _ in range(3)]
                turbulence = wind.turbulence * np.column_stack(columns)
                self._jets.append(JetFlow(wind, scenario.height, turbulence))
            else:
                self._add_wind(scenario, wind, dt, time, noise)
        for number, moment in enumerate(scenario.moments):
            noise = scenario.random(MOMENT, number)
            column = AirState._fields.index(moment.axis)
            moments = gaussian_noise(moment.s, dt, samples, noise)
            self._air[:, column] += moment.sd * moments
        self._air_rows = RowsByBlock(self._air)
        # Whether the scenario has a profile: without one the wind is the same at all heights.
        self._has_profile = bool(self._profile.model_fields_set)

    def _add_wind(
        self, scenario: Scenario, wind: Wind, dt: float, time: Array, noise: Generator
    ) -> None:
        """Adds a wind that is the same everywhere to the air of all cycles.

        Args:
            scenario: Vehicle and height of the hover, on which turbulence depends.
            wind: Any wind but a jet.
            dt: Period of the cycles, s.
            time: Beginning of each cycle, s since arming; (N,).
            noise: Random number generator of this wind.
        """
        # Views of the first fields of AirState, which are the velocity (3) and then the rotation about the horizontal
        # axes (2): adding to them in place adds to the air.
        velocity = self._air[:, :3]
        velocity_and_rotation = self._air[:, :5]
        match wind:
            case SteadyWind():
                velocity += wind.speed * downwind_direction(wind.direction)
            case GaussianWind():
                for axis in range(3):
                    velocity[:, axis] += wind.sd * gaussian_noise(wind.s, dt, len(time), noise)
            case Gust():
                velocity += gust_speed(wind, time)[:, None] * downwind_direction(wind.direction)
            case TurbulentWind():
                velocity_and_rotation += _turbulent_air(wind, scenario, dt, len(time), noise)

    def air_at(self, cycle: int, position: Vector3) -> AirState:
        """Returns the state of the air in one cycle at the position of the vehicle.

        Most winds are the same everywhere, and were computed before the flight. The jets, and the change of the wind
        with height (profile), depend on the position, and are computed here.

        Args:
            cycle: Number of the cycle, from 0. Before the first cycle the air is as in the first one, and after the
                last cycle as in the last one.
            position: Position of the vehicle, NED, m.

        Returns:
            Wind, NED, m/s, rotation of the air, rad/s, and external moments, N m.
        """
        last_cycle = len(self._air) - 1
        cycle = min(max(cycle, 0), last_cycle)
        # Wind, rotation of the air about the body's axes x and y, and moments about its three axes.
        north, east, down, p, q, roll, pitch, yaw = self._air_rows.row(cycle)
        if self._has_profile:
            height = -position[2]
            # The first cycles may be before arming.
            seconds_since_arming = max(self._time[cycle], 0.0)
            # The profile turns the horizontal wind and scales it: scale × cosine and scale × sine of the angle.
            cosine, sine = self._profile.at(height, seconds_since_arming)
            north, east = cosine * north - sine * east, sine * north + cosine * east
        for jet in self._jets:
            jet_north, jet_east, jet_down = jet.wind_at(cycle, position)
            north += jet_north
            east += jet_east
            down += jet_down
        return AirState(north, east, down, p, q, roll, pitch, yaw)


def _turbulent_air(
    wind: TurbulentWind, scenario: Scenario, dt: float, samples: int, generator: Generator
) -> Array:
    """Draws the mean wind with its turbulence, by the model of Dryden or von Kármán (MIL-F-8785C).

    The components along the wind, across it and down are independent processes of unit variance, scaled by their
    intensities and rotated into NED. The air's rotation about both horizontal axes is a first-order process, which is
    what Dryden's longitudinal process is. The order of the draws is fixed: a seed always gives the same wind.

    Args:
        wind: Model, mean wind and intensity.
        scenario: Vehicle and height of the hover.
        dt: Sampling period, s.
        samples: Number of samples.
        generator: Random number generator.

    Returns:
        (samples, 5) velocity, NED, m/s, and the air's rotation about the forward and right axes, rad/s: the first
        fields of ``AirState``.
    """
    frame = rotor_frame(scenario.vehicle.frame, airframe(scenario.vehicle).arm)
    # The distance between the outermost rotors takes the place of the wing span of the standard.
    span = max(frame.right) - min(frame.right)
    horizontal, vertical, rotation = turbulence_scales(wind, scenario.height, span)
    longitudinal: Process = dryden_longitudinal
    transverse: Process = dryden_transverse
    if wind.kind == "von_karman":
        longitudinal = partial(von_karman_noise, longitudinal_autocorrelation)
        transverse = partial(von_karman_noise, transverse_autocorrelation)
    time_constant = horizontal.time_constant
    along_wind = wind.speed + horizontal.sd * longitudinal(time_constant, dt, samples, generator)
    lateral = horizontal.sd * transverse(time_constant, dt, samples, generator)
    down = vertical.sd * transverse(vertical.time_constant, dt, samples, generator)
    p = rotation.sd * dryden_longitudinal(rotation.time_constant, dt, samples, generator)
    q = rotation.sd * dryden_longitudinal(rotation.time_constant, dt, samples, generator)
    axis_north, axis_east, _ = downwind_direction(wind.direction)
    north = along_wind * axis_north - lateral * axis_east
    east = along_wind * axis_east + lateral * axis_north
    return np.column_stack([north, east, down, p, q])
