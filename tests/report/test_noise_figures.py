"""Figures of step responses, spectra and spectrograms: what they show, and that they are small enough for a page."""

import numpy as np
import pytest

from mavdem.assessment.noise import Noise
from mavdem.assessment.responses import LoopResponse
from mavdem.condition.loop.controllers import controller_of
from mavdem.condition.peaks import Peak, PeakKind
from mavdem.condition.spectra import Spectrum
from mavdem.condition.step_response import Estimate, StepResponse
from mavdem.facts import Fact
from mavdem.facts.loops import StepResponses
from mavdem.report.figures.noise import spectra, spectrogram, step_responses
from mavdem.report.figures.style import svg

GAINS = {
    f"MC_ROLLRATE_{name}": value
    for name, value in {"P": 0.1, "I": 0.1, "D": 0.003, "K": 1.0}.items()
} | {"MC_ROLL_P": 6.5, "IMU_DGYRO_CUTOFF": 30.0, "IMU_GYRO_CUTOFF": 40.0, "THR_MDL_FAC": 0.3}


def response():
    time = np.arange(1, 101) / 200
    frequency = np.linspace(0.5, 80, 200)
    one = Estimate(0.1, 0.05, 0.15)
    return StepResponse(
        axis="roll",
        loop="rate",
        time=time,
        step=1 - np.exp(-20 * time),
        step_half=np.full(100, 0.05),
        frequency=frequency,
        response=1 / (1 + 1j * frequency / 5),
        gain_half=np.full(200, 0.1),
        highest=80.0,
        windows=60,
        overshoot=one,
        rise_time=one,
        settling=one,
        delay=one,
        peak=one,
        peak_frequency=one,
        coherence=0.9,
    )


def spectrum(name):
    frequency = np.linspace(0, 500, 513)
    density = np.random.default_rng(1).random((40, 3, 513)) + 100 * (np.abs(frequency - 140) < 5)
    time = np.arange(40.0)
    return Spectrum(name, "rad/s", "GYR", frequency, time, density, 0.4 + time / 100, time + 50)


def test_steps_of_known_loops_are_drawn_with_band_and_prediction():
    measured = response()
    found = LoopResponse(measured, measured.step, measured.gain)
    none = LoopResponse(Fact(StepResponses.NO_SETPOINT, subject="yaw rate"))
    figure = step_responses({"roll": {"rate": found}, "yaw": {"rate": none}})
    step, without, gain, _ = figure.axes
    assert len(step.lines) == 3 and len(step.collections) == 1 and not without.lines
    assert step.get_title(loc="left") == "roll rate" and gain.get_xscale() == "log"
    assert len(svg(figure, "steps")) < 100_000
    assert step_responses({"yaw": {"rate": none}}) is None


def test_spectra_have_their_lines_and_the_filters_over_them():
    line = Peak(PeakKind.MOTOR, 140.0, 100.0, 1.0, 5.0, 0.5)
    shown = {name: spectrum(name) for name in ("gyro_before", "gyro")}
    figure = spectra(
        Noise(shown, {"gyro_before": (line,)}), controller_of(GAINS, "roll", (1.0,)), 12.0
    )
    axes, filters = figure.axes
    assert [text.get_text() for text in axes.texts] == ["motor"]
    assert filters.lines[0].get_ydata()[0] == pytest.approx(0.0, abs=0.1)
    assert "12.0 Hz" in figure.get_supxlabel() and len(svg(figure, "spectra")) < 100_000
    assert spectra(Noise({}, {})) is None
    over_time, over_throttle = spectrogram(shown["gyro"]).axes
    assert over_time.images and over_throttle.images
