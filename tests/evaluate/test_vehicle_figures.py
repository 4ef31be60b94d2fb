"""All axes of a log in one call, against the calls for each; and the tables made of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mavdem
from mavdem.analysis.figures import VehicleFigures
from mavdem.dem import physical
from mavdem.report.blocks import Table
from mavdem.report.screen import vehicle_blocks

LOGS = Path(__file__).parents[2] / "logs"
FLIGHT, SLOW = LOGS / "px4_wind5_steps.tlog", LOGS / "ardupilot_default_rates.tlog"


@pytest.fixture(scope="module")
def found() -> VehicleFigures:
    return mavdem.vehicle(FLIGHT)


@pytest.mark.slow
def test_each_axis_is_as_by_itself_and_the_motors_are_those_of_hover(found):
    assert list(found.axes) == ["roll", "pitch", "yaw"]
    alone = physical(mavdem.read_segments(FLIGHT, axis="yaw"))
    np.testing.assert_allclose(found.axes["yaw"].physical.effect, alone.effect)
    assert found.axes["yaw"].physical.status == alone.status
    assert found.hover == mavdem.hover(FLIGHT)


def test_a_log_too_slow_for_parameters_has_hover_figures_and_the_reason():
    slow = mavdem.vehicle(SLOW, axis="pitch")
    assert list(slow.axes) == ["pitch"]
    assert slow.axes["pitch"].physical is None
    assert "4.0 Hz" in slow.axes["pitch"].reason
    assert slow.hover is not None
    assert slow.as_dict()["axes"]["pitch"]["physical"] is None


def test_an_unknown_axis_is_refused():
    with pytest.raises(ValueError, match="axis must be one of roll, pitch, yaw, all, not 'heave'"):
        mavdem.vehicle(FLIGHT, axis="heave")


def tables(found: VehicleFigures) -> list[Table]:
    return [block for block in vehicle_blocks(found) if isinstance(block, Table)]


@pytest.mark.slow
def test_the_report_has_a_row_an_axis_and_a_row_a_motor(found):
    axes, motors = tables(found)
    assert [row[0] for row in axes.rows] == ["roll", "pitch", "yaw"]
    assert len(motors.rows) == len(found.hover.motors)


def test_without_axes_only_the_motors_have_a_table():
    found = mavdem.vehicle(SLOW, axis="pitch")
    (motors,) = tables(found._replace(axes={}))
    assert len(motors.rows) == len(found.hover.motors)
