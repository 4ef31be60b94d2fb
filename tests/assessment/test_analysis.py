"""The analysis of a log at each tier: what is learnt, what is withheld, and why."""

from dataclasses import replace

import numpy as np
from made_up_analysis import held_out
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import fixture, mark, raises
from recorded_flights import FLIGHT, short_flight

import mavdem
from mavdem.assessment.assess import assess
from mavdem.assessment.axis.figures import model_figures
from mavdem.assessment.axis.training import MAX_SLOW_ERROR_RATIO, slow_motion_refusal
from mavdem.dem import parallel
from mavdem.facts.assessment import Caveat, NoModel
from mavdem.facts.model import NoPhysical
from mavdem.ingest import read_log
from mavdem.ingest.telemetry import selected_rows
from mavdem.loops.advice import advised_parameters
from mavdem.plant import physical
from mavdem.report.blocks import plain_text
from mavdem.report.screen import analysis_blocks


@fixture(scope="module")
def slow():
    """A flight at 100 Hz as a link of 10 Hz would send it."""
    log = read_log(FLIGHT)
    (vehicle,) = log.vehicles
    streams = ("ATTITUDE", "SERVO_OUTPUT_RAW")
    messages = {
        name: selected_rows(columns, slice(None, None, 10)) if name in streams else columns
        for name, columns in vehicle.messages.items()
    }
    return assess(replace(log, vehicles=(replace(vehicle, messages=messages),)), axis="roll")


@mark.slow
def test_a_model_of_slow_motion_is_learned_if_it_predicts_better(slow):
    """With slow messages (tier b) a model of the slow motion alone is learned.

    It has neither physical quantities nor wind, states why, and refuses to be simulated.
    """
    printed_report = plain_text(analysis_blocks(slow))
    slow = slow.analysis
    assert slow.tier.tier == "b" and slow.learned is not None and slow.held_out is not None
    assert slow.held_out.error_ratio() < MAX_SLOW_ERROR_RATIO and slow.held_out.coverage > 0.75
    assert (slow.learned.physical, slow.learned.wind) == (None, None)
    assert slow.learned.physical_reason.code is NoPhysical.SAMPLED_TOO_SLOWLY
    assert slow.learned.cautions[0].code is Caveat.SLOW_MOTION_ONLY
    assert slow.alarms == () and "Hz" in str(slow.reason) and slow.reason.remedy
    assert (
        "Lean:" in printed_report
        and "Mean lean" not in printed_report
        and printed_report.count("± is") == 1
    )
    with raises(ValueError, match="40 Hz"):
        slow.learned.simulate(slow.flights[0].inputs)
    report = model_figures(slow.flights, slow.learned, slow.held_out)
    ratios = [error["relative"] for error in report["forecast_mspe"].values()]
    assert ratios == sorted(ratios) and len(ratios) == 3


@mark.parametrize(
    "ratio, windows, spread, kept",
    [
        (0.5, 20, 0.1, True),
        (0.95, 40, 0.01, False),
        (0.8, 5, 0.1, False),
        (0.85, 20, 3.0, False),
        (1.1, 40, 0.1, False),
    ],
)
def test_a_model_must_beat_the_baselines_by_a_margin_that_is_not_luck(ratio, windows, spread, kept):
    """A model of the slow motion is kept if its error is clearly below the baselines', in enough held-out windows."""
    errors = np.sqrt(ratio * np.exp(spread * default_rng(1).standard_normal(windows)))
    held_out_windows = held_out(last=1.2, count=windows)
    forecast = np.broadcast_to(errors[:, None, None], held_out_windows.measured.shape)
    held_out_windows = replace(
        held_out_windows, forecasts=held_out_windows.forecasts | {"forecast": forecast}
    )
    refusal = slow_motion_refusal(held_out_windows)
    if kept:
        assert refusal is None
    else:
        assert refusal is not None
    if refusal is not None:
        assert refusal.code is NoModel.SLOW_MODEL_TOO_WEAK
        if ratio != 0.8:
            assert refusal.figures["p_value"] is None
        else:
            assert refusal.figures["p_value"] is not None


@mark.slow
def test_each_axis_is_as_by_itself_and_that_of_a_model_of_it(tmp_path, monkeypatch):
    """The axes of a log are analysed in two processes, in one process, and one by one, with the same results."""
    path = short_flight(tmp_path)
    # Pitch and yaw are computed in a second process, where there can be one: also if an earlier test has left a thread
    # in this process, which holds no lock that the second one needs.
    monkeypatch.setattr(parallel, "available_workers", lambda: 2)
    monkeypatch.setattr(parallel, "active_count", lambda: 1)
    assessment = assess(read_log(path))
    monkeypatch.setattr(parallel, "available_workers", lambda: 1)
    in_one_process = assess(read_log(path))
    # So are advised gains and their trial, for a page.
    monkeypatch.setattr(parallel, "available_workers", lambda: 2)
    assessment.compute_for_page()
    assert {"advised_gains", "responses", "noise"} <= vars(assessment).keys()
    assert advised_parameters(assessment.advised_gains) == advised_parameters(
        in_one_process.advised_gains
    )
    axes = assessment.analysis.axes
    for axis, figures in in_one_process.analysis.axes.items():
        assert_array_equal(figures.physical.covariance, axes[axis].physical.covariance)
        assert str(assessment.loops[axis].refusal) == str(in_one_process.loops[axis].refusal)
    assert list(axes) == ["roll", "pitch", "yaw"]
    alone = physical(mavdem.read_segments(path, axis="yaw"))
    assert_allclose(axes["yaw"].physical.effect, alone.effect)
    assert axes["yaw"].physical.status == alone.status
    pitch = assessment.with_axis("pitch").analyses["pitch"].learned
    assert pitch.physical is axes["pitch"].physical
    assert_allclose(pitch.wind_torque.torque, axes["pitch"].wind.torque)
