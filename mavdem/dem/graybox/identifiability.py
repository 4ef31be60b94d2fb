"""Identifiability: whether a flight determines effect, damping and lag, and the reason where it does not.

The limits were chosen on simulated flights of three vehicles in seven winds, steered in three ways and not at all, and
tried on as many others (``tools/validation/physical.py``; docs/physical.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

Status = Literal["reported", "biased", "not identifiable"]
PARAMETERS = ("effect", "damping", "lag")

REPORTED_SHARE, BIASED_SHARE = 0.25, 0.40
"""Wind's share, up to which parameters are reported, and reported with a bias."""
REPORTED_SD, BIASED_SD = {"effect": 0.10, "damping": 0.50, "lag": 0.25}, {"effect": 0.20, "damping": 0.50, "lag": 0.35}
"""Relative standard deviation, likewise."""
REPORTED_SPREAD = {"effect": 0.10, "damping": 0.60, "lag": 0.40}
BIASED_SPREAD = {"effect": 0.30, "damping": 0.90, "lag": 0.60}
"""Range of the logarithm over the wind's possible spectra, likewise."""
MAX_ALIASED = 0.12  # share of the commands' variance above half of the Nyquist frequency
SLOWEST_RATE = 80.0  # Hz, below which the commands between samples matter
SLOW_BIAS = -0.08  # of the effect, typically, there
SLOW_SD = 0.3  # relative standard deviation of what that does to damping and lag
WIND_BIAS_SD = 0.1
"""Relative standard deviation of the effect's bias between ``REPORTED_SHARE`` and ``BIASED_SHARE``: more often it comes
out high than low."""
LARGEST_DAMPING = 15.0  # 1/s, beyond which the estimate is near its bound
RESOLVED_LAG = 0.5  # steps of the stream
BOUND = 0.8  # of the prior's standard deviation: what little the flight says of a parameter


CHANGED = "It differs from window to window by more than chance"


class IdentifiabilityFigures(NamedTuple):
    """What decides whether parameters are identifiable; dictionaries by name of parameter.

    Attributes:
        wind_share: of the wind's torque, in the variance of its sum with the motors', in the band of the roll motion.
        aliased: share of the commands' variance that is above half of the Nyquist frequency.
        sd: relative standard deviation of the estimate by itself.
        changed: relative standard deviation that the spread between windows adds to that of their mean.
        spread: range of the logarithm over the wind's possible spectra.
        prior: standard deviation of the logarithm beforehand.
        damping: estimate, 1/s.
        lag: estimate beyond the shortest that a stream can hold, s.
        dt: step of the stream, s.
        steered: share of the torque's variance that the setpoints explain; ``None`` where there are none.
    """

    wind_share: float
    aliased: float
    sd: dict[str, float]
    changed: dict[str, float]
    spread: dict[str, float]
    prior: dict[str, float]
    damping: float
    lag: float
    dt: float
    steered: float | None = None


def judged(figures: IdentifiabilityFigures) -> tuple[dict[str, Status], dict[str, str]]:
    """Status and reason by name of parameter; the reason is empty where nothing is to be said."""
    statuses: dict[str, Status] = {}
    reasons: dict[str, str] = {}
    for name in PARAMETERS:
        found = list(_obstacles(name, figures))
        effect = statuses.get("effect", "reported")
        if effect != "reported" and not any(status == effect for status, _ in found):
            # A wrong effect is made up for by a wrong lag.
            found.append((effect, f"The effect is {effect}, and what is wrong with it is wrong with this."))
        order: tuple[Status, ...] = ("not identifiable", "biased")
        statuses[name] = next((status for status in order if any(status == each for each, _ in found)), "reported")
        reasons[name] = " ".join(reason for status, reason in found if status == statuses[name])
    return statuses, reasons


def _obstacles(name: str, figures: IdentifiabilityFigures) -> Iterator[tuple[Status, str]]:
    share, sd, spread = figures.wind_share, figures.sd[name], figures.spread[name]
    if share > REPORTED_SHARE:
        too_much = share > BIASED_SHARE
        yield (
            "not identifiable" if too_much else "biased",
            f"The wind has {share:.0%} of the torque's variance, and the motors answer it (closed loop): fly quick "
            f"inputs on this axis (doublets, or a sweep of about 3°) in calm air, until it has {REPORTED_SHARE:.0%}."
            + (
                ""
                if too_much or name != "effect"
                else f" The effect may be off by {2 * WIND_BIAS_SD:.0%}, mostly high."
            ),
        )
    if figures.aliased > MAX_ALIASED:
        yield (
            "not identifiable",
            f"{figures.aliased:.0%} of the motor commands' variance is too fast for {1 / figures.dt:.0f} Hz: record "
            "faster, or steer more.",
        )
    if sd > BOUND * figures.prior[name]:
        yield "not identifiable", "The flight says hardly more of it than is known of any multirotor: steer more."
    elif sd > BIASED_SD[name]:
        yield "not identifiable", f"Its standard deviation is {sd:.0%}: fly longer, or steer more."
    elif sd > REPORTED_SD[name]:
        yield "biased", f"Its standard deviation is {sd:.0%}: fly longer, or steer more."
    if figures.changed[name] > REPORTED_SD[name]:
        yield "biased", f"{CHANGED}: the table over time shows when."
    if spread > REPORTED_SPREAD[name]:
        yield (
            "not identifiable" if spread > BIASED_SPREAD[name] else "biased",
            f"It changes by {_factor(spread)} with the spectrum that the wind is taken to have: steer more, or fly in "
            "calmer air.",
        )
    if name == "effect" and figures.spread["lag"] > REPORTED_SPREAD["lag"]:
        yield (
            "not identifiable",
            f"The lag changes by {_factor(figures.spread['lag'])} with the spectrum that the wind is taken to have, "
            "and the effect cannot be told from it: steer more, or fly in calmer air.",
        )
    if name == "damping" and figures.damping > LARGEST_DAMPING:
        yield "not identifiable", f"It is at the bound of what rotors in air can do, {LARGEST_DAMPING:.0f} 1/s."
    if name == "lag" and figures.lag < RESOLVED_LAG * figures.dt:
        yield (
            "not identifiable",
            f"It is shorter than half a step of the stream ({1e3 * figures.dt:.0f} ms): record faster.",
        )
    if 1 / figures.dt < SLOWEST_RATE:
        yield (
            "biased",
            f"At {1 / figures.dt:.0f} Hz the commands between samples are not known: the effect is low by about "
            f"{-SLOW_BIAS:.0%}, damping and lag may be off by {2 * SLOW_SD:.0%}. Record at {SLOWEST_RATE:.0f} Hz or "
            "more.",
        )


def _factor(spread: float) -> str:
    """A range of the logarithm in words."""
    return f"{np.expm1(spread):.0%}" if spread < 1 else "more than a factor of 2"
