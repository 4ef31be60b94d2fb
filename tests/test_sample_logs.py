"""The logs in the repository that README and tutorial open: all that mavdem judges is known of them."""

from pytest import mark
from recorded_flights import LOGS

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.ingest import read_log

pytestmark = mark.slow


def test_of_the_px4_sample_all_lights_are_known_and_one_is_bad():
    """The ArduPilot sample is held by the screens of README and tutorial, which are printed anew and compared."""
    log = read_log(LOGS / "first_flight_px4.tlog")
    # No light needs the model.
    assessment = assess(log, options=Options(with_model=False))
    assert assessment.simulated
    lights = assessment.judgement.lights
    levels = {name: str(light.level) for name, light in lights.items()}
    assert len(levels) == 8
    assert levels.pop("motors") == "bad"
    assert set(levels.values()) == {"good"}


def test_samples_are_small_enough_to_clone():
    assert max(path.stat().st_size for path in LOGS.iterdir()) < 2_000_000
