"""Charts: what they show, and that they are small; notebooks and examples draw them with matplotlib."""

from base64 import b64decode
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
from numpy.random import default_rng
from numpy.testing import assert_allclose
from partial_records import partial_record
from pytest import approx, fixture, mark, raises
from recorded_flights import FLIGHT

import mavdem
from mavdem.assessment.axis.residuals import lagged_correlation
from mavdem.assessment.axis.responses import LoopResponse
from mavdem.assessment.noise_spectra import MeasuredNoise
from mavdem.confidence import IntervalEstimate
from mavdem.dataset.axes import AXES
from mavdem.evaluate import held_out_test, held_out_windows
from mavdem.facts import Fact
from mavdem.facts.loops import StepResponseFact
from mavdem.loops.axis_loops import Loop
from mavdem.loops.controllers import controller_from_parameters
from mavdem.loops.step_response import StepResponse
from mavdem.report.charts import model_charts
from mavdem.report.charts.chart import TIME, Axis, Chart, Group, Line, LineStyle, step_chart
from mavdem.report.charts.flight_charts import (
    UNNAMED_LINE,
    axis_spectrum_charts,
    spectrogram_charts,
    spectrum_chart,
    step_charts,
)
from mavdem.report.charts.frequency_responses import model_response, plant_response
from mavdem.report.labels import AxisCommand, Labels
from mavdem.report.pages.loop_chapters import responses_chapter
from mavdem.report.pages.page import Chapter, render_document
from mavdem.report.screen import detail_blocks
from mavdem.vibration.spectra import Spectrum
from mavdem.vibration.spectral_lines import LineCause, SpectralLine

SETTINGS = mavdem.Settings(order=3, d=2, window=9, parameter_precision=1.0, horizon=None)
GAINS = {
    "MC_ROLLRATE_P": 0.1,
    "MC_ROLLRATE_I": 0.1,
    "MC_ROLLRATE_D": 0.003,
    "MC_ROLLRATE_K": 1.0,
    "MC_ROLL_P": 6.5,
    "IMU_DGYRO_CUTOFF": 30.0,
    "IMU_GYRO_CUTOFF": 40.0,
    "THR_MDL_FAC": 0.3,
}


def test_step_responses_end_after_twice_the_time_in_which_the_slowest_settles():
    """The slower of two responses is at 90 % of its end after 0.115 s, so that 0.23 s are drawn, rounded up."""
    time = np.linspace(0, 0.5, 201)
    steps = [Line(str(lag), "", time, 1 - np.exp(-time / lag)) for lag in (0.02, 0.05)]
    chart = step_chart("Roll rate: step", steps)
    assert [line.x[-1] for line in chart.lines] == approx([0.3, 0.3])


def test_a_line_that_is_thinned_keeps_its_peaks_and_its_gaps():
    """A line of 8000 samples with two peaks and a gap from 40 s to 60 s is reduced to 501 points."""
    time = np.arange(0, 100, 0.01)
    time = time[(time < 40) | (time > 60)]
    values = np.sin(time)
    values[1234] = 9.0
    values[4321] = -9.0
    resampled = Line("x", "", time, values).resampled(np.linspace(0, 100, 501)).y
    assert (
        np.nanmax(resampled) == 9.0
        and np.nanmin(resampled) == -9.0
        and np.isnan(resampled[205:295]).all()
    )
    assert_allclose(resampled[:50], np.sin(np.linspace(0, 100, 501)[:50]), atol=0.2)
    sparse_line = Line("x", "", time[::50], values[::50])
    assert np.isnan(Chart("", TIME, TIME, (sparse_line,)).thinned(12_000).lines[0].y).any()


@mark.parametrize("is_logarithmic", [False, True])
def test_what_a_page_holds_is_what_was_drawn_to_five_digits(is_logarithmic):
    x = np.geomspace(0.1, 100, 50)
    y = np.where(x > 50, np.nan, x**2)
    axes = Axis("x", is_logarithmic), Axis("y", is_logarithmic)
    (line,) = Chart("", *axes, (Line("y", "", x, y),)).as_json(1000)["lines"]
    low, step, counts = (line["y"][name] for name in ("low", "step", "counts"))
    counts = np.frombuffer(b64decode(counts), "<i2").astype(float)
    unpacked = np.where(counts == -32768, np.nan, low + step * (counts + 32767))
    if is_logarithmic:
        assert_allclose(10**unpacked, y, rtol=2e-4)
    else:
        assert_allclose(unpacked, y, rtol=0, atol=0.2)


