"""What notebooks show of a flight and of a learnt model."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import mavdem
from mavdem.report.blocks import Sentence, Table
from mavdem.report.page import notebook_html

LOG = Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog"


@pytest.fixture(scope="module")
def flight():
    return mavdem.read_flight(LOG)[:800]


def test_a_flight_has_a_row_a_channel_in_degrees(flight):
    page = ElementTree.fromstring(flight._repr_html_())
    rows = [[cell.text for cell in row] for row in page.iter("tr")]
    assert [row[0] for row in rows[1:]] == [f"{name}, µs" for name in flight.input_names] + [
        "roll, °",
        "roll rate, °/s",
    ]
    assert float(rows[5][2]) == pytest.approx(np.degrees(flight.outputs[:, 0].mean()), abs=0.05)
    assert LOG.name in "".join(page.itertext()) and "8 s" in "".join(page.itertext())


def test_what_is_unknown_is_a_dash():
    time = np.arange(5.0)
    flight = mavdem.Flight(time, time, time, setpoints=np.full(5, np.nan), setpoint_names=("asked",))
    assert re.search(r">asked</td>.*>-</td>", flight._repr_html_())


def test_a_model_shows_what_it_is_good_for(flight):
    learned = mavdem.learn(flight, mavdem.Settings(order=2, d=2, window=9, parameter_precision=1.0, horizon=None))
    text = "".join(ElementTree.fromstring(learned._repr_html_()).itertext())
    assert "motor effectiveness" in text and "2 states, from 8 s at 100 Hz" in text


def test_every_text_is_escaped():
    evil = "<script>alert(1)</script>&"
    shown = notebook_html([Sentence(evil, evil), Table([evil], [[evil]])])
    assert "<script" not in shown and shown.count("&lt;script&gt;") == 4
    time = np.arange(5.0)
    flight = mavdem.Flight(time, time, time, input_names=(evil,), provenance={"source": f"/tmp/{evil}"})
    assert "<script" not in flight._repr_html_()
