"""The logs in the repository that README and tutorial open: all that mavdem judges is known of them."""

from pytest import mark
from recorded_flights import LOGS

from mavdem.assessment.assess import assess
from mavdem.assessment.axis import Options
from mavdem.ingest import read_log
from mavdem.report.pages.flight_page import review_page

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


LENGTH = """(() => {
const root = document.documentElement;
return [document.body.innerText.split(/\\s+/).length, root.scrollHeight];
})()"""
"""What a page shows without a click: its number of words, and its height, px."""


@mark.in_full
@mark.parametrize("name", ["first_flight_ardupilot.tlog", "first_flight_px4.tlog"])
def test_the_page_of_a_sample_has_at_most_700_words_and_4000_px_on_a_desktop(
    name, tmp_path, browser
):
    page = review_page(assess(read_log(LOGS / name)))
    _, (word_count, height) = browser.shown(page, LENGTH, tmp_path, 1280)
    assert word_count <= 700 and height <= 4000


def test_samples_are_small_enough_to_clone():
    assert max(path.stat().st_size for path in LOGS.iterdir()) < 2_000_000
