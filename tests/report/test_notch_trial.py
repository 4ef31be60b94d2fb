"""The notch filter to try on a page: the browser computes the autopilots' biquads, and its files are read back."""

import json
from dataclasses import replace
from math import inf, pi, sin, tan
from urllib.parse import unquote

import numpy as np
from browsing import FITS
from hover import Hover
from known_gains import ARDUPILOT, PX4
from numpy.testing import assert_allclose
from pytest import approx, mark
from scipy.signal import freqz

from mavdem.assessment.noise_spectra import MeasuredNoise
from mavdem.ingest.parameter_file import read_parameters
from mavdem.loops.autopilot_parameters import Notch
from mavdem.loops.controllers import controller_from_parameters
from mavdem.loops.filters import notch_response
from mavdem.report.notch_trial import notch_trial
from mavdem.report.pages.page import Chapter, render_document
from mavdem.vibration.spectra import Spectrum

PEAK = 120.0
"""Frequency of the only peak of the spectrum, Hz."""
HARMONIC_NOTCH = {
    "INS_HNTCH_ENABLE": 1.0,
    "INS_HNTCH_MODE": 1.0,
    "INS_HNTCH_FREQ": 82.5,
    "INS_HNTCH_BW": 40.0,
    "INS_HNTCH_REF": 0.2,
    "INS_HNTCH_HMNCS": 3.0,
    "INS_HNTCH_ATT": 30.0,
    "MOT_THST_HOVER": 0.4,
}
PX4_NOTCHES = {
    "IMU_GYRO_NF0_FRQ": 90.0,
    "IMU_GYRO_NF0_BW": 30.0,
    "IMU_GYRO_NF1_FRQ": 60.0,
    "IMU_GYRO_NF1_BW": 20.0,
}
FREQUENCIES = np.array([5.0, 40.0, 100.0, 119.0, 240.0, 390.0])


def spectrum(name, highest=300.0):
    frequency = np.arange(0.0, highest + 1.0)
    density = 1e-6 + 1e-3 * np.exp(-((frequency - PEAK) ** 2) / 20)
    windows = np.broadcast_to(density, (4, 3, len(frequency)))
    unknown = np.full(4, np.nan)
    return Spectrum(name, "rad/s", "IMU", frequency, np.arange(4.0), windows, unknown, unknown)


def trial_of(
    parameters,
    name="gyro_before",
    highest=300.0,
    autopilot="ARDUPILOTMEGA",
    motors=(),
    shown_spectrum=None,
):
    vehicle = Hover().telemetry(autopilot=autopilot)
    noise = MeasuredNoise({name: shown_spectrum or spectrum(name, highest)}, {})
    controller = controller_from_parameters(parameters, "roll", (1.0,))
    return notch_trial("flight.bin", vehicle, noise, controller, None, motors)


def ardupilot_biquad(center, width_per_center, attenuation, rate, frequency):
    """ArduPilot's ``NotchFilter::calculate_A_and_Q`` and ``init_with_A_and_Q``."""
    octaves = np.log2(1 / (1 - width_per_center / 2)) * 2
    quality = np.sqrt(2**octaves) / (2**octaves - 1)
    amplitude = 10 ** (-attenuation / 40)
    omega = 2 * pi * center / rate
    alpha = sin(omega) / (2 * quality)
    middle = -2 * np.cos(omega)
    above = [1 + alpha * amplitude**2, middle, 1 - alpha * amplitude**2]
    return freqz(above, [1 + alpha, middle, 1 - alpha], worN=frequency, fs=rate)[1]


def px4_biquad(center, width, rate, frequency):
    """PX4's ``NotchFilter::setParameters``."""
    alpha = tan(pi * width / rate)
    beta = -np.cos(2 * pi * center / rate)
    below = [1 + alpha, 2 * beta, 1 - alpha]
    return freqz([1, 2 * beta, 1], below, worN=frequency, fs=rate)[1]


def test_a_wide_notch_of_px4_is_as_wide_as_its_program_makes_it():
    response = notch_response([Notch(100.0, 60.0, inf)], 1000.0, FREQUENCIES)
    assert_allclose(response, px4_biquad(100.0, 60.0, 1000.0, FREQUENCIES), atol=1e-9)


def test_a_filter_that_is_off_is_offered_at_the_peak_and_one_that_is_on_as_logged():
    off = trial_of(ARDUPILOT | {"INS_HNTCH_ENABLE": 0.0})
    assert not off.is_on and off.filters[0].sliders[0].value == PEAK
    assert all(np.ptp(chart.lines[0].y) == 0 for (chart,) in off.charts.columns[1:])
    on = trial_of(ARDUPILOT | HARMONIC_NOTCH)
    (form,) = on.filters
    assert on.is_on and [slider.value for slider in form.sliders] == [82.5, 40.0, 30.0]
    assert [multiple for multiple, is_chosen in form.harmonics.items() if is_chosen] == [1, 2]


