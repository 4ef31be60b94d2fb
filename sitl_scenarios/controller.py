"""Controller: position, velocity, attitude and rate control in cascade, as ArduPilot and PX4 have it.

Each loop is a first-order lag of known bandwidth: the rate loop as fast as rotors, delay and cycle allow, every outer
one slower than the one within. So the gains follow from the vehicle's mass, inertia, rotors and sensors, and no vehicle
has gains of its own.
"""

from math import atan, cos, exp, fsum, hypot, radians, remainder, sin, tau
from operator import add
from typing import NamedTuple

from sitl_scenarios.dynamics import Four, State, Three, euler, frame, mix, pulse
from sitl_scenarios.plan import Reference
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.vehicles import GRAVITY, airframe

# rad/s: bandwidth of the rate loop that is not exceeded, for the noise that it would put on the motors
MAX_BANDWIDTH = 25.0
LEAD = 4.0
"""The rotors' lag is made so many times shorter by a lead in the rate loop, and the noise above it as much larger."""
# Most that is asked for: rad, rad/s and m/s
MAX_TILT = radians(35)
MAX_RATE = radians(220)
MAX_SPEED = 4.0


class ControlOutput(NamedTuple):
    """By the autopilot in one cycle."""

    outputs: Four  # motor commands, 1000 to 2000 µs
    demands: Four  # of the mixer: roll, pitch, yaw (−1 to 1) and thrust (0 to 1)
    attitude: Three = (0.0, 0.0, 0.0)  # setpoints of roll, pitch and yaw, rad
    rates: Three = (0.0, 0.0, 0.0)  # setpoints of the body rates, rad/s


class LoopGains(NamedTuple):
    """Of the loops about one axis; the rate loop's output is the mixer's demand, −1 to 1."""

    p: float  # per rad/s
    i: float  # per rad
    d: float  # per rad/s², of the measured rate only
    # of the derivative's first-order filter, s, as dt / (dt + lag) in each cycle
    derivative_lag: float
    angle: float  # rad/s per rad


