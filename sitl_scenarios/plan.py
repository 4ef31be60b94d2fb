"""Flight plan: setpoints over time, from arming to disarming."""

from math import cos, fsum, hypot, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np
from scipy.fft import ifft

from sitl_scenarios.dynamics import Three
from sitl_scenarios.motion import Array, Pair
from sitl_scenarios.scenario import (
    AXES,
    STICKS,
    Chirp,
    Course,
    Doublets,
    Move,
    Multisine,
    Scenario,
    Steps,
    Sticks,
)
from sitl_scenarios.wind import gaussian_noise

BOOT_SECONDS = 2.0  # Seconds from the autopilot's boot until it arms itself
SPIN_UP_SECONDS = 1.0  # Seconds from arming to take-off
SETTLE_SECONDS = 2.0  # Seconds of hover before the excitation begins, and after it ends
# Seconds simulated after disarming; and from touch-down, as it is planned, to disarming
AFTER_SECONDS = 1.0
FULL_STICK = (radians(35), radians(35), radians(150))
"""Roll and pitch, rad, and yaw rate, rad/s, that a stick asks for at its end: PX4's defaults of MPC_MAN_TILT_MAX and
MPC_MAN_Y_MAX."""
BRAKING = 2.5  # m/s² at the beginning and the end of a move
_FASTEST = 1.5  # m/s: the mean of a climb or a descent that takes longer than the usual time


class Reference(NamedTuple):
    """At one instant of the flight."""

    landed_state: int  # MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing
    height: float  # m; climb: its rate, m/s
    climb: float
    aside: float  # of the place to hover at, east of the first, m
    # to add to the roll and pitch that the position asks for, rad; yaw rate, rad/s
    demand: Three = (0.0, 0.0, 0.0)
    by_stick: bool = False  # whether a pilot's sticks ask for it
    north: float = 0.0  # of the place to hover at, m
    velocity: Pair = (0.0, 0.0)  # of that place, north and east, m/s


class Times(NamedTuple):
    """Of a flight, s: how long climb and descent take, and when, after arming, hover and descent begin."""

    climb: float
    descent: float
    hover: float
    landing: float


def times(scenario: Scenario) -> Times:
    """Returns when a scenario does what. Raises ValueError: the duration leaves no time to hover."""
    climb = max(3.0, scenario.height / _FASTEST)
    descent = max(4.0, scenario.height / _FASTEST)
    moves = scenario.excitation.moves if isinstance(scenario.excitation, Course) else ()
    lasts = fsum(sum(move_seconds(move)[1:]) for move in moves)
    excited = max(lasts, 1.0)
    shortest = SPIN_UP_SECONDS + climb + excited + 2 * SETTLE_SECONDS + descent + AFTER_SECONDS
    if scenario.duration < shortest:
        least = (
            f"at least {shortest:g} s for a height of {scenario.height:g} m"
            + " and the course" * bool(moves)
        )
        raise ValueError(f"duration must be {least}, not {scenario.duration:g}")
    return Times(
        climb, descent, SPIN_UP_SECONDS + climb, scenario.duration - AFTER_SECONDS - descent
    )


def seconds(scenario: Scenario) -> float:
    """Returns the seconds from boot to the end of the last flight, with those on the ground before and after each."""
    return scenario.flights * (BOOT_SECONDS + scenario.duration + AFTER_SECONDS)