def test_a_spectrum_that_only_falls_has_no_peak_to_mark():
    """A peak is not where a falling spectrum happens to be largest; one below 40 Hz is found."""
    flat = spectrum("gyro_before")
    slope = 1.0 / (1.0 + flat.frequency) ** 2
    bump = 1.0 + 9.0 * np.exp(-((flat.frequency - 25.0) ** 2) / 20)
    falling = replace(flat, density=np.broadcast_to(slope, flat.density.shape))
    bumpy = replace(flat, density=np.broadcast_to(slope * bump, flat.density.shape))
    without_peak = trial_of(ARDUPILOT, shown_spectrum=falling)
    assert without_peak.model["peak"] is None
    for (chart,) in without_peak.charts.columns:
        assert all(mark.name != "peak" for mark in chart.marks)
    assert any("no peak" in remark for remark in without_peak.remarks)
    assert trial_of(ARDUPILOT, shown_spectrum=bumpy).model["peak"] == approx(25.0, abs=2.0)


def test_a_spectrum_behind_the_filter_is_not_drawn_with_another_one():
    on = trial_of(ARDUPILOT | HARMONIC_NOTCH, "gyro")
    assert len(on.charts.columns) == 2
    assert any("only behind this filter" in remark for remark in on.remarks)
    # Below the loops' highest frequency there is no vibration to take.
    assert trial_of(ARDUPILOT, highest=30.0) is None


def test_two_notches_are_tried_together_and_a_third_stays_as_it_is():
    """The trial draws the product of two notch filters; a third one of ArduPilot is part of the spectrum before."""
    parameters = PX4 | PX4_NOTCHES
    trial = trial_of(parameters, autopilot="PX4")
    assert [form.title for form in trial.filters] == ["Notch 1", "Notch 2"]
    (spectrum_chart,), (gain_chart,), _ = trial.charts.columns
    line = gain_chart.lines[0]
    response = px4_biquad(90.0, 30.0, 8000.0, line.x) * px4_biquad(60.0, 20.0, 8000.0, line.x)
    assert_allclose(line.y, np.maximum(20 * np.log10(abs(response)), -60.0), atol=1e-6)
    _, without, with_notches = spectrum_chart.lines
    # Densities of 1e-9 (rad/s)²/Hz, as they are shown.
    low_density = 1e-9 * np.degrees(1.0) ** 2
    assert without.y[without.x == 60.0] > low_density
    assert with_notches.y[with_notches.x == 60.0] < low_density
    third = {"INS_HNTC3_ENABLE": 1.0, "INS_HNTC3_FREQ": 60.0, "INS_HNTC3_BW": 20.0}
    third |= {"INS_HNTC3_ATT": 80.0, "INS_HNTC2_ENABLE": 0.0}
    (spectrum_chart,), _, _ = trial_of(ARDUPILOT | HARMONIC_NOTCH | third).charts.columns
    _, without, _ = spectrum_chart.lines
    assert without.y[without.x == 60.0] < low_density


def test_a_notch_for_each_motor_is_at_the_speeds_of_the_flight():
    """Notches follow the speed of each motor, Hz, or the mean of all."""
    by_speed = {"INS_HNTCH_MODE": 3.0, "INS_HNTCH_OPTS": 2.0, "INS_HNTCH_REF": 1.0}
    motors = (70.0, 95.0, 100.0, 105.0)
    trial = trial_of(ARDUPILOT | HARMONIC_NOTCH | by_speed, motors=motors)
    line = trial.charts.columns[1][0].lines[0]
    response = np.ones(len(line.x), complex)
    # The lowest centre is that of the parameter.
    for center in (82.5, 95.0, 100.0, 105.0):
        for multiple in (1, 2):
            response *= ardupilot_biquad(multiple * center, 40 / 82.5, 30.0, 1000.0, line.x)
    assert_allclose(line.y, np.maximum(20 * np.log10(abs(response)), -60.0), atol=1e-6)
    assert any("70, 95, 100 and 105 Hz" in remark for remark in trial.remarks)
    shared = trial_of(
        ARDUPILOT | HARMONIC_NOTCH | by_speed | {"INS_HNTCH_OPTS": 0.0}, motors=motors
    )
    assert any("92 Hz" in remark for remark in shared.remarks)
    moving = "In flight the centres move"
    assert any(moving in remark for remark in trial.remarks)
    still = trial_of(ARDUPILOT | HARMONIC_NOTCH | {"INS_HNTCH_MODE": 0.0})
    assert not any(moving in remark for remark in still.remarks)
    dynamic = trial_of(PX4 | PX4_NOTCHES | {"IMU_GYRO_DNF_EN": 1.0}, autopilot="PX4")
    assert any("IMU_GYRO_DNF_EN" in remark for remark in dynamic.remarks)