class FlightController:
    """That of one vehicle in flight, in a ``cycle`` of s.

    ``stiff``: rates that are asked for per error of roll, pitch and yaw, 1/s.
    """

    def __init__(self, scenario: Scenario) -> None:
        vehicle = scenario.vehicle
        self.cycle = cycle = scenario.cycle
        self._body = body = airframe(vehicle)
        self._frame = places = frame(vehicle.layout, body.arm)
        self._gain = vehicle.rate_gain
        lag = sum(body.lag) / 2
        # A loop with an integrator and a dead time T in all is well damped up to about 0.4/T; a cycle's hold and its
        # computing take about one cycle.
        dead_time = lag / LEAD + scenario.sensors.delay + cycle
        self._rate = min(0.4 / dead_time, MAX_BANDWIDTH)
        self._attitude = self._rate / 3
        self._forgets = 1.0 - exp(-cycle * LEAD / lag) if lag else 1.0
        # Moments of a demand of 1 about the three axes, N m, by the slope of the rotors' curves in hover.
        hover_command = body.command_for(body.hover_speed)
        per_command = body.speed_slope(hover_command) * body.full
        thrust_slope = 2 * body.thrust[0] * body.hover_speed + body.thrust[1]
        thrust = thrust_slope * per_command
        torque_slope = 2 * body.torque[0] * body.hover_speed + body.torque[1]
        torque = torque_slope * per_command
        of_roll = -fsum(a * b for a, b in zip(places.roll, places.right, strict=True))
        of_pitch = fsum(a * b for a, b in zip(places.pitch, places.forward, strict=True))
        ix, iy, iz = body.inertia
        # Yaw has the rotors' torque only: a quarter of the bandwidth.
        per_roll = ix / (thrust * of_roll)
        per_pitch = iy / (thrust * of_pitch)
        per_yaw = iz / (torque * 4) / 4
        self._per_unit = per_roll, per_pitch, per_yaw
        self._within((self._attitude, self._attitude, self._attitude / 4))
        self.rest()

    def _within(self, stiff: Three) -> None:
        """Closes the loops of velocity and position about attitude loops of these gains, 1/s."""
        self.stiff = stiff
        self._velocity = min(stiff[0], stiff[1], self._attitude) / 3.5
        self._position = self._velocity / 2.5
        self._smooths = 1.0 - exp(-self.cycle * LEAD * self._velocity)

    @property
    def gains(self) -> tuple[LoopGains, ...]:
        """About roll, pitch and yaw."""
        # The lead is P and D: P(1 + (LEAD − 1)τs/(1 + τs)); τ as the cycle's exp(−cycle/τ) has it.
        lag = self.cycle * (1.0 - self._forgets) / self._forgets
        return tuple(
            LoopGains(p, p * self._rate / 12, p * (LEAD - 1.0) * lag, lag, angle)
            for p, angle in zip(
                (self._gain * self._rate * share for share in self._per_unit),
                self.stiff,
                strict=True,
            )
        )

    def rest(self) -> None:
        """Resets the integrators and filters, as on the ground."""
        self._push, self._smooth, self._trim, self._slow = ([0.0, 0.0, 0.0] for _ in range(4))
        self._heading = 0.0

    def control(self, estimate: State, reference: Reference, flying: bool) -> ControlOutput:
        """Returns what one cycle asks for; nothing is learned unless ``flying``."""
        vn, ve, vd = estimate.velocity
        pn, pe, pd = estimate.position
        along = self._position
        fast = self._velocity
        ahead, aside = reference.velocity
        wn = along * (reference.north - pn) + ahead
        we = along * (reference.aside - pe) + aside
        fastest = MAX_SPEED + hypot(ahead, aside)
        limit = fastest / max(fastest, hypot(wn, we))
        sinking = _limited(along * (-reference.height - pd), MAX_SPEED)
        wd = -reference.climb + sinking
        error = (wn * limit - vn, we * limit - ve, wd - vd)
        push = self._push
        smooth = self._smooth
        # A fifth of the loop's bandwidth for the integral: wind is found in about two seconds.
        gain = fast * fast / 5 * self.cycle
        for i in range(3):
            if flying:  # m/s², at most about what ``MAX_TILT`` gives: a storm must not wind it up
                push[i] = _limited(push[i] + gain * error[i], 7.0)
            # Noise of position and velocity would reach the motors multiplied by every bandwidth within.
            smooth[i] += self._smooths * (fast * error[i] - smooth[i])
        an, ae, ad = map(add, smooth, push)

        roll, pitch, yaw = euler(estimate.attitude)
        forward = an * cos(yaw) + ae * sin(yaw)
        right = ae * cos(yaw) - an * sin(yaw)
        lift = max(GRAVITY - ad, 0.2 * GRAVITY)
        more_roll, more_pitch, yaw_rate = reference.demand
        level_pitch = atan(-forward / lift)
        wanted_pitch = _limited(level_pitch, MAX_TILT)
        level_roll = atan(right / lift * cos(wanted_pitch))
        wanted_roll = _limited(level_roll, MAX_TILT) + more_roll
        wanted_pitch += more_pitch
        # The heading is held, and turned at the yaw rate that is asked for, as both autopilots do.
        if flying:
            turned = self._heading + yaw_rate * self.cycle
            self._heading = remainder(turned, tau)
        upright = max(cos(roll) * cos(pitch), 0.5)
        thrust = self._body.mass * lift / upright

        wanted = wanted_roll, wanted_pitch, self._heading
        return self.steer(estimate, wanted, (0.0, 0.0, yaw_rate), thrust, flying)

    def steer(
        self, estimate: State, wanted: Three, ahead: Three, thrust: float, flying: bool
    ) -> ControlOutput:
        """Returns what one cycle asks for roll, pitch and yaw, rad, at a ``thrust``, N, with rates ``ahead``, rad/s."""
        roll, pitch, yaw = euler(estimate.attitude)
        yaw_error = remainder(wanted[2] - yaw, tau)
        errors = wanted[0] - roll, wanted[1] - pitch, yaw_error
        rates = tuple(
            _limited(stiff * error + feed, MAX_RATE)
            for stiff, error, feed in zip(self.stiff, errors, ahead, strict=True)
        )
        # The thrust curve undone, as both autopilots do.
        speed = self._body.speed_for(thrust / 4)
        command = self._body.command_for(speed) / self._body.full
        turning = (
            _limited(self.demand(axis, asked, rate, flying), 1.0)
            for axis, (asked, rate) in enumerate(zip(rates, estimate.rates, strict=True))
        )
        collective = min(max(command, 0.0), 1.0)
        demands = (*turning, collective)
        outputs = tuple(map(pulse, self.mixed(demands)))
        return ControlOutput(outputs, demands, wanted, rates)

    def mixed(self, demands: Four) -> Four:
        """Returns normalised commands of the motors."""
        return mix(self._frame, demands)

    def demand(self, axis: int, wanted: float, rate: float, flying: bool) -> float:
        """Returns what the rate loop asks the mixer for about an axis, for a rate ``wanted``, rad/s; once a cycle."""
        # The lead (1 + τs)/(1 + τs/LEAD), as LEAD times the rate less its slow part.
        self._slow[axis] += self._forgets * (rate - self._slow[axis])
        slow = (LEAD - 1.0) * self._slow[axis]
        led = LEAD * rate - slow
        if flying:
            self._trim[axis] += self._rate / 12 * self.cycle * (wanted - rate)
        error = wanted - led + self._trim[axis]
        return self._gain * self._rate * error * self._per_unit[axis]


def _limited(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
