"""Figures: drawn in the palette's colours, in degrees, with legends beside the data; and the numbers behind them."""

import re
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx

import mavdem
from mavdem.analysis.residuals import correlation
from mavdem.evaluate import held_out_test, held_out_windows
from mavdem.report import palette
from mavdem.report.figures import Plots
from mavdem.report.figures.series import forecast, typical_windows
from mavdem.report.figures.style import svg
from mavdem.report.figures.systems import model_systems, physical_systems
from mavdem.report.labels import AxisCommand, Labels

pytestmark = pytest.mark.slow
LOG = Path(__file__).parents[2] / "logs" / "ardupilot_wind5_steps.tlog"
SETTINGS = mavdem.Settings(order=3, d=2, window=9, parameter_precision=1.0, horizon=None)
METHODS = ("residuals", "bode", "step", "disturbance", "motors", "learning")


@pytest.fixture(scope="module")
def flight():
    return mavdem.read_flight(LOG)[:1200]


@pytest.fixture(scope="module")
def learned(flight):
    return mavdem.learn(flight, SETTINGS)


@pytest.fixture(scope="module")
def held(flight):
    return held_out_windows([flight], SETTINGS)


@pytest.fixture(scope="module")
def figures(learned, flight, held):
    truth = (
        np.array([[0.0, 1.0], [0.0, -2.0]]),
        np.vstack([np.zeros(4), learned.physical.effect]),
        0.01,
    )
    given = {
        "bode": {"truth": truth},
        "step": {"truth": truth},
        "disturbance": {"truth": np.sin(flight.time)},
        "motors": {"hover": mavdem.hover_figures([flight])},
    }
    drawn = {name: getattr(learned.plot, name)(**given.get(name, {})) for name in METHODS}
    return drawn | {"forecast": learned.plot.forecast(held)}


@pytest.mark.parametrize("name", [*METHODS, "forecast"])
def test_a_figure_has_the_palette_s_colours_named_axes_and_no_legend_or_title_over_data(
    name, figures
):
    figure = figures[name]
    drawn = svg(figure, name)
    assert name != "bode" or figure._repr_png_().startswith(b"\x89PNG")
    values = [value for value in vars(palette).values() if isinstance(value, str | tuple)]
    known = {
        colour for value in values for colour in ([value] if isinstance(value, str) else value)
    }
    assert (
        set(re.findall(r"#[0-9a-f]{6}\b", re.sub(r"<defs>.*?</defs>|<image[^>]*>", "", drawn)))
        <= known
    )
    assert drawn.count("<text") > 8
    assert "fill: #ffffff" not in drawn, "it has a background"
    width, height = figure.get_size_inches()
    assert width == approx(5.2) and 1.5 < height < 4.5
    text = ""
    for axes in figure.axes:
        text += axes.get_xlabel() + axes.get_ylabel() + axes.get_title("left")
        assert axes.get_ylabel() or axes.get_title("left")
        if (legend := axes.get_legend()) is not None:
            box = legend.get_window_extent()
            assert not any(box.overlaps(other.get_window_extent()) for other in figure.axes)
            assert not box.overlaps(axes._left_title.get_window_extent())
            assert box.x0 >= 0 and box.x1 <= figure.bbox.x1
    assert figure.axes[-1].get_xlabel()
    assert "rad" not in text, "angles are in degrees"
    units = {
        "bode": "°/s per µs",
        "step": "roll (°)",
        "disturbance": "°/s²",
        "forecast": "roll (°)",
    }
    assert units.get(name, "") in text


def test_residuals_are_in_degrees_and_the_first_of_a_segment_is_a_gap(learned):
    assert isinstance(learned.plot, Plots) and "bode()" in repr(learned.plot)
    (line,) = learned.plot.residuals().axes[0].lines
    errors = np.degrees(learned.record.outputs[1:, 1] - learned.one_step()[1:, 1])
    assert_allclose(line.get_ydata()[1:], errors)
    assert np.isnan(line.get_ydata()[0]) and not line.get_rasterized()


def test_a_forecast_is_of_the_windows_with_the_usual_error(held):
    shown = typical_windows(held, 3)
    ratios = held.error_ratios()
    off = [abs(np.median(ratios[i : i + 3]) - np.median(ratios)) for i in range(len(held) - 2)]
    assert off[shown.start] == min(off) and shown.stop - shown.start == 3
    pair = typical_windows(held, 2).start
    gap = 9.0 * (np.arange(len(held)) > pair)
    assert typical_windows(replace(held, time=held.time + gap[:, None]), 2).start != pair
    with pytest.raises(ValueError, match="no held-out window"):
        forecast(replace(held, time=held.time[:0]), Labels(("u",), ("y",), ("",), ("rad",)))


def test_the_flight_after_the_training_data_is_one_window(flight, learned):
    after = mavdem.read_flight(LOG)[1200:1300]
    figure = learned.plot.forecast(after, output=1)
    assert len(figure.axes) == 1 and figure.axes[0].get_ylabel() == "roll rate (°/s)"
    held = held_out_test(flight, after, learned)
    measured, mean = figure.axes[0].lines[:2]
    assert_allclose(measured.get_ydata(), np.degrees(after.outputs[:, 1]))
    assert_allclose(mean.get_ydata(), np.degrees(held.forecasts["forecast"][0, :, 1]))
    assert_allclose(mean.get_xdata(), after.time)


