"""Cautions: what makes a model of a segment less reliable, one sentence each."""

from __future__ import annotations

from mavdem.alignment.columns import MAX_BODY_RATE
from mavdem.alignment.drive import DEMAND_MESSAGE, TILT_AXES
from mavdem.alignment.quality import QualityFigures
from mavdem.alignment.signals import MINIMUM_RATE, Signals, usual_rate

DOUBTFUL_SNR = 20.0
"""Variance of the outputs' changes over that of their rounding. Rounding what something is learnt from can shrink what
is learnt to SNR/(1 + SNR) of the truth: by 5 % at 20."""
DOUBTFUL_CONSISTENCY = 0.8
"""Share of the angle's changes over 0.2 s that the integrated rates explain. Both measure one motion; where they
disagree, some of the rate is an alias, or noise."""
DOUBTFUL_UPPER_BAND = 0.5
"""Share of the rate's variance above half the Nyquist frequency. White noise has a half, so nothing has decayed by
there."""
DOUBTFUL_LOSS = 0.05  # Share of a stream's messages left out as damaged: the rest may be too
IMPOSSIBLE = f"an angle beyond 2π or a rate beyond {MAX_BODY_RATE:.0f} rad/s"


def measured(axis: str, between: str) -> str:
    """What a flight of ``axis`` has, in words: "roll angle or rate"."""
    return f"{axis} angle {between} rate" if axis in TILT_AXES else f"{axis} rate"


def steps(axis: str, figures: QualityFigures) -> str:
    """The quantisation steps of that."""
    angle = f"{figures.angle_step:.2g} rad and " if axis in TILT_AXES else ""
    return f"{angle}{figures.rate_step:.2g} rad/s"


def losses(signals: Signals) -> tuple[str, ...]:
    """Sentences on messages of attitude and inputs, of which there must be some, that were left out."""
    attitude, drive, called, cautions = signals.attitude, signals.drive, signals.telemetry.called, []
    assert attitude is not None and drive is not None
    if attitude.impossible:
        cautions.append(
            f"{attitude.impossible} of {attitude.sent} {called(attitude.message)} messages were left out, for "
            f"{IMPOSSIBLE}."
        )
    for stream in (attitude, drive):
        if stream.left_out > DOUBTFUL_LOSS * stream.sent:
            cautions.append(
                f"{stream.left_out} of {stream.sent} {called(stream.message)} messages were left out: their time "
                "stamps are far off or those of others, or their numbers make no sense."
            )
    return tuple(cautions)


def cautions_of(signals: Signals, figures: QualityFigures) -> tuple[str, ...]:
    """Sentences on a segment of ``figures``."""
    axis, drive, cautions = signals.axis, signals.drive, []
    assert drive is not None
    layout = drive.layout
    if drive.message == DEMAND_MESSAGE:
        rate = 0.0 if signals.motors is None else usual_rate(signals.motors)
        slowly = f"come too slowly ({below(rate, MINIMUM_RATE)} Hz)" if rate else "are missing"
        lead = "The" if rate >= MINIMUM_RATE else f"Motor outputs {slowly}, so the"
        cautions.append(
            f"{lead} input is the controller's {axis} demand, and the model includes the mixer, the motors' limits "
            "and the battery."
        )
    if signals.telemetry.vehicle == "UNKNOWN":
        cautions.append("No heartbeat says what the vehicle is: a multirotor was assumed.")
    if layout.channels_assumed or layout.positions_assumed:
        cautions.append(f"Which motor is which was assumed: {layout.basis}.")
    if figures.output_snr is not None and figures.output_snr < DOUBTFUL_SNR:
        cautions.append(
            f"The {measured(axis, 'or')} is near the resolution of the stream (steps of {steps(axis, figures)}): "
            "rounding can shrink what is learnt of the dynamics by "
            f"{min(1.0, 1 / (1 + figures.output_snr)):.0%}."
        )
    if figures.consistency is not None and figures.consistency < DOUBTFUL_CONSISTENCY:
        cautions.append(f"The rate explains only {figures.consistency:.2f} of the angle's changes: noise, or an alias.")
    if figures.upper_band is not None and figures.upper_band > DOUBTFUL_UPPER_BAND:
        cautions.append(
            f"{figures.upper_band:.0%} of the {axis} rate's variance lies in the upper half of the band: something "
            "faster is probably aliased into it."
        )
    return tuple(cautions)


def below(value: float, limit: float) -> str:
    """The value with as many decimals, at least one, as show that it is below the limit."""
    return next((text for digits in range(1, 6) if float(text := f"{value:.{digits}f}") < limit), f"{value:.6g}")
