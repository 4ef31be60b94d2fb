"""What counts as settled flight while it is flown, and what is taken back when it turns out to have been a landing."""

from dataclasses import replace
from math import inf

import numpy as np
from hover import Hover
from live_hover import Flight, replay
from pytest import approx, mark, param

from mavdem.dataset.phases import TRANSIENT_SECONDS
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts.session import SessionFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import ARMED, IN_AIR, LANDING, ON_GROUND, TAKING_OFF
from mavdem.live.flight_phase import FlightPhase
from mavdem.live.landed_states import MAX_PHASES, LandedStates
from mavdem.live.messages import MESSAGE_FIELDS
from mavdem.live.recent_messages import RecentMessages
from mavdem.live.wind import WindEstimate

pytestmark = mark.usefixtures("without_wind_fits")

VEHICLE = Telemetry(1, 1, "QUADROTOR", "ARDUPILOTMEGA", {}, {})
IN_FLIGHT = 0.58
ON_THE_GROUND = 0.22


class Vehicle:
    """Sends the collective at 100 Hz and HEARTBEATs at 1 Hz; it took off at 0 s."""

    def __init__(self, height_message="LOCAL_POSITION_NED"):
        self.height_message = height_message
        self.recent = RecentMessages()
        self.phase = FlightPhase(self.recent)
        self.time = -3.0
        self.collective = []
        self.fly(3.0, collective=0.0)

    def fly(self, seconds, collective=IN_FLIGHT, climb=None, landed=None, armed=True, height=None):
        """Flies on for some seconds, reviews the phase, and returns whether flight is settled.

        A long flight is reviewed twice a second, as in a session, and a short one ten times, so that the time of a
        change is known. The collective is the mean motor output; climb, m/s, landed (MAV_LANDED_STATE) and height, m,
        are sent unless None.
        """
        steps_between_reviews = 10 if seconds < 10.0 else 50
        for _ in range(round(100 * seconds)):
            if round(100 * self.time) % 100 == 0:
                self.recent.add("HEARTBEAT", self.time, (2, 3, ARMED * armed, 0, 4))
                if landed is not None:
                    self.recent.add("EXTENDED_SYS_STATE", self.time, (landed,))
            self.collective.append((self.time, collective))
            if round(100 * self.time) % 10 == 0:
                if height is not None:
                    if self.height_message == "LOCAL_POSITION_NED":
                        fields = {"z": -height}
                    else:
                        fields = {"relative_alt": round(1e3 * height)}
                    values = [fields.get(name, 0.0) for name in MESSAGE_FIELDS[self.height_message]]
                    self.recent.add(self.height_message, self.time, values)
                if climb is not None:
                    self.recent.add("VFR_HUD", self.time, (climb,))
            if round(100 * self.time) % steps_between_reviews == 0:
                time, values = np.array(self.collective[-450:]).T
                shown = TimeSeries(time, np.zeros(len(time), int), values)
                self.phase.review(self.time, VEHICLE, shown)
            self.time += 0.01
        return self.phase.is_settled(self.time)


@mark.slow
def test_what_shows_nothing_is_not_called_the_ground():
    assert FlightPhase(RecentMessages()).not_flying_reason.code is SessionFact.FLIGHT_UNKNOWN
    vehicle = Vehicle()
    vehicle.fly(3.0, collective=ON_THE_GROUND, landed=ON_GROUND)
    assert vehicle.phase.not_flying_reason.code is SessionFact.NOT_FLYING


