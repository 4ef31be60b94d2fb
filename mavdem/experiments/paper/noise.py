"""Section V.C of the paper: is the process noise Gaussian, as the Laplace approximation assumes, and is it coloured?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from mavdem.dem import learn
from mavdem.experiments.paper import figures
from mavdem.experiments.paper.checks import Check, ExperimentResult
from mavdem.experiments.paper.noise_tests import NoiseAnalysis, analyse_noise
from mavdem.experiments.paper.runner import PAPER_SETTINGS, Runner
from mavdem.experiments.window import Window, disjoint_windows
from mavdem.report.figures.style import Picture

SIGNIFICANCE_LEVEL = 0.01
"""Probability with which each test rejects a true hypothesis; with five tests, one report in twenty has an error."""

LAGS_SHOWN = 60
"""Lags of the autocorrelation in the figure, samples; a choice."""


def run(runner: Runner) -> ExperimentResult:
    """Tests whether the process noise of DEM's models is Gaussian and coloured, as the paper claims.

    The noise w^φ̇ is what a model leaves of the derivative of its state roll rate. It is analysed for the model of each
    simulated experiment, and of disjoint windows of the recorded flights, if there are any.

    Args:
        runner: holds the windows, and learns the models in several processes.

    Returns:
        Checks, figures, and the results of the tests as ``numbers``.
    """
    names = [f"experiment {number}" for number in runner.experiment_windows]
    windows = list(runner.experiment_windows.values())
    # Successive windows overlap by half, and only disjoint ones are independent.
    for index in disjoint_windows(runner.recorded_windows):
        windows.append(runner.recorded_windows[index])
    # All windows are one batch of jobs. Their results come in the order of the windows, simulations first.
    noises = runner.map_jobs(analyse_process_noise, windows)
    simulated_noises = dict(zip(names, noises[: len(names)], strict=True))
    ardrone_noises = noises[len(names) :]
    checks = list(
        noise_checks(list(simulated_noises.values()), "w^φ̇ of the learned models", "flights")
    )
    if ardrone_noises:
        checks += noise_checks(ardrone_noises, "w^φ̇ of the real AR.Drone", "windows")
    noises_shown = dict(simulated_noises)
    if ardrone_noises:
        # One window stands for all in the figures: that with the median p-value of the normality test.
        noises_by_p_value = sorted(ardrone_noises, key=lambda noise: noise.normality.p_value)
        noises_shown["real AR.Drone"] = noises_by_p_value[len(noises_by_p_value) // 2]
    return ExperimentResult(
        checks=tuple(checks),
        numbers={
            "learnt": {name: noise.to_dict() for name, noise in simulated_noises.items()},
            "real AR.Drone, learnt": [noise.to_dict() for noise in ardrone_noises],
        },
        pictures=_pictures(noises_shown),
    )


def analyse_process_noise(window: Window) -> NoiseAnalysis:
    """Learns a model by DEM with the paper's settings and analyses the process noise of the roll rate.

    The process noise of the states, x′ − A x − B v as the D step estimates it, becomes noise of the outputs by C. The
    last output is the roll rate, whose noise w^φ̇ is in rad/s².

    Args:
        window: window of a flight, of which the training part is used.

    Returns:
        Autocorrelation and tests of that noise.
    """
    learned = learn(window.train, PAPER_SETTINGS)
    _, state_noise = learned.process_noise()
    roll_rate_noise = state_noise @ learned.model.C[-1]
    # Each value of the noise is estimated from a window of so many samples, which neighbouring values share.
    samples_of_estimate = learned.settings.window
    assert samples_of_estimate is not None
    return analyse_noise(roll_rate_noise, overlap=samples_of_estimate)


def noise_checks(noises: Sequence[NoiseAnalysis], subject: str, pieces: str) -> tuple[Check, Check]:
    """Checks that every noise series is Gaussian, and that every one is coloured.

    A series is coloured if its autocorrelation exceeds the bound of white noise at the first lag at which values share
    no samples, and the Ljung-Box test rejects white noise.

    Args:
        noises: analyses of the series.
        subject: name of the noise, for the text.
        pieces: plural noun for the pieces that the series come from, for the text.

    Returns:
        The check for Gaussian noise, and that for coloured noise.
    """
    gaussian_count = 0
    coloured_count = 0
    for noise in noises:
        if noise.normality.p_value >= SIGNIFICANCE_LEVEL:
            gaussian_count += 1
        exceeds_bound = noise.autocorrelation[noise.overlap] > noise.bound
        if exceeds_bound and noise.whiteness.p_value < SIGNIFICANCE_LEVEL:
            coloured_count += 1
    return (
        Check(
            rule=f"{subject}: the test for Gaussian noise of any colour has p ≥ {SIGNIFICANCE_LEVEL} every time",
            holds=gaussian_count == len(noises),
            finding=f"{subject} is Gaussian in {gaussian_count} of {len(noises)} {pieces}",
        ),
        Check(
            rule=f"{subject}: its autocorrelation lies above the 95 % bound at the first lag that shares no "
            f"samples, and the test for white noise of values that share none has p < {SIGNIFICANCE_LEVEL}, every time",
            holds=coloured_count == len(noises),
            finding=f"{subject} is coloured in {coloured_count} of {len(noises)}",
        ),
    )


def _pictures(noises: Mapping[str, NoiseAnalysis]) -> tuple[Picture, ...]:
    """Returns the figures of the process noise: histograms and autocorrelations.

    The histograms show whether the noise is Gaussian. The autocorrelations show whether it is white: the
    autocorrelations of white noise lie within the 95 % bounds that are drawn with them. The first ``LAGS_SHOWN`` lags
    are shown.

    Args:
        noises: analyses of the noise series, by the name in the legend.

    Returns:
        Two pictures, each with a function that draws it later.
    """
    series = {name: noise.values for name, noise in noises.items()}
    autocorrelations = {name: noise.autocorrelation[:LAGS_SHOWN] for name, noise in noises.items()}
    # The bound depends on the length of a series. The widest one, of the shortest series, holds for all.
    bound = max(noise.bound for noise in noises.values())
    return (
        Picture(
            "Histograms of the process noise w^φ̇",
            "Under DEM’s models (the paper’s settings), in units of its standard deviation; line: a Gaussian. Of "
            "the real AR.Drone, the window with the median p.",
            partial(figures.draw_histograms, series),
        ),
        Picture(
            "Autocorrelation of w^φ̇",
            f"Lines: 95 % bounds of white noise. Values at lags below {PAPER_SETTINGS.window} share samples, so they "
            "correlate even if the noise is white.",
            partial(
                figures.draw_lines,
                {"": autocorrelations},
                "lag, samples",
                bounds=(-bound, bound),
            ),
        ),
    )
