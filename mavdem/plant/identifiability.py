"""Identifiability: whether a flight determines effect, damping and lag, and the reason where it does not.

All limits and model errors of the room stand here. They were chosen on simulated flights of three vehicles in seven
winds, steered in four ways and not at all, and tried on as many others (``tools/validation/physical.py``;
docs/physical.md).
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mavdem.facts import Fact, Level
from mavdem.facts.identifiability import Status
from mavdem.facts.model import ParameterDoubt

PARAMETERS = ("effect", "damping", "lag")


class Limit(NamedTuple):
    """The largest figure up to which a parameter is reported, and up to which it is reported with a bias."""

    reported: float
    biased: float

    def status(self, figure: float) -> Status:
        """Returns what a figure makes of its parameter."""
        if figure <= self.reported:
            return Status.REPORTED
        return Status.BIASED if figure <= self.biased else Status.NOT_IDENTIFIABLE


WIND_SHARE = Limit(0.20, 0.29)  # of the wind, in the torque's variance
RELATIVE_SD = {"effect": Limit(0.08, 0.20), "damping": Limit(0.75, 0.75), "lag": Limit(0.25, 0.35)}
SPECTRUM_RANGE = {
    "effect": Limit(0.06, 0.30),
    "damping": Limit(0.60, 0.90),
    "lag": Limit(0.40, 0.40),
}
"""Of the logarithm of the estimate, over the spectra that the wind may have. An effect cannot be told from its lag."""
MAX_ALIAS_SHARE = 0.12  # of the commands' variance, above half of the Nyquist frequency
MIN_RESOLVED_RATE = 80.0  # Hz, below which the commands between samples matter
RESOLVED_LAG = 0.5  # steps of the stream: a shorter lag cannot be told from a delay


class OmissionErrors:
    """Standard deviations of what the model leaves out, by which estimates differ from the truth besides by chance.

    By so much simulated flights differ from the same vehicle linearised, sampled at every step of their controller:
    the effect changes with the tilt in wind, and rotors spin up twice as fast as they slow down.
    """

    # times the likelihood's standard deviation: the wind's spectrum is not quite that of the model
    own = 3.0
    effect = 0.02  # of all motors together, as a share of the effect
    motor = 0.015  # of each by itself, likewise
    damping = 0.3  # 1/s
    lag = 0.08  # as a share of the lag
    delay = 0.002  # s
    unknown_effect = 0.4  # of an effect that is not identifiable, as a share of it
    # of an effect that is biased by wind, as a share: likely, and as uncertain
    wind_bias = -0.15
    # likewise where the lag is not resolved: what delays the rate, as a filter, adds to it
    lag_bias = 0.1
    lag_damping = 1.2  # 1/s, of damping there
    # of an effect: by the battery's voltage and the load, as a share of it
    between_flights = 0.1
    # of the wind's torque, as a share of its sd: drag and cross-coupling are not modelled
    wind = 0.15
    wind_sd = 0.1  # of its sd and of its mean, likewise


class NotIdentifiable(NamedTuple):
    """There are no physical parameters: ``reason`` says why, and ``refusal`` why none in the loop."""

    reason: Fact
    refusal: Fact | None = None


class IdentifiabilityFigures(NamedTuple):
    """What decides whether parameters are identifiable; dictionaries by name of parameter."""

    # of the wind's torque, in the variance of its sum with the motors', in the roll motion's band
    wind_share: float
    # share of the commands' variance that is above half of the Nyquist frequency
    alias_share: float
    sd: dict[str, float]  # relative standard deviation of the estimate, by ``OmissionErrors.own``
    spectrum_range: dict[str, float]  # of the logarithm, over the wind's possible spectra
    lag: float  # estimate beyond the shortest that a stream can hold, s
    dt: float  # step of the stream, s

    @property
    def quick(self) -> bool:
        """Whether the motors are quicker than the stream, at ``MIN_RESOLVED_RATE`` or more."""
        return self.lag < self.dt <= 1 / MIN_RESOLVED_RATE


def identifiability(
    figures: IdentifiabilityFigures,
) -> tuple[dict[str, Status], dict[str, Fact | None]]:
    """Returns status and reason by name of parameter; ``None`` where nothing is to be said."""
    statuses = dict[str, Status]()
    reasons = {}
    for name in PARAMETERS:
        obstacles = [
            obstacle for obstacle in _obstacles(name, figures) if obstacle[0] != Status.REPORTED
        ]
        effect = statuses.get("effect", Status.REPORTED)
        if effect not in (Status.REPORTED, *(status for status, _ in obstacles)):
            # A wrong effect is made up for by a wrong lag.
            follows = Fact(ParameterDoubt.FOLLOWS_FROM_EFFECT, status=effect)
            obstacles.append((effect, follows))
        is_unknown = any(status == Status.NOT_IDENTIFIABLE for status, _ in obstacles)
        worst = Status.NOT_IDENTIFIABLE if is_unknown else Status.BIASED
        level = Level.UNKNOWN if is_unknown else Level.WATCH
        doubts = [doubt for status, doubt in obstacles if status == worst]
        statuses[name] = worst if doubts else Status.REPORTED
        reasons[name] = doubts[0].but(level) if doubts else None
        if len(doubts) > 1:
            reasons[name] = Fact(ParameterDoubt.SEVERAL_DOUBTS, level, because=doubts)
    return statuses, reasons


def _obstacles(name: str, figures: IdentifiabilityFigures) -> Iterator[tuple[Status, Fact]]:
    """What stands in the way of a parameter, with the status that it leaves; some may leave "reported"."""
    rate = 1 / figures.dt
    spread = figures.spectrum_range[name]
    by_wind = WIND_SHARE.status(figures.wind_share)
    is_low = by_wind == Status.BIASED and name == "effect"
    yield (
        by_wind,
        Fact(
            ParameterDoubt.WIND_SHARE_HIGH,
            share=figures.wind_share,
            share_limit=WIND_SHARE.reported,
            bias=OmissionErrors.wind_bias if is_low else None,
        ),
    )
    if figures.alias_share > MAX_ALIAS_SHARE:
        aliased = Fact(ParameterDoubt.COMMANDS_TOO_FAST, share=figures.alias_share, rate=rate)
        yield Status.NOT_IDENTIFIABLE, aliased
    sd = figures.sd[name]
    yield RELATIVE_SD[name].status(sd), Fact(ParameterDoubt.ESTIMATE_UNCERTAIN, share=sd)
    # the relative change that this logarithm is; none beyond a factor of e
    changes = Fact(
        ParameterDoubt.DEPENDS_ON_WIND_SPECTRUM, share=np.expm1(spread) if spread < 1 else None
    )
    yield SPECTRUM_RANGE[name].status(spread), changes
    least = RESOLVED_LAG * figures.dt
    if name == "effect" and figures.quick:
        yield (
            Status.BIASED,
            Fact(ParameterDoubt.FILTER_TAKEN_FOR_LAG, bias=OmissionErrors.lag_bias),
        )
    if name == "lag" and figures.lag < least:
        too_short = Fact(ParameterDoubt.LAG_TOO_SHORT, time_step=figures.dt)
        yield Status.NOT_IDENTIFIABLE, too_short
    # Up to five times that, slow streams mix it up with delay and damping.
    if name != "effect" and rate < MIN_RESOLVED_RATE and figures.lag < 5 * least:
        yield Status.BIASED, Fact(ParameterDoubt.MIXED_WITH_DELAY, rate=rate)