def test_a_take_off_is_seen_once_the_motors_are_known():
    """The autopilot reports the take-off before any motor output is known, so that its time is only known later.

    A vehicle in flight from the start has none.
    """
    # The first review of the flight has the autopilot's report alone.
    recent = RecentMessages()
    recent.add("HEARTBEAT", 1.0, (2, 3, ARMED, 0, 4))
    recent.add("EXTENDED_SYS_STATE", 3.0, (TAKING_OFF,))
    phase = FlightPhase(recent)
    phase.review(3.1, VEHICLE, None)
    assert phase.is_flying and phase.takeoff_time == -inf
    time = np.arange(1.0, 4.0, 0.01)
    collective = np.where(time < 3.0, 0.0, IN_FLIGHT)
    phase.review(4.0, VEHICLE, TimeSeries(time, np.zeros(len(time), int), collective))
    assert phase.takeoff_time == approx(3.0, abs=1.0)
    # In flight from the first message on.
    flown = FlightPhase(recent)
    for now in (3.1, 4.0):
        series = TimeSeries(time, np.zeros(len(time), int), np.full(len(time), IN_FLIGHT))
        flown.review(now, VEHICLE, series)
    assert flown.is_flying and flown.takeoff_time == -inf


@mark.slow
@mark.parametrize("has_landed", [False, True])
def test_a_flight_goes_on_after_a_silence_of_the_link(has_landed):
    """The first messages after a minute do not show yet whether the vehicle flies, and no other take-off follows."""
    vehicle = Vehicle()
    vehicle.fly(2.0)
    takeoff_time = vehicle.phase.takeoff_time
    vehicle.time += 60.0
    vehicle.collective.clear()
    vehicle.phase.review(vehicle.time, VEHICLE, None)
    assert vehicle.phase.is_flying
    vehicle.fly(0.3, collective=0.0 if has_landed else IN_FLIGHT)
    assert vehicle.phase.is_flying is not has_landed
    assert vehicle.phase.takeoff_time == takeoff_time


def test_an_arming_on_the_ground_is_for_the_next_flight():
    """A vehicle stays armed for a moment after its landing; once it was disarmed, it is armed to take off again."""
    vehicle = Vehicle()
    assert not vehicle.phase.is_armed_since_landing, "it has not flown yet"
    vehicle.fly(3.0)
    vehicle.fly(2.0, collective=0.0)
    assert vehicle.phase.landing_time is not None and vehicle.phase.is_armed_since_landing
    vehicle.fly(1.5, collective=0.0, armed=False)
    vehicle.fly(1.5, collective=0.0)
    assert not vehicle.phase.is_armed_since_landing
    # A landing that is a disarming leaves nothing armed either.
    vehicle.fly(3.0)
    vehicle.fly(2.0, collective=0.0, armed=False)
    assert vehicle.phase.landing_time is not None and not vehicle.phase.is_armed_since_landing


class Tumble(Hover):
    """A hover that tumbles from 18 s to 20 s, upright for moments, and hovers again."""

    def roll(self, t):
        is_tumbling = abs(np.asarray(t) - 19.0) < 1.0
        return np.where(is_tumbling, 1.5 * np.sin(12.0 * t), super().roll(t))


@mark.slow
def test_the_moments_in_which_a_tumbling_vehicle_is_upright_are_not_settled():
    made = replay(Flight(Tumble(hovering=13.0), attitude=50.0, motors=50.0).frames(end=23.0))
    settled_times = np.array([row.time for row in made.rows if row.is_settled])
    assert not any((settled_times > 18.3) & (settled_times < 20.5))
    assert any(settled_times < 18.0) and any(settled_times > 21.1)


@mark.slow
def test_a_long_climb_is_free_flight_before_it_is_settled():
    """A climb at 1 m/s is free flight after some seconds; near the ground a slow descent is not."""
    vehicle = Vehicle()
    assert not vehicle.fly(2.0, climb=1.0) and not vehicle.phase.is_free(vehicle.time)
    vehicle.fly(2.5, climb=1.0)
    assert vehicle.phase.is_free(vehicle.time) and not vehicle.phase.is_settled(vehicle.time)
    vehicle.fly(2.5, climb=-1.0)
    assert not vehicle.phase.is_free(vehicle.time)
    hovering_vehicle = Vehicle()
    hovering_vehicle.fly(4.0, climb=0.0)
    assert not hovering_vehicle.phase.is_free(hovering_vehicle.time)
    landing_vehicle = Vehicle()
    landing_vehicle.fly(5.0, climb=1.0, landed=IN_AIR)
    landing_vehicle.fly(20.0, climb=0.05, landed=IN_AIR)
    landing_vehicle.fly(1.5, climb=0.05, landed=LANDING)
    assert (
        not landing_vehicle.phase.is_free(landing_vehicle.time)
        and not landing_vehicle.phase.may_fly_freely
    )


