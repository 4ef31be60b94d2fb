"""Loops in words: the verdict, the margins with their intervals, and the gains to set."""

from __future__ import annotations

from collections.abc import Mapping

from mavdem.condition.loop import NOT_CHECKED, Advice, OpenLoop, Tuned, verdict
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import rounded

FIGURES = {  # header, and what makes the unit shown, by name of the figure
    "crossover": ("crossover (Hz)", 1.0),
    "phase_margin": ("phase margin (°)", 1.0),
    "gain_margin": ("gain margin (dB)", 1.0),
    "delay_margin": ("delay margin (ms)", 1e3),
    "ms": ("largest sensitivity Ms", 1.0),
    "bandwidth": ("bandwidth, -3 dB (Hz)", 1.0),
    "rejection": ("moves by 100 °/s² of torque (°/s, °)", 100.0),
}
LOOPS = ("rate", "attitude")


def tune_blocks(found: Mapping[str, Tuned]) -> list[Block]:
    """Returns all that is said of the loops, by axis, and what was not checked of the gains."""
    blocks = [block for axis, one in found.items() for block in tuned_blocks(axis, one)]
    return [*blocks, *([Sentence(NOT_CHECKED, "Not checked:")] if any(one.advice for one in found.values()) else [])]


def tuned_blocks(axis: str, tuned: Tuned) -> list[Block]:
    """Returns the verdict, margins now and with the gains advised, these gains, and what to expect of them."""
    loop, advice, lead = tuned.loop, tuned.advice, f"{axis.capitalize()}:"
    if loop is None:
        return [Sentence(tuned.refusal, lead)]
    said = tuned.refusal if advice is None else advice.sentence
    loops = [("now", loop), *([("advised", advice.after)] if advice is not None and advice.parameters else [])]
    tables = []
    for which in ("rate", "attitude"):
        values = [getattr(one, which) for _, one in loops]
        rows = [[name, *(_interval(one, key, unit) for one in values)] for key, (name, unit) in FIGURES.items()]
        tables.append(Table([f"{which} loop (90 % interval)", *(when for when, _ in loops)], rows))
    blocks: list[Block] = [Sentence(f"{verdict(loop)} {said}", lead), *tables]
    blocks += [Sentence(caution, "Caution:") for caution in loop.cautions]
    return blocks if advice is None else blocks + _advice_blocks(advice)


def _advice_blocks(advice: Advice) -> list[Block]:
    gains = [[name, f"{old:.4g}", f"{new:.4g}", f"{new / old:.2f}"] for name, (old, new) in advice.gains.items()]
    before, after = advice.before, advice.after
    does = "the heading moves" if before.axis == "yaw" else "it leans"
    expected = f"in the wind of this flight {does} by {rounded(after.lean_in_wind)}° instead of "
    expected += f"{rounded(before.lean_in_wind)}° (standard deviation about the mean)."
    blocks: list[Block] = [Table(["gain", "now", "set", "times"], gains), Sentence(expected, "To expect:")]
    noise = "the log is too slow to show what the gyro's noise does to the motors: feel how warm they get."
    if advice.noise is not None:
        lowest, highest, now, then, by_d, heat = advice.noise
        noise = f"from {lowest:.0f} to {highest:.0f} Hz, which is all that the log shows, the gyro moves the demand by "
        noise += (
            f"{100 * now:.2g} % of its range (D alone by {100 * by_d:.2g} %), and with these gains by {100 * then:.2g} "
        )
        noise += f"%. The heat of that in the motors grows with the square, {heat:.2g} times: feel them."
    return [*blocks, Sentence(noise, "Noise:")]


def _interval(loop: OpenLoop, name: str, scale: float) -> str:
    value, (low, high) = getattr(loop, name), getattr(loop, f"{name}_interval")
    return f"{rounded(scale * value)} ({rounded(scale * low)} to {rounded(scale * high)})"
