"""Identifiability: whether a flight determines effect, damping and lag, and the reason where it does not.

All limits and model errors of the room stand here. They were chosen on simulated flights of three vehicles in seven
winds, steered in four ways and not at all, and tried on as many others (``tools/validation/physical.py``;
docs/physical.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

Status = Literal["reported", "biased", "not identifiable"]
PARAMETERS = ("effect", "damping", "lag")
CHANGED = "It differs from window to window by more than chance"


class Limit(NamedTuple):
    """The largest figure up to which a parameter is reported, and up to which it is reported with a bias."""

    reported: float
    biased: float

    def status(self, figure: float) -> Status:
        """Returns what a figure makes of its parameter."""
        return (
            "reported"
            if figure <= self.reported
            else "biased"
            if figure <= self.biased
            else "not identifiable"
        )


WIND_SHARE = Limit(0.25, 0.33)  # of the wind, in the torque's variance
RELATIVE_SD = {"effect": Limit(0.08, 0.20), "damping": Limit(0.75, 0.75), "lag": Limit(0.25, 0.35)}
SPECTRUM_RANGE = {
    "effect": Limit(0.06, 0.30),
    "damping": Limit(0.60, 0.90),
    "lag": Limit(0.40, 0.40),
}
"""Of the logarithm of the estimate, over the spectra that the wind may have. An effect cannot be told from its lag."""
MAX_ALIAS_SHARE = 0.12  # of the commands' variance, above half of the Nyquist frequency
SLOWEST_RATE = 80.0  # Hz, below which the commands between samples matter
LARGEST_DAMPING = 15.0  # 1/s, beyond which the estimate is near its bound
RESOLVED_LAG = 0.5  # steps of the stream


class ModelErrors(NamedTuple):
    """Standard deviations of what the model leaves out, by which estimates differ from the truth besides by chance.

    By so much simulated flights differ from the same vehicle linearised, sampled at every step of their controller:
    the effect changes with the tilt in wind, and rotors spin up twice as fast as they slow down.
    """

    # times the likelihood's standard deviation: the wind's spectrum is not quite that of the model
    own: float = 3.0
    effect: float = 0.02  # of all motors together, as a share of the effect
    motor: float = 0.015  # of each by itself, likewise
    damping: float = 0.3  # 1/s
    lag: float = 0.08  # as a share of the lag
    delay: float = 0.002  # s
    unknown_effect: float = 0.4  # of an effect that is not identifiable, as a share of it
    # of an effect that is biased by wind, as a share: likely, and as uncertain
    wind_bias: float = -0.15
    # likewise where the lag is not resolved: what delays the rate, as a filter, adds to it
    lag_bias: float = 0.1
    lag_damping: float = 1.2  # 1/s, of damping there
    # of an effect: by the battery's voltage and the load, as a share of it
    between_flights: float = 0.1
    slow_effect: float = 0.05  # below ``SLOWEST_RATE``, as a share
    slow: float = 0.3  # of damping and lag there, likewise
    # of the wind's torque, as a share of its sd: drag and cross-coupling are not modelled
    wind: float = 0.15
    wind_sd: float = 0.1  # of its sd and of its mean, likewise


MODEL_ERRORS = ModelErrors()


class NotIdentifiable(NamedTuple):
    """There are no physical parameters: ``reason``, one sentence, says why."""

    reason: str


class IdentifiabilityFigures(NamedTuple):
    """What decides whether parameters are identifiable; dictionaries by name of parameter."""

    # of the wind's torque, in the variance of its sum with the motors', in the roll motion's band
    wind_share: float
    # share of the commands' variance that is above half of the Nyquist frequency
    alias_share: float
    sd: dict[str, float]  # relative standard deviation of the estimate, by ``ModelErrors.own``
    # relative standard deviation that the spread between windows adds to that of the mean
    window_sd: dict[str, float]
    spectrum_range: dict[str, float]  # of the logarithm, over the wind's possible spectra
    damping: float  # estimate, 1/s
    lag: float  # estimate beyond the shortest that a stream can hold, s
    dt: float  # step of the stream, s

    @property
    def quick(self) -> bool:
        """Whether the motors are quicker than the stream, at ``SLOWEST_RATE`` or more."""
        return self.lag < self.dt <= 1 / SLOWEST_RATE


def identifiability(figures: IdentifiabilityFigures) -> tuple[dict[str, Status], dict[str, str]]:
    """Returns status and reason by name of parameter; the reason is empty where nothing is to be said."""
    statuses: dict[str, Status] = {}
    reasons: dict[str, str] = {}
    for name in PARAMETERS:
        obstacles = [each for each in _obstacles(name, figures) if each[0] != "reported"]
        effect = statuses.get("effect", "reported")
        if effect != "reported" and not any(status == effect for status, _ in obstacles):
            # A wrong effect is made up for by a wrong lag.
            obstacles.append(
                (effect, f"This follows from the control effectiveness, which is {effect}.")
            )
        order: tuple[Status, ...] = ("not identifiable", "biased")
        statuses[name] = next((status for status in order if status in dict(obstacles)), "reported")
        reasons[name] = " ".join(reason for status, reason in obstacles if status == statuses[name])
    return statuses, reasons


def _obstacles(name: str, figures: IdentifiabilityFigures) -> Iterator[tuple[Status, str]]:
    share = figures.wind_share
    sd = figures.sd[name]
    spread = figures.spectrum_range[name]
    by_wind = WIND_SHARE.status(share)
    low = f" The effectiveness may be off by {-200 * MODEL_ERRORS.wind_bias:.0f} %, mostly low."
    why = (
        f"Wind and noise have {100 * share:.0f} % of the torque's variance, and the autopilot answers them with the "
        "motors (closed loop): fly quick inputs on this axis (doublets, or a sweep of about 3°) in calm air, until "
        f"they have at most {100 * WIND_SHARE.reported:.0f} %."
    )
    yield by_wind, why + (low if by_wind == "biased" and name == "effect" else "")
    if figures.alias_share > MAX_ALIAS_SHARE:
        fast = f"{100 * figures.alias_share:.0f} % of the motor commands' variance is too fast for {1 / figures.dt:.0f}"
        yield "not identifiable", f"{fast} Hz: record faster, or steer more."
    yield (
        RELATIVE_SD[name].status(sd),
        f"Its standard deviation is {100 * sd:.0f} %: fly longer, or steer more.",
    )
    if figures.window_sd[name] > RELATIVE_SD[name].reported:
        yield "biased", f"{CHANGED}: the table over time shows when."
    spectrum = "with the assumed spectrum of the wind"
    do = "steer more, or fly in calmer air."
    yield SPECTRUM_RANGE[name].status(spread), f"It changes by {_factor(spread)} {spectrum}: {do}"
    short = figures.lag < RESOLVED_LAG * figures.dt
    if name == "effect" and figures.spectrum_range["lag"] > SPECTRUM_RANGE["lag"].reported:
        why = f"The motor time constant changes by {_factor(figures.spectrum_range['lag'])} {spectrum}"
        yield (
            "biased" if short else "not identifiable",
            f"{why}, and the effectiveness with it: {do}",
        )
    if name == "effect" and figures.quick:
        why = "The motor time constant is shorter than a sample, so that the gyro's filter is taken for it"
        yield (
            "biased",
            f"{why}: the effectiveness may be off by {200 * MODEL_ERRORS.lag_bias:.0f} %, mostly high. Record faster.",
        )
    if name == "damping" and figures.damping > LARGEST_DAMPING:
        yield (
            "not identifiable",
            f"It is more than rotors in air can have, {LARGEST_DAMPING:.0f} 1/s.",
        )
    if name == "lag" and short:
        step = f"half a sample ({1e3 * figures.dt:.0f} ms)"
        yield "not identifiable", f"It is shorter than {step}: record faster."
    if name != "effect" and 1 / figures.dt < SLOWEST_RATE:
        why = f"At {1 / figures.dt:.0f} Hz the commands between samples are not known: it may be off by"
        yield (
            "biased",
            f"{why} {200 * MODEL_ERRORS.slow:.0f} %. Record at {SLOWEST_RATE:.0f} Hz or more.",
        )


def _factor(spread: float) -> str:
    """A range of the logarithm in words."""
    return f"{100 * np.expm1(spread):.0f} %" if spread < 1 else "more than a factor of 2"