@mark.slow
def test_a_descent_is_not_settled_unless_reported_as_flight():
    for landed in (None, IN_AIR):
        vehicle = Vehicle()
        assert vehicle.fly(25.0, climb=0.0, landed=landed)
        if landed:
            assert vehicle.fly(5.0, climb=-0.6, landed=landed)
        else:
            assert not vehicle.fly(5.0, climb=-0.6, landed=landed)


@mark.slow
@mark.parametrize(
    "height_message", ["LOCAL_POSITION_NED", param("GLOBAL_POSITION_INT", marks=mark.in_full)]
)
def test_a_detector_that_reports_the_ground_in_flight_is_wrong(height_message):
    vehicle = Vehicle(height_message)
    vehicle.fly(3.0, collective=0.0, landed=ON_GROUND, height=0.0)
    assert vehicle.phase.is_landed_state_reported
    for height in range(12):
        vehicle.fly(1.0, landed=ON_GROUND, height=float(height))
    assert vehicle.phase.is_flying and not vehicle.phase.is_landed_state_reported
    # The report each second comes just before the next step of the height.
    assert vehicle.phase.contradicted_report.figures["largest_height"] == approx(10.0)
    # Later, the climb is no longer among the messages that are kept.
    vehicle.fly(25.0, landed=ON_GROUND, height=11.0)
    assert vehicle.phase.is_flying
    vehicle.fly(3.0, collective=0.0, landed=ON_GROUND, height=0.0)
    assert not vehicle.phase.is_flying


@mark.slow
def test_a_landing_is_dated_by_the_last_report_in_flight():
    """Samples since the landing are withdrawn: they were taken for settled flight before the landing was reported."""
    vehicle = Vehicle()
    assert vehicle.fly(20.0)
    vehicle.fly(2.0, armed=False)
    assert vehicle.phase.pop_withdrawal_time() == approx(19.0 - TRANSIENT_SECONDS)
    assert vehicle.phase.landing_time == approx(19.0)
    vehicle = Vehicle()
    vehicle.fly(20.0, landed=IN_AIR)
    first = vehicle.time
    vehicle.fly(2.0, landed=ON_GROUND)
    vehicle.fly(20.0, landed=IN_AIR)
    vehicle.fly(2.0, landed=ON_GROUND)
    assert vehicle.phase.pop_withdrawal_time() == approx(first - 1.0 - TRANSIENT_SECONDS), (
        "the last report in the air, as offline"
    )


class ShortDescent(Hover):
    """A hover that lands four seconds after it began to sink."""

    @property
    def landed(self):
        return self.sinking + 4.0


@mark.in_full
def test_the_mean_of_the_wind_is_of_one_flight():
    """It stays after a landing, until the next take-off."""
    hover = ShortDescent(hovering=5.0)
    flight = Flight(hover, attitude=12.0, motors=12.0)
    next_flight = replace(flight, clock=60.0)
    made = replay(flight.frames(end=hover.end))
    made.stream.wind.mean = mean = WindEstimate(10.0, np.ones(2), np.ones(2))
    replay(next_flight.frames(end=6.0), made.stream)
    assert made.stream.status().mean_wind is mean
    replay(next_flight.frames(6.0, end=9.0), made.stream)
    assert made.stream.status().mean_wind is None and made.stream.boot == 0


def test_a_state_that_flaps_fills_no_memory():
    states = LandedStates()
    for number in range(2 * MAX_PHASES):
        states.begin_phase((ON_GROUND, IN_AIR)[number % 2], number + 1.0, number + 0.9)
    now = 2.0 * MAX_PHASES
    kept = states.series(now, 0, was_flying=False)
    assert len(kept.time) == 2 * MAX_PHASES + 1
    assert states.is_in_air and not states.is_first_phase and states.phase_start == now
