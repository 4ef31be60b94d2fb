"""Loops in words: the verdict, the margins with their intervals, the gains to set, and the page of ``mavdem tune``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

from mavdem.condition.loop import Advice, Loop, OpenLoop, verdict
from mavdem.errors import downstream
from mavdem.report.blocks import Block, Sentence, Table
from mavdem.report.numbers import rounded
from mavdem.report.page import Chapter, Picture, document

FIGURES = {  # header, and what makes the unit shown, by name of the figure
    "crossover": ("crossover (Hz)", 1.0),
    "phase_margin": ("phase margin (°)", 1.0),
    "gain_margin": ("gain margin (dB)", 1.0),
    "delay_margin": ("delay margin (ms)", 1e3),
    "ms": ("largest sensitivity Ms", 1.0),
    "bandwidth": ("bandwidth, -3 dB (Hz)", 1.0),
}
REJECTION = {"rate": ("rate by a torque (°/s per °/s²)", 1.0), "attitude": ("lean by a torque (° per °/s²)", 1.0)}


class Tuned(NamedTuple):
    """What a log says of the loops about one axis: the ``loop``, and the ``advice``, or why there is none."""

    loop: Loop | None
    advice: Advice | None
    refusal: str


def tuned_blocks(axis: str, tuned: Tuned) -> list[Block]:
    """Returns the verdict, margins now and with the gains advised, these gains, and what to expect."""
    loop, advice, lead = tuned.loop, tuned.advice, f"{axis.capitalize()}:"
    if loop is None:
        return [Sentence(tuned.refusal, lead)]
    blocks: list[Block] = [Sentence(f"{verdict(loop)} {tuned.refusal or advice and advice.sentence}", lead)]
    loops = [loop] if advice is None or not advice.parameters else [loop, advice.after]
    columns = [(f"{which} loop{', advised' * number}", getattr(one, which)) for which in REJECTION for number, one in enumerate(loops)]
    rows = [[name, *(_interval(one, figure, scale) for _, one in columns)] for figure, (name, scale) in FIGURES.items()]
    rejections = [_interval(one, "rejection", 1.0) for _, one in columns]
    rows.append(["largest response to a torque (s, s²)", *rejections])
    blocks.append(Table(["90 % interval in brackets", *(name for name, _ in columns)], rows))
    blocks += [Sentence(caution, "Caution:") for caution in loop.cautions]
    return blocks + ([] if advice is None else _advice_blocks(advice))


def _advice_blocks(advice: Advice) -> list[Block]:
    gains = [[name, f"{old:.4g}", f"{new:.4g}", f"{new / old:.2f}"] for name, (old, new) in advice.gains.items()]
    before, after = advice.before, advice.after
    expected = f"in the wind of this flight it leans by {rounded(after.lean_in_wind)}° instead of "
    expected += f"{rounded(before.lean_in_wind)}° (standard deviation about the mean)."
    blocks: list[Block] = [Table(["gain", "now", "set", "times"], gains), Sentence(expected, "To expect:")]
    if advice.noise is None:
        noise = "The log is too slow to show the noise of the gyro, which D passes on to the motors: feel how warm they get."
    else:
        lowest, highest, now, then, by_d = advice.noise
        noise = f"from {lowest:.0f} to {highest:.0f} Hz, which is all that the log shows, the gyro moves the demand by "
        noise += f"{100 * now:.2g} % of its range, D alone by {100 * by_d:.2g} %; with these gains by {100 * then:.2g} %. "
        noise += f"What that heats the motors by grows with the square, {advice.noise.heat:.2g} times: feel how warm they get."
    return [*blocks, Sentence(noise, "Noise:"), Sentence(advice.not_checked, "Not checked:")]


def _interval(loop: OpenLoop, name: str, scale: float) -> str:
    value, (low, high) = getattr(loop, name), getattr(loop, f"{name}_interval")
    return f"{rounded(scale * value)} ({rounded(scale * low)} to {rounded(scale * high)})"
