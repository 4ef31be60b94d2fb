"""Figures outside their physical range are never printed: all facts of logs within reach are checked."""

import math
import os

import numpy as np
from hover import changed, columns, log_of
from instrumented import EVENT, estimating, instrumented, knocked, moving, rolled
from physical_ranges import figures_out_of_range
from pytest import mark
from recorded_flights import LOGS, SHARED
from scipy.constants import g as GRAVITY  # noqa: N812

from mavdem.assessment.assess import assess
from mavdem.errors import NotLearnable, Unreadable
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent
from mavdem.ingest import read_log


def all_facts(assessment):
    """Returns every fact that screen, page and documents show of a log."""
    facts = [assessment.headline, assessment.next_step, *assessment.lights.values()]
    facts += assessment.events
    facts += [instance.state for instance in assessment.instances]
    facts += [check for trust in assessment.trust for check in trust.checks]
    facts += assessment.tracking.values()
    facts += [fact for margins in assessment.margins for fact in margins.facts]
    return facts


def impossible_figures(assessment):
    return [text for fact in all_facts(assessment) for text in figures_out_of_range(fact)]


def test_a_figure_outside_its_range_is_found_in_a_fact_within_a_fact():
    fell = Fact(MotionEvent.FELL, time=1.0, speed=86.0, boot=0, witnesses=())
    outer = Fact(MotionEvent.HIT, time=math.nan, height=2.0, boot=0, witnesses=(fell,))
    assert figures_out_of_range(outer) == ["hit.witnesses.fell.speed = 86.0", "hit.time = nan"]


def run_away_after_a_crash():
    """Returns telemetry of a fall from 10 m.

    After the impact the estimate falls on at 500 m/s, and the attitude is wild.
    """
    telemetry = moving(instrumented(), lambda since: -GRAVITY * since)
    telemetry = knocked(rolled(telemetry, 110.0, EVENT + 0.3, 1.0), EVENT + 1.43, 150.0)
    position = telemetry.messages["LOCAL_POSITION_NED"]
    is_after = position["time"] > EVENT + 1.5
    return changed(telemetry, "LOCAL_POSITION_NED", vz=np.where(is_after, 500.0, position["vz"]))


def height_that_runs_away():
    """In a hover the estimate falls at 300 m/s while the barometer rises."""
    telemetry = instrumented("Alt hold")
    telemetry = moving(telemetry, lambda since: 2.0 * (since < 8.0))
    return estimating(telemetry, lambda since: -300.0 * (since < 8.0))


def damaged_battery():
    """One message in ten has a voltage or a current of ten times the true one."""
    telemetry = instrumented()
    time = np.arange(0.0, 70.0, 0.5)
    factor = np.where(np.arange(len(time)) % 10 == 3, 10.0, 1.0)
    battery = columns(
        time,
        voltage_battery=16000.0 * factor,
        current_battery=1500.0 * factor,
        battery_remaining=250,
    )
    return changed(telemetry, "SYS_STATUS", **battery)


@mark.slow
@mark.parametrize("made", [run_away_after_a_crash, height_that_runs_away, damaged_battery])
def test_sensors_that_run_away_are_not_printed(made):
    assert impossible_figures(assess(log_of(made()))) == []


REACHED = [*sorted(LOGS.glob("*.*log"))]
if "MAVDEM_SHARED_DATA" in os.environ or SHARED.exists():
    REACHED += [
        path
        for folder in ("reports", "real/logs", "logs")
        for path in sorted((SHARED / folder).glob("*"))
        if path.is_file()
    ]


def pytest_generate_tests(metafunc):
    """Every 24th log, and with ``--in-full`` all of them: an assessment takes seconds."""
    if "path" in metafunc.fixturenames:
        logs = REACHED if metafunc.config.getoption("--in-full") else REACHED[::24]
        metafunc.parametrize("path", logs, ids=lambda path: path.name)


@mark.slow
def test_no_log_has_a_figure_outside_its_range(path):
    try:
        assessment = assess(read_log(path))
    except (Unreadable, NotLearnable):
        return
    assert impossible_figures(assessment) == []