def test_a_chart_says_in_words_what_it_shows():
    line = Line("motor 1", "", np.arange(3.0), np.array([1.0, np.nan, 4.0]))
    chart = Chart("Motors", TIME, Axis("Motors, %"), (line,))
    assert (
        chart.description
        == "Motors in Motors, % over time since boot (s): motor 1 from 1.00 to 4.00."
    )


def response():
    """Returns the step and frequency response of a made-up rate loop about roll."""
    time = np.arange(1, 101) / 200
    frequency = np.linspace(0.5, 80, 200)
    estimate = IntervalEstimate(0.1, 0.05, 0.15)
    names = ("overshoot", "rise_time", "settling", "delay", "peak", "peak_frequency")
    return StepResponse(
        axis="roll",
        loop="rate",
        time=time,
        step=1 - np.exp(-20 * time),
        step_half=np.full(100, 0.05),
        frequency=frequency,
        response=1 / (1 + 1j * frequency / 5),
        gain_half=np.full(200, 0.1),
        max_frequency=80.0,
        windows=60,
        **dict.fromkeys(names, estimate),
        coherence=0.9,
    )


def spectrum(name, highest=500.0):
    frequency = np.linspace(0, highest, 513)
    density = default_rng(1).random((40, 3, 513)) + 100 * (abs(frequency - 140) < 5)
    time = np.arange(40.0)
    return Spectrum(name, "rad/s", "GYR", frequency, time, density, 0.4 + time / 100, time + 50)


def test_steps_of_known_loops_have_band_and_prediction():
    """The step response of roll was measured and predicted; yaw has no setpoint."""
    measured = response()
    loop_response = LoopResponse(measured, measured.step, measured.gain)
    none = LoopResponse(Fact(StepResponseFact.NO_SETPOINT, subject="yaw rate"))
    ((step, gain),) = step_charts({"roll": {"rate": loop_response}, "yaw": {"rate": none}}).values()
    measured_line, predicted = step.lines
    assert_allclose(measured_line.upper_edge - measured_line.lower_edge, 0.1)
    assert (
        predicted.style is LineStyle.DASHES
        and gain.y.is_logarithmic
        and (gain.lines[0].lower_edge > 0).all()
    )
    assert step_charts({"yaw": {"rate": none}}) == {}
    never = replace(
        measured, settling=IntervalEstimate(0.5, 0.5, 0.5), delay=IntervalEstimate(0.1, 0.05, 0.5)
    )
    figures, _ = responses_chapter({"roll": {"rate": LoopResponse(never), "attitude": none}}).blocks
    assert figures.rows[0][3:] == ["over 0.50", "100 (50 to over 500)", "no peak", ""]


def test_a_gain_above_1_is_a_peak_unless_it_is_that_of_the_lowest_frequency():
    peaked = replace(
        response(), peak=IntervalEstimate(1.4, 1.3, 1.5), peak_frequency=IntervalEstimate(6, 5, 7)
    )
    assert peaked.has_peak and "largest gain 1.4 at 6 Hz" in peaked.fact.sentence
    lowest = replace(peaked, peak_frequency=IntervalEstimate(0.5, 0.5, 1.0))
    assert not lowest.has_peak and "without a peak of its gain" in lowest.fact.sentence


def test_a_step_of_the_identified_loop_is_not_called_measured():
    loop_response = LoopResponse(replace(response(), is_identified=True))
    chapter = responses_chapter({"roll": {"rate": loop_response}})
    assert chapter.blocks[0].rows[0][0] == "roll rate (step: identified loop)"
    assert "step of the identified loop" in chapter.groups[0].caption


def test_a_doubtful_step_has_no_band_and_no_figures():
    loop_response = LoopResponse(replace(response(), unseen_part=0.4))
    chapter = responses_chapter({"roll": {"rate": loop_response}})
    [reason] = chapter.blocks
    assert reason.text.startswith("The step of the roll rate is doubtful")
    step, _ = chapter.groups[0].columns[0]
    assert step.title == "Roll rate: doubtful step" and step.lines[0].lower_edge is None