SECOND_MOVED = {"IMU_GYRO_NF1_FRQ": 150.0, "IMU_GYRO_NF1_BW": 25.0}
"""What is moved of two notches."""
TRIED = """(async (moves, frequencies) => {
for (const part of document.querySelectorAll("details")) part.open = true;
const form = document.querySelector("form.notch"), charts = () => document.documentElement.charts.groups.notch?.charts;
while (charts()?.length !== 3) await new Promise(done => setTimeout(done, 20));
const drawn = () => charts().map(chart => chart.data_.lines.at(-1).y.filter((_, i) => i % 20 === 0));
const logged = drawn(), first = form.querySelector(".effects").textContent;
const input = (one, type) => one.dispatchEvent(new Event(type, { bubbles: true }));
for (const [name, value] of Object.entries(moves)) {
  const one = form.elements[name];
  one.value = value;
  input(one, "input");
}
form.querySelector("[name=harmonic][value='3']")?.click();
const found = frequencies.map(document.documentElement.notch.response);
const labels = [...form.querySelectorAll("input")].every(one => one.labels.length === 1);
const links = [...form.querySelectorAll("a.button")].map(one => [one.download, one.href]);
form.querySelector("[name=on]").click();
const off = form.querySelector("a.button").href;
return [logged, first, found, labels, links, off, form.querySelector(".effects").textContent];
})"""


def page_after_moves(tab, trial, moves, folder):
    """Returns what the page of a trial shows after its sliders were moved."""
    path = folder / "page.html"
    path.write_text(render_document("x", "", [], [Chapter("Spectra", notch_trial=trial)]))
    tab.size(390, dark=True)
    tab.open(path.as_uri())
    computed = tab.run(f"{TRIED}({json.dumps(moves)}, {json.dumps(FREQUENCIES.tolist())})")
    assert tab.said == [] and tab.run(FITS)
    return computed


def parameters_at(address, path):
    path.write_text(unquote(address.split(",", 1)[1]), encoding="utf-8")
    return read_parameters(path)


@mark.slow
def test_a_browser_computes_the_autopilots_biquads_and_writes_them_as_parameters(tmp_path, browser):
    harmonic = trial_of(ARDUPILOT | HARMONIC_NOTCH)
    static = trial_of(PX4 | {"IMU_GYRO_NF0_FRQ": 0.0}, autopilot="PX4")
    two_notches = trial_of(PX4 | PX4_NOTCHES, autopilot="PX4")
    with browser.tab() as tab:
        moves = {"INS_HNTCH_FREQ": 80, "INS_HNTCH_BW": 60, "INS_HNTCH_ATT": 20}
        logged, first, computed, is_labelled, links, off, effects = page_after_moves(
            tab, harmonic, moves, tmp_path
        )
        _, _, found_static, _, static_links, static_off, _ = page_after_moves(
            tab, static, {"IMU_GYRO_NF0_FRQ": 90, "IMU_GYRO_NF0_BW": 30}, tmp_path
        )
        _, _, found_two, _, two_links, _, two_effects = page_after_moves(
            tab, two_notches, SECOND_MOVED, tmp_path
        )
    # The centre follows the throttle: in hover it is √2 times that of the parameter.
    expected = np.ones(len(FREQUENCIES), complex)
    for multiple in (1, 2, 3):
        center = multiple * 80 * 2**0.5
        expected *= ardupilot_biquad(center, 60 / 80, 20.0, 1000.0, FREQUENCIES)
    assert_allclose([sample["gain"] for sample in computed], abs(expected), rtol=1e-9)
    # Both are the same up to whole turns.
    turned = np.exp(1j * np.radians([sample["phase"] for sample in computed]))
    assert_allclose(turned, expected / abs(expected), atol=1e-9)
    expected = px4_biquad(90.0, 30.0, 8000.0, FREQUENCIES)
    assert_allclose([sample["gain"] for sample in found_static], abs(expected), rtol=1e-6)
    # What was drawn at first is what the library computes of the log's parameters.
    for values, (chart,) in zip(logged, harmonic.charts.columns, strict=True):
        assert values == approx(chart.lines[-1].y[::20], rel=2e-3, abs=2e-2)
    assert "Its centre is at 117 Hz." in first
    assert is_labelled and "takes 0.0 dB" in effects and "as logged" in effects
    for name, address in links:
        values = parameters_at(address, tmp_path / name)
        assert values == {
            **{key: HARMONIC_NOTCH[key] for key in HARMONIC_NOTCH if key.startswith("INS_HNTCH")},
            **moves,
            "INS_HNTCH_HMNCS": 7.0,
        }
    assert {name for name, _ in links} == {"flight.notch.param", "flight.notch.params"}
    assert parameters_at(off, tmp_path / "off.param")["INS_HNTCH_ENABLE"] == 0
    assert parameters_at(static_links[0][1], tmp_path / "static.params") == {
        "IMU_GYRO_NF0_FRQ": 90.0,
        "IMU_GYRO_NF0_BW": 30.0,
    }
    assert parameters_at(static_off, tmp_path / "off.params")["IMU_GYRO_NF0_FRQ"] == 0
    expected = px4_biquad(90.0, 30.0, 8000.0, FREQUENCIES)
    expected *= px4_biquad(150.0, 25.0, 8000.0, FREQUENCIES)
    assert_allclose([sample["gain"] for sample in found_two], abs(expected), rtol=1e-6)
    assert parameters_at(two_links[0][1], tmp_path / "two.params") == PX4_NOTCHES | SECOND_MOVED
    assert "they cost" in two_effects
