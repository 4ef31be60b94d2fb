"""What counts as settled flight while it is flown, and what is taken back when it turns out to have been a landing."""

import numpy as np
import pytest

from mavdem.alignment.phases import TRANSIENT_SECONDS
from mavdem.facts.session import Session
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND
from mavdem.live.decisions import Phase

pytestmark = pytest.mark.usefixtures("without_wind_fits")

IN_FLIGHT = 0.58
ON_THE_GROUND = 0.22


class Vehicle:
    """Sends the collective at 100 Hz and HEARTBEATs at 1 Hz; it took off at 0 s."""

    def __init__(self) -> None:
        self.phase = Phase()
        self.time = -3.0
        self.fly(3.0, collective=0.0)

    def fly(
        self,
        seconds,
        collective=IN_FLIGHT,
        climb=None,
        landed=None,
    ):
        for _ in range(round(100 * seconds)):
            if round(100 * self.time) % 100 == 0:
                self.phase.take("armed", self.time, True)
                if landed is not None:
                    self.phase.take("landed_state", self.time, landed)
            if climb is not None and round(100 * self.time) % 10 == 0:
                self.phase.take("VFR_HUD", self.time, climb)
            self.phase.take("collective", self.time, collective)
            if round(100 * self.time) % 10 == 0:
                self.phase.review(self.time)
            self.time += 0.01
        return self.phase.settled(self.time)


def test_what_shows_nothing_is_not_called_the_ground():
    assert Phase().obstacle.code is Session.FLIGHT_UNKNOWN
    vehicle = Vehicle()
    vehicle.fly(3.0, collective=ON_THE_GROUND, landed=ON_GROUND)
    assert vehicle.phase.obstacle.code is Session.NOT_FLYING


def test_a_descent_is_no_settled_flight_until_it_is_over():
    one = Vehicle()
    assert one.fly(25.0, climb=0.0)
    assert not one.fly(5.0, climb=-0.6)


def test_the_first_heartbeat_dates_what_is_taken_back_and_of_two_landings_the_earlier_counts():
    phase = Phase()
    for time in np.arange(0.0, 20.0, 0.01).tolist():
        phase.take("collective", time, IN_FLIGHT)
    phase.review(19.0)
    assert phase.settled(19.0)
    phase.take("armed", 20.0, False)
    assert phase.landing() == 20.0 - TRANSIENT_SECONDS
    one = Vehicle()
    one.fly(20.0, landed=IN_AIR)
    first = one.time
    one.fly(2.0, landed=ON_GROUND)
    one.fly(20.0, landed=IN_AIR)
    one.fly(2.0, landed=ON_GROUND)
    assert one.phase.landing() == pytest.approx(first - 1.0 - TRANSIENT_SECONDS), (
        "the last report in the air, as offline"
    )