@mark.slow
def test_spectra_have_their_lines_and_the_filters_over_them():
    """The noise before and after the filters is drawn with the motor line and the gain of the filters.

    Each axis has the crossover of its own loop.

    The spectrogram is an image in the page.
    """
    line = SpectralLine(LineCause.MOTOR, 140.0, 100.0, 1.0, 5.0, 0.5)
    spectra = {name: spectrum(name) for name in ("gyro_before", "gyro")}
    loop = partial_record(
        Loop, controller=controller_from_parameters(GAINS, "roll", (1.0,)), crossover=12.0
    )
    chart = spectrum_chart(MeasuredNoise(spectra, {"gyro_before": (line,)}), loop)
    assert [mark.name for mark in chart.marks] == ["motor"]
    # Rates are shown in degrees.
    density = spectra["gyro"].mean_density.sum(axis=0)
    assert chart.y.label == "power ((°/s)²/Hz)"
    assert chart.lines[1].y.max() == approx(np.degrees(np.degrees(density[1:].max())))
    assert [drawn_line.name for drawn_line in chart.lines] == [
        "unfiltered",
        "filtered",
        "filters",
    ]
    spectra["gyro"] = spectrum("gyro", 25.0)
    _, slow, _ = spectrum_chart(MeasuredNoise(spectra, {}), loop).lines
    assert slow.name == "filtered (50 Hz only)"
    spectra["gyro"] = spectrum("gyro")
    assert chart.lines[2].is_on_right_axis and chart.lines[2].y[0] == approx(0.0, abs=0.1)
    slow_loop = partial_record(Loop, controller=loop.controller, crossover=5.0)
    loops = {"roll": loop, "yaw": slow_loop}
    axes = axis_spectrum_charts(MeasuredNoise(spectra, {}), loops, "gyro", AXES)
    crossovers = {axis: [mark.x for mark in chart.marks] for axis, chart in axes.items()}
    assert crossovers == {"roll": [12.0], "pitch": [], "yaw": [5.0]}
    assert [axis.title.split(":")[0] for axis in axes.values()] == ["Roll", "Pitch", "Yaw"]
    for axis in axes.values():
        assert (axis.lines[0].y < chart.lines[0].y).all() and axis.y.limits == axes["roll"].y.limits
    # A line of unknown cause is marked only in the axes that have a peak there.
    unknown = line._replace(cause=LineCause.UNNAMED, frequency=60.0)
    noise = MeasuredNoise(spectra, {"gyro_before": (unknown,)})
    marked_axes = axis_spectrum_charts(noise, {}, "gyro", AXES)
    assert [mark.name for mark in spectrum_chart(noise).marks] == [UNNAMED_LINE]
    assert not any(axis.marks for axis in marked_axes.values())
    over_time, over_throttle = spectrogram_charts(spectra["gyro"])
    assert over_time.spectrogram.power.shape == (40, 171) and over_throttle.spectrogram is not None
    (pixels,) = over_time.as_json(100)["lines"]
    assert pixels["rows"] == 40 and len(b64decode(pixels["heat"])) == 40 * 171
    chapter = Chapter("Spectra", (), [Group.side_by_side([over_time])])
    assert f"<h3>{over_time.title}</h3>" in render_document("flight", "", [], [chapter])


@fixture(scope="module")
def flight():
    return mavdem.read_flight(FLIGHT)[:1200]


@fixture(scope="module")
def learned(flight):
    return mavdem.learn(flight, SETTINGS)


@mark.slow
def test_residuals_are_in_degrees_and_the_first_of_a_segment_is_a_gap(learned):
    over_time, *tests = model_charts.residual_charts(learned)
    errors = np.degrees(learned.record.outputs[1:, 1] - learned.one_step()[1:, 1])
    assert_allclose(over_time.lines[0].y[1:], errors)
    assert np.isnan(over_time.lines[0].y[0]) and all(len(chart.levels) == 3 for chart in tests)


