"""Bands, surprise and marks of the online learner: honest without a change, robust to one, ready for the next."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

import mavdem
from mavdem.dem.online.tracker import (
    BAND_SECONDS,
    FALSE_MARK_SECONDS,
    PEAK_SECONDS,
    AnomalyMarks,
    ErrorBands,
    Surprise,
)
from sitl_scenarios.dynamics import Four
from sitl_scenarios.scenario import Scenario
from sitl_scenarios.simulation import Simulation

pytestmark = pytest.mark.usefixtures("without_wind_fits")
DT = 0.01
QUARTER_SECOND = 3  # its place among the horizons


def fed(bands: ErrorBands, errors: np.ndarray, block: int = 10) -> np.ndarray:
    """Half widths as of each sample, where every prediction is 0."""
    half = []
    for sample, error in enumerate(errors):
        half.append(bands.half_widths)
        bands.add(np.array([error]), np.zeros(1), np.zeros((1, 1)))
        if sample % block == block - 1:
            bands.update()
    return np.array(half)[:, :, 0]


def test_a_band_holds_nine_of_ten_errors():
    rng = np.random.default_rng(0)
    for errors in (rng.standard_normal(20_000), rng.standard_t(3, 20_000)):
        half = fed(ErrorBands((1,), 1, DT), errors)[1000:]
        np.testing.assert_allclose(np.mean(np.abs(errors[1000:, None]) <= half, axis=0), 0.9, atol=0.01)


def test_a_band_forgets_by_the_number_of_errors_and_not_by_their_size():
    errors = np.random.default_rng(0).standard_normal(3000)
    errors[1000:1200] *= 1e6
    half = fed(ErrorBands((1,), 1, DT), errors)
    assert half[1000:].max() < 20
    after = 1200 + round(BAND_SECONDS / DT) + 10
    np.testing.assert_allclose(half[after:], norm.ppf(0.95), rtol=0.2)


def test_predictions_meet_their_own_sample():
    bands = ErrorBands((1, 3), 1, DT)
    for sample in range(60):
        if sample == 30:
            bands.end_segment()  # what was predicted of the time of the gap is never held against what came after it
        value = sample + 1000.0 * (sample >= 30)
        bands.add(np.array([value]), np.array([np.nan]), np.array([[value + 1.5], [value + 5.0]]))
    bands.update()
    np.testing.assert_allclose(bands.half_widths, [[np.nan], [0.5], [2.0]])


def test_surprise_is_in_units_of_the_lowest_twentieth():
    surprise = Surprise(DT)
    for value in np.random.default_rng(0).standard_normal(10_000):
        surprise.add(value)
    surprise.update_quantiles()
    assert surprise.add(norm.ppf(0.05)) == pytest.approx(1.0, abs=0.15)
    assert surprise.add(2.0) < 0


def test_after_a_free_energy_that_did_not_vary_a_drop_is_still_a_number():
    surprise = Surprise(DT)
    for _ in range(300):
        surprise.add(5.0)
    surprise.update_quantiles()
    assert 1e6 < surprise.add(-1e5) < np.inf


def test_a_failure_that_lasts_does_not_hide_the_next():
    surprise, values = Surprise(DT), np.random.default_rng(0).standard_normal(1400)
    values[1000:1200] -= 1e4
    for value in values:
        surprise.add(value)
    surprise.update_quantiles()
    assert len(surprise._past) == 1000
    assert surprise.add(-1e4) > 1e3


def surprises(rng: np.random.Generator, seconds: float) -> np.ndarray:
    """Of F(t) with a long lower tail, alike for a window of samples, in the unit of surprise."""
    low = rng.gamma(1.0, size=round(seconds / DT / 10)).repeat(10)
    return (low - np.log(2.0)) / (np.log(20.0) - np.log(2.0))


def marked(marks: AnomalyMarks, surprise: np.ndarray) -> np.ndarray:
    return DT * np.flatnonzero([marks.add(value) for value in surprise])


@pytest.mark.slow
def test_marks_without_a_change_are_as_rare_as_stated():
    """Quiet, and with a manoeuvre every 6 s, for two hours; four standard deviations of what is expected."""
    for size in (0.0, 15.0):
        surprise = surprises(np.random.default_rng(1), 7200.0)
        for start in range(0, len(surprise), 600):
            surprise[start : start + 30] += size
        expected = 7200.0 / FALSE_MARK_SECONDS
        assert len(marked(AnomalyMarks(DT), surprise)) <= expected + 4 * np.sqrt(expected)


def test_a_change_is_marked_promptly_and_so_is_the_next():
    rng = np.random.default_rng(2)
    surprise, failures = surprises(rng, 120.0), np.array([40.0, 80.0])
    for at in failures:
        surprise[round(at / DT) : round(at / DT) + 200] += 1000.0
    np.testing.assert_allclose(marked(AnomalyMarks(DT), surprise), failures, atol=0.5)


def test_nothing_is_marked_before_there_are_peaks_to_compare_with():
    surprise = np.full(3000, 1e6)
    assert not len(marked(AnomalyMarks(DT), surprise[: round(3 * PEAK_SECONDS / DT)]))
    assert not AnomalyMarks(DT).add(np.nan)


class TwiceFailing(Simulation):
    """Motor 1 loses a third of its thrust, and 20 s later motor 4 does."""

    FAILURES = ((40.0, 0), (60.0, 3))

    def _targets(self, outputs: Four, battery: float) -> Four:
        speeds = list(super()._targets(outputs, battery))
        for at, motor in self.FAILURES:
            if self._now * self.cycle >= at:
                speeds[motor] *= np.sqrt(2 / 3)
        return tuple(speeds)


def judged(time: np.ndarray, outputs: np.ndarray, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times of marks, half widths of the band of roll a quarter second ahead, and its errors, as of the samples."""
    online = mavdem.OnlineLearner(dt=DT)
    estimates = [online.update(*row) for row in zip(time, outputs, inputs, strict=True)]
    ahead, band = (
        np.array([part[QUARTER_SECOND, 0] for part in parts])
        for parts in ([each.ahead for each in estimates], [each.ahead_band for each in estimates])
    )
    return time[[each.unusual for each in estimates]], band[:-25], np.abs(outputs[25:, 0] - ahead[:-25])


@pytest.mark.slow
def test_of_two_failures_both_are_marked_and_bands_recover_within_seconds():
    scenario = Scenario.model_validate(
        {
            "duration": 100,
            "seed": 1,
            "wind": ({"kind": "dryden", "speed": 4.0},),
            "moments": ({"sd": 0.03, "s": 0.1},),
            "stream": {"speaks": "px4"},
        }
    )
    simulation = TwiceFailing(scenario)
    motion = simulation.advance(round(75.0 / simulation.cycle))
    w, x, y, z = motion.known_attitude.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    time = np.arange(14.0, 75.0 - DT, DT)
    outputs = np.column_stack([np.interp(time, motion.time, each) for each in (roll, motion.known_rates[:, 0])])
    rows = np.searchsorted(motion.time, time, side="right") - 1
    marks, band, error = judged(time, outputs, motion.outputs[rows])
    assert len(marks) == 2
    assert (np.abs(marks - [at for at, _ in TwiceFailing.FAILURES]) < 1.5).all()
    quiet = (time[:-25] > 25.0) & (time[:-25] < 39.0)
    assert 0.85 <= np.mean(error[quiet] <= band[quiet]) <= 0.95
    for at, _ in TwiceFailing.FAILURES:
        after = (time[:-25] > at + 10.0) & (time[:-25] < at + 15.0)
        assert np.median(band[after]) < 2 * np.median(band[quiet])
