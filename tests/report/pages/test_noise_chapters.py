"""The chapters of vibration: what stands below their spectra."""

import numpy as np
from partial_records import partial_record
from pytest import approx

from mavdem.assessment.noise_spectra import MeasuredNoise
from mavdem.report.pages.noise_chapters import _folding_captions
from mavdem.vibration.folding import possibly_folded_peak
from mavdem.vibration.spectra import Spectrum


def test_what_a_slow_gyro_shows_at_another_frequency_is_said_below_its_spectra():
    """Pitch oscillates at 15.6 Hz; logged at 25 Hz, that is a peak at 9.4 Hz."""
    frequency = np.linspace(0.0, 12.5, 33)
    density = np.ones((1, 3, 33))
    density[0, 1, 24] = 20.0
    spectrum = partial_record(
        Spectrum, name="gyro", source="IMU", unit="rad/s", frequency=frequency, density=density
    )
    assert (
        possibly_folded_peak(spectrum, 1) == approx(9.375)
        and possibly_folded_peak(spectrum, 0) is None
    )
    noise = MeasuredNoise({"gyro": spectrum}, {})
    [caption] = _folding_captions(noise, {})
    assert caption == (
        "Pitch: a peak at 9.4 Hz. A gyro logged at 25 Hz does not show whether that is its frequency: "
        "16, 34 and 41 Hz would appear there, too (aliasing)."
    )
    [caption] = _folding_captions(noise, {"roll": 15.6, "pitch": 15.6})
    assert caption == (
        "Roll and pitch: the oscillation at 16 Hz appears at 9.4 Hz, since this gyro was logged at 25 Hz (aliasing)."
    )