@mark.slow
def test_a_forecast_is_drawn_in_degrees(flight, learned):
    held = held_out_windows([flight], SETTINGS)
    after = mavdem.read_flight(FLIGHT)[1200:1300]
    (chart,) = model_charts.forecast_charts(
        held_out_test(flight, after, learned), Labels.of(learned), 1
    )
    assert chart.y.label == "roll rate, °/s"
    assert_allclose(chart.lines[0].y, np.degrees(after.outputs[:, 1]))
    with raises(ValueError, match="no held-out window"):
        model_charts.forecast_charts(replace(held, time=held.time[:0]), Labels.of(learned))


@mark.slow
def test_frequency_responses_equal_python_controls(learned):
    # At the top of the file the import, of Matplotlib too, would take every worker of the tests half a second.
    import control

    motors = AxisCommand.of(learned).motors
    A, B, C = learned.model.A, learned.model.B, learned.model.C
    reference_system = control.StateSpace(A, (B @ motors)[:, None], C, np.zeros((2, 1)))
    frequency = np.geomspace(0.1, 20, 5)
    for output in (0, 1):
        expected_response = reference_system(2j * np.pi * frequency)[output, 0]
        (response,) = model_response(learned, motors, frequency, output)
        assert_allclose(response, expected_response, rtol=1e-9)


@mark.slow
def test_the_physical_response_begins_at_effect_over_damping_and_turns_by_its_delay(learned):
    physical = learned.physical._replace(damping=4.0, lag=0.05, delay=0.2)
    motors = AxisCommand.of(learned).motors
    frequency = np.array([1e-3, 1.0])
    response = plant_response(physical, motors, frequency, is_angle=False)[0]
    assert abs(response[0]) == approx(physical.effect @ motors / 4.0, rel=1e-3)
    assert np.angle(response[1] / response[0]) == approx(
        -2 * np.pi * 0.2 - np.arctan(2 * np.pi / 4) - np.arctan(2 * np.pi * 0.05),
        abs=0.01,
    )
    angle = plant_response(physical, motors, frequency, is_angle=True)[0]
    assert_allclose(angle * 2j * np.pi * frequency, response)


def test_a_correlation_is_found_at_its_lag():
    rng = default_rng(1)
    noise = rng.standard_normal(5000)
    values = lagged_correlation(noise, np.roll(noise, 7) + rng.standard_normal(5000), 20)
    assert values.argmax() == 7 and values[7] == approx(0.5**0.5, abs=0.03)
    assert abs(np.delete(values, 7)).max() < 0.06


@mark.slow
def test_without_physical_parameters_only_what_needs_them_is_refused(learned, monkeypatch):
    command = AxisCommand.of(learned)
    assert command.weights @ command.motors == approx(1)
    unknown = learned.physical._replace(
        status=dict.fromkeys(learned.physical.status, "not identifiable")
    )
    monkeypatch.setattr(mavdem.Learned, "physical", unknown)
    assert model_charts.bode_charts(learned)[0].title.endswith("by DEM's model")
    with raises(ValueError, match="not identifiable"):
        learned.plot.disturbance()


@mark.slow
def test_details_say_how_it_was_learned_and_a_notebook_what_it_is_good_for(learned):
    leads = {block.lead for block in detail_blocks(learned)}
    assert any(lead.startswith("Modes of DEM") for lead in leads) and len(leads) >= 2
    notebook = "".join(ElementTree.fromstring(learned._repr_html_()).itertext())
    assert "control effectiveness" in notebook and "3 states, from 12 s at 100 Hz" in notebook


def test_a_prediction_that_diverges_is_clipped_beside_what_was_measured():
    time = np.arange(4.0)
    measured = Line("measured", "blue", time, np.array([-4.0, 0.0, np.nan, 4.0]))
    away = Line.with_band("0.25 s ahead", "red", time, np.array([0.0, 3.0, 99.0, np.nan]), time)
    clipped = away.clipped_to([measured])
    assert clipped.y[:3].tolist() == [0.0, 3.0, 6.0] and np.isnan(clipped.y[3])
    assert np.nanmax(clipped.upper_edge) == 6.0
    unmeasured = measured._replace(y=np.full(4, np.nan))
    assert away.clipped_to([unmeasured]) is away
