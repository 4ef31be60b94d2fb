"""The logs in the repository that README and tutorial open: all that mavdem judges is known of them."""

from pytest import mark
from recorded_flights import LOGS

import mavdem

pytestmark = mark.slow


def test_of_the_px4_sample_all_lights_are_known_and_one_is_bad():
    """The ArduPilot sample is held by the screens of README and tutorial, which are printed anew and compared."""
    log = LOGS / "first_flight_px4.tlog"
    assessment = mavdem.review(log)
    assert assessment.simulated
    lights = assessment.judgement.lights
    levels = {name: str(light.level) for name, light in lights.items()}
    assert len(levels) == 8
    assert levels.pop("motors") == "bad"
    assert set(levels.values()) == {"good"}


def test_samples_are_small_enough_to_clone():
    assert max(path.stat().st_size for path in LOGS.iterdir()) < 2_000_000
