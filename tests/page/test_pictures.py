"""The chapter of pictures: what can be drawn is, what cannot says why, and without matplotlib one sentence says how."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from live_rows import flown
from matplotlib.figure import Figure
from mavdem.page.pictures import PicturePlan, picture_chapter

from mavdem.evaluate.live_history import LiveHistory
from mavdem.report.figures.series import live_flight


def refuse() -> Figure:
    raise ValueError("there is no wind")


def test_what_can_be_drawn_is_and_what_cannot_says_why():
    chapter = picture_chapter(lambda: [PicturePlan("One", "It is empty.", Figure), PicturePlan("Two", "", refuse)])
    (drawing,) = chapter.drawings
    assert (drawing.title, drawing.caption) == ("One", "It is empty.") and "<svg" in drawing.svg
    assert [(block.lead, block.text) for block in chapter.blocks] == [("Two:", "there is no wind.")]


def test_without_matplotlib_one_sentence_has_the_command_that_adds_pictures(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    chapter = picture_chapter(lambda: pytest.fail("nothing can be drawn"))
    assert not chapter.drawings
    assert "pip install 'mavdem[plot]'" in chapter.blocks[0].text


def test_a_live_flight_is_drawn_in_degrees_with_the_parts_learnt_from():
    history = LiveHistory(0.25)
    flown(history, 2.0)
    flown(history, 2.0, segment=1, start=105.0, learnt=False)
    above, below = live_flight(history, "roll").axes
    measured = next(line for line in above.lines if line.get_label() == "measured")
    assert np.nanmax(measured.get_ydata()) == pytest.approx(np.rad2deg(np.nanmax(history.lines.measured)))
    assert len(above.patches) == len(history.learnt) == 1
    assert "°/s²" in below.get_ylabel()
    with pytest.raises(ValueError, match="no attitude"):
        live_flight(LiveHistory(0.25), "roll")