class FlightPlan:
    """Spin up, climb for 3 s or longer, hover and be excited, descend, wait; raises ValueError: no time to hover."""

    def __init__(self, scenario: Scenario) -> None:
        self._times = times(scenario)
        self._height = scenario.height
        self._excitation = scenario.excitation
        self._cycle = cycle = scenario.cycle
        table = np.zeros((1, 3))
        if isinstance(scenario.excitation, Multisine):
            table = _multisine(scenario.excitation, cycle)
        elif isinstance(scenario.excitation, Sticks):
            samples = round((self._times.landing - self._times.hover) / cycle)
            table = _sticks(scenario, scenario.excitation, samples)
        elif isinstance(scenario.excitation, Course):
            once = _course(scenario.excitation, cycle)
            excited = self._times.landing - self._times.hover - 2 * SETTLE_SECONDS
            repeats = int(excited / (len(once) * cycle) + 1e-9)
            self._course = np.tile(once, (repeats, 1)).tolist()
        self._table: list[Three] = list(map(tuple, table.tolist()))

    def at(self, time: float) -> Reference:
        """Returns the reference ``time`` seconds after arming."""
        climb, descent, hover, landing = self._times
        if time < SPIN_UP_SECONDS:
            return Reference(1, 0.0, 0.0, 0.0)
        if time < hover:
            done, rate = _smooth((time - SPIN_UP_SECONDS) / climb)
            return Reference(3, self._height * done, self._height * rate / climb, 0.0)
        if time < landing:
            reference = Reference(2, self._height, 0.0, 0.0)
            if hover + SETTLE_SECONDS <= time < landing - SETTLE_SECONDS:
                return self._excited(reference, time - hover - SETTLE_SECONDS)
            return reference
        done, rate = _smooth(min((time - landing) / descent, 1.0))
        way = self._height + 0.2  # aims below the ground, so as to touch it
        return Reference(4, self._height - way * done, -way * rate / descent, 0.0)

    def _excited(self, hover: Reference, time: float) -> Reference:
        """The reference of the ``hover``, ``time`` seconds after the excitation began."""
        match self._excitation:
            case Doublets(axis=axis, amplitude=amplitude, width=width, period=period):
                phase = time % period
                sign = 1.0 if phase < width else -1.0 if phase < 2 * width else 0.0
                turn = AXES[int(time // period) % len(AXES)] if axis == "all" else axis
                angle = radians(amplitude) * sign
                return hover._replace(demand=_about(turn, angle))
            case Chirp(
                axis=axis, amplitude=amplitude, lowest=lowest, highest=highest, period=period
            ):
                since = time % period
                sweep = (highest - lowest) * since / period / 2
                turns = (lowest + sweep) * since
                angle = radians(amplitude) * sin(2 * pi * turns)
                return hover._replace(demand=_about(axis, angle))
            case Multisine() | Sticks():
                row = round(time / self._cycle) % len(self._table)
                demand = self._table[row]
                by_stick = isinstance(self._excitation, Sticks)
                return hover._replace(demand=demand, by_stick=by_stick)
            case Steps(distance=distance, period=period):
                return hover._replace(aside=0.0 if time // period % 2 else distance)
            case Course():
                row = min(round(time / self._cycle), len(self._course) - 1)
                north, east, up, ahead, aside, climb, turn = self._course[row]
                height = self._height + up
                demand = (0.0, 0.0, turn)
                return Reference(2, height, climb, east, demand, False, north, (ahead, aside))
            case None:
                return hover


def move_seconds(move: Move) -> tuple[float, float, float]:
    """Returns its greatest speed, m/s, and how long its leg or turn, and the hover after it, take, s."""
    length = hypot(move.north, move.east, move.up)
    fastest = min(move.speed, sqrt(BRAKING * length))
    leg = length / fastest + fastest / BRAKING if length else 0.0
    turn = abs(move.turn) / move.rate
    return fastest, max(leg, turn), move.hover


def _course(course: Course, cycle: float) -> Array:
    """(N, 7) of each cycle: place north, east and up, m, its velocity likewise, m/s, and yaw rate, rad/s."""
    begin = np.zeros(3)
    rows = []
    for move in course.moves:
        way = np.array([move.north, move.east, move.up])
        fastest, lasts, hover = move_seconds(move)
        cycles = round((lasts + hover) / cycle)
        time = cycle * np.arange(cycles)
        length = hypot(*way)
        ramp = fastest / BRAKING
        leg = length / fastest + ramp if length else 0.0
        # Faster, evenly, and slower again.
        first = np.minimum(time, ramp)
        last = np.clip(time - leg + ramp, 0.0, ramp)
        steadily = np.clip(time - ramp, 0.0, leg - ramp)
        done = BRAKING / 2 * (first**2 - last**2) + fastest * steadily
        is_turning = time < abs(move.turn) / move.rate
        side = 1 if move.turn > 0 else -1
        turning = radians(move.rate) * is_turning * side
        along = way / (length or 1.0)
        places = begin + np.outer(done, along)
        velocities = np.outer(BRAKING * (first - last), along)
        rows.append(np.column_stack([places, velocities, turning]))
        begin = begin + way
    return np.concatenate(rows)


def _about(axis: str, value: float) -> Three:
    return tuple(value if axis == name else 0.0 for name in AXES)


def _sticks(scenario: Scenario, sticks: Sticks, samples: int) -> Array:
    """(samples, 3) demands; a stick stops at its end."""
    demands = np.zeros((samples, 3))
    for number, (name, full) in enumerate(zip(AXES, FULL_STICK, strict=True)):
        if sticks.axis in (name, "all"):
            noise = scenario.random(STICKS, number)
            moved = gaussian_noise(sticks.s, scenario.cycle, samples, noise)
            angles = radians(sticks.sd) * moved
            demands[:, number] = np.clip(angles, -full, full)
    return demands


def _multisine(multisine: Multisine, cycle: float) -> Array:
    """(N, 3) demands at each cycle of one period.

    Sines of equal power at the harmonics of the period, with the phases that keep the peak low: −πk(k − 1)/N for the
    k-th of N (M. Schroeder, "Synthesis of low-peak-factor signals", IEEE Trans. Information Theory, 1970). On all axes
    each has every third of them, so that the demands are orthogonal (E. Morelli, "Multiple input design for real-time
    parameter estimation in the frequency domain", IFAC Symposium on System Identification, 2003).
    """
    first = max(1, round(multisine.lowest * multisine.period))
    last = round(multisine.highest * multisine.period)
    is_all = multisine.axis == "all"
    # A line for each axis, at least.
    most = max(last, first + 2 * is_all)
    lines = range(first, most + 1)
    samples = round(multisine.period / cycle)
    demands = np.zeros((samples, 3))
    for number, name in enumerate(AXES):
        if multisine.axis in (name, "all"):
            harmonics = lines[number::3] if is_all else lines
            count = len(harmonics)
            spectrum = np.zeros(samples, dtype=np.complex128)
            # −πk(k + 1)/N in whole numbers until the last: whole turns more would cost digits.
            phases = [-pi * (k * (k + 1) % (2 * count)) / count for k in range(count)]
            # Lines above half the sampling rate are folded, as samples of their sines would be.
            folded = np.array(harmonics) % samples
            lines_there = [complex(cos(phase), sin(phase)) for phase in phases]
            np.add.at(spectrum, folded, lines_there)
            amplitude = radians(multisine.sd) * sqrt(2 / count) * samples
            demands[:, number] = amplitude * ifft(spectrum).real
    return demands


def _smooth(share: float) -> Pair:
    """How far a motion of least jerk is after a share of its time, and its rate (T. Flash and N. Hogan, 1985)."""
    way = share**3 * (10 - 15 * share + 6 * share**2)
    slope = 30 * share**2 * (1 - share) ** 2
    return way, slope