def test_responses_are_those_of_python_control(learned):
    motors = AxisCommand.of(learned).motors
    A, B, C = learned.model[:3]
    ours = model_systems(learned, motors)
    theirs = control.StateSpace(A, (B @ motors)[:, None], C, np.zeros((2, 1)))
    frequency = np.geomspace(0.1, 20, 5)
    time = np.linspace(0, 1.5, 31)
    response = theirs(2j * np.pi * frequency)
    for output in (0, 1):
        assert_allclose(ours.over_frequency(frequency, output)[0], response[output, 0], rtol=1e-9)
    stepped = control.step_response(theirs, time).outputs[:, 0].T
    assert_allclose(ours.after_step(time)[0], stepped, rtol=1e-6, atol=1e-12)


def test_the_physical_response_is_late_by_its_delay_and_ends_at_effect_over_damping(learned):
    physical = learned.physical._replace(damping=4.0, lag=0.05, delay=0.2)
    motors = AxisCommand.of(learned).motors
    time = np.linspace(0, 3, 301)
    systems = physical_systems(physical, motors, 2)
    outputs = systems.after_step(time)[0]
    assert (outputs[time < 0.2] == 0).all() and (outputs[time > 0.22, 1] > 0).all()
    assert_allclose(outputs[-1, 1], physical.effect @ motors / 4.0, rtol=1e-3)
    rate = physical_systems(physical, motors, 1).after_step(time)[0]
    assert_allclose(rate[:, 0], outputs[:, 1])
    assert systems.b[1:, 2].std() > 0 and (systems.delay > 0).all()


def test_draws_are_as_far_apart_as_the_parameters_are_uncertain(learned):
    systems = model_systems(learned, np.ones(4))
    covariance = learned.theta_covariance
    assert_array_equal(systems.A[0], learned.model.A)
    n = learned.model.A.size
    spread = np.cov(systems.A[1:].reshape(-1, n).T)
    assert_allclose(spread, covariance[:n, :n], atol=0.25 * covariance[:n, :n].max())


def test_a_correlation_is_found_at_its_lag():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(5000)
    values = correlation(noise, np.roll(noise, 7) + rng.standard_normal(5000), 20)
    assert values.argmax() == 7 and values[7] == approx(0.5**0.5, abs=0.03)
    assert np.abs(np.delete(values, 7)).max() < 0.06


def test_a_command_is_the_difference_of_the_motors_of_unknown_geometry_by_effects_and_a_demand_itself(
    learned, flight
):
    command = AxisCommand.of(learned)
    up = flight.effect_directions > 0
    difference = flight.inputs[:, up].mean(axis=1) - flight.inputs[:, ~up].mean(axis=1)
    assert_allclose(command.series(flight.inputs), difference - difference.mean(), atol=1e-9)
    assert command.weights @ command.motors == approx(1)
    blind = replace(learned, record=replace(learned.record, effect_directions=None))
    assert (
        np.sign(AxisCommand.of(blind).motors) == np.sign(learned.record.effect_directions)
    ).all()
    demand = replace(
        learned,
        record=replace(blind.record, inputs=learned.record.inputs[:, :1], input_names=("roll",)),
    )
    assert_array_equal(AxisCommand.of(demand).weights, [1.0])


def test_without_physical_parameters_only_what_needs_them_is_refused(learned, monkeypatch):
    unknown = learned.physical._replace(
        status=dict.fromkeys(learned.physical.status, "not identifiable")
    )
    monkeypatch.setattr(mavdem.Learned, "physical", unknown)
    assert "not identifiable" in learned.plot.bode().get_supxlabel()
    for draw in (learned.plot.motors, learned.plot.disturbance):
        with pytest.raises(ValueError, match="not identifiable"):
            draw()
    monkeypatch.setattr(mavdem.Learned, "physical", None)
    monkeypatch.setitem(learned.__dict__, "wind_torque", None)
    with pytest.raises(ValueError, match="no wind torque"):
        learned.plot.disturbance()
    with pytest.raises(ValueError, match="no motors to show"):
        learned.plot.motors()
    assert "physical parameters" not in svg(learned.plot.bode(), "bode")


def test_the_effect_of_a_demand_is_not_put_beside_a_motor(learned, flight):
    hover = mavdem.hover_figures([flight])
    columns = [name for name, value in vars(hover).items() if isinstance(value, tuple)]
    fewer = replace(hover, **{name: getattr(hover, name)[:2] for name in columns})
    assert [axes.get_title("left") for axes in learned.plot.motors(hover).axes] == [
        "effectiveness",
        "trim",
        "headroom",
    ]
    assert [axes.get_title("left") for axes in learned.plot.motors(fewer).axes] == [
        "trim",
        "headroom",
    ]
