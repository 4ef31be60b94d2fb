"""The page of a flight of a fleet: small, with a link back, with and without a model, with and without matplotlib."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest
from simulated import simulated

import mavdem
from mavdem.analysis import LogAnalysis
from mavdem.analysis.figures import VehicleFigures
from mavdem.analysis.findings import findings
from mavdem.condition import Condition, Identity
from mavdem.condition.inventory import Tier
from mavdem.evaluate import held_out_test
from mavdem.page.flight_page import flight_page

FLIGHT = simulated(samples=900, wind=4.0, lag=0.05)
TRAIN, TEST = FLIGHT[:800], FLIGHT[800:]
MAX_BYTES = 300_000
VERDICT = SimpleNamespace(as_dict=dict)
CONDITION = Condition(90.0, 70.0, 60.0, None, (), {}, {}, None, None, None, None, None)
IDENTITY = Identity("1234", "board", 1, "PX4", "QUADROTOR", "PX4 v1.16.0", None)
FAST = Tier("a", "All at 100 Hz.", None, "", "")
SLOW = Tier("c", "Motors come at 4 Hz.", "b", "8 Hz", "Log them <faster>.")
KNOWN = (CONDITION, IDENTITY, VehicleFigures({}, None))


@pytest.fixture(scope="module")
def analysis() -> LogAnalysis:
    learned = mavdem.learn(TRAIN, mavdem.Settings(window=9, parameter_precision=1.0))
    held_out = held_out_test(TRAIN, TEST, learned)
    model = {"flights": (TRAIN,), "learned": learned, "held_out": held_out, "findings": findings(learned, held_out)}
    return LogAnalysis(VERDICT, FAST, *KNOWN, **model)


@pytest.mark.slow
def test_two_axes_fit_into_a_small_page_that_leads_back(analysis):
    text = flight_page("flight.tlog", {"roll": analysis, "pitch": analysis})
    assert len(text.encode()) < MAX_BYTES and text.count("<svg") == 2 * 3
    assert '<a href="../index.html">' in text and "Pictures of pitch" in text
    identifiers = [part.split('"')[0] for part in text.split(' id="')[1:]]
    assert len(identifiers) == len(set(identifiers))


def test_without_matplotlib_the_page_says_how_to_get_pictures(analysis, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    text = flight_page("flight.tlog", {"roll": analysis})
    assert "<svg" not in text and "pip install" in text and "mavdem[plot]" in text


def test_a_flight_without_a_model_says_why_and_what_to_do():
    reason = LogAnalysis(VERDICT, SLOW, *KNOWN, SLOW.reason, SLOW.remedy)
    text = flight_page("<b>.tlog", {"roll": reason})
    assert "Motors come at 4 Hz." in text and "Log them &lt;faster&gt;." in text and "<b>" not in text
