"""The page of a live flight: what was predicted, learnt from and said, or that there was nothing."""

from __future__ import annotations

import numpy as np
from mavdem.page.live_page import live_page
from mavdem.page.session_history import SessionHistory

from mavdem.evaluate.live_history import HorizonErrors, LiveHistory
from mavdem.live import SessionStatus
from mavdem.live.status import ACCOUNT

NOTHING = dict.fromkeys(ACCOUNT, 0.0)


class Flown(LiveHistory):
    """Errors and parts as given."""

    learnt = [(8.0, 61.0)]

    def errors(self):
        square = np.deg2rad([0.5, 20.0]) ** 2
        return [HorizonErrors(seconds, 900, square, 4 * square, np.array([0.9, 0.8])) for seconds in (0.05, 0.25)]


def test_a_flight_has_its_errors_in_degrees_its_parts_and_its_events():
    history = Flown(0.25)
    history.note(12.25, "Messages come again after 3 s.")
    page = live_page(
        "udpin:<b>", "roll", history, SessionStatus("1:1"), NOTHING | {"learned": 53.0, "silent": 3.0}, None
    )
    assert "Roll was predicted 0.25 s ahead with an RMSE of 0.5° (baseline 1°)" in page
    for told in (
        ">0.05 s ahead</td>",
        ">61 s</td>",
        ">12.2 s</td>",
        "come again after 3 s",
        "udpin:&lt;b&gt;",
    ):
        assert told in page


def test_a_link_without_a_vehicle_has_a_page_too():
    page = live_page(
        "udpin:0", "roll", LiveHistory(0.25), SessionStatus(obstacle="No vehicle found yet."), NOTHING, None
    )
    assert "Nothing of roll was predicted" in page and "No vehicle found yet." in page and "Nothing happened." in page


def test_the_session_shows_and_says_as_without_it():
    shown, said = [], []

    class Shown:
        def put(self, *row):
            shown.append(row)

        def log(self, text):
            said.append(("shown", text))

    history = SessionHistory(lambda setup: Shown(), said.append)
    history.say("It began.")
    display = history.open(None)
    row = (1.0, 0, np.zeros(2), np.zeros(4), None, None)
    display.put(*row)
    display.log("It flies.")
    assert shown == [row] and said == ["It began.", ("shown", "It flies.")]
    assert [event.sentence for event in history.of.events] == ["It began."]
    assert np.isfinite(history.of.lines.measured).sum() == 1
