"""Loops in words: their rating, the margins with their intervals, and the gains to set."""

from collections.abc import Iterator
from operator import attrgetter

from mavdem.assessment.axis.tuning import AdviceByAxis, Tuning
from mavdem.facts import Fact
from mavdem.loops.advice import MAX_ANGLE_GAIN, MAX_GAIN_STEP, Advice
from mavdem.loops.axis_loops import LoopsByAxis
from mavdem.loops.filters import gyro_filters
from mavdem.loops.margins import OpenLoop
from mavdem.report.blocks import Blocks, Sentence, Table, caution
from mavdem.report.numbers import rounded
from mavdem.report.templates import render_section, sentences_by_axes

LOOP_FIGURES = {  # header, and what makes the unit shown, by name of the figure
    "crossover": ("crossover (Hz)", 1.0),
    "phase_margin": ("phase margin (°)", 1.0),
    "gain_margin": ("gain margin (dB)", 1.0),
    "delay_margin": ("delay margin (ms)", 1e3),
    "ms": ("maximum sensitivity Ms", 1.0),
    "bandwidth": ("bandwidth, -3 dB (Hz)", 1.0),
    "rejection": ("motion per 100 °/s² torque (°/s, °)", 100.0),
}
# of the log's rate: the crossover up to which delay and time constant are known well enough
KNOWN_CROSSOVER_SHARE = 0.15


def tune_blocks(tuning: Tuning, whole: bool = True) -> Blocks:
    """Returns what is said of the loops by axis; a fact is why nothing is known of them.

    Unless ``whole``, that is a sentence each, the gains to set, and what for and what limits them. What to do is said
    once, and not where the next step says it, which stands beside.
    """
    blocks = Blocks()
    is_advised = False
    advised = tuning.axes
    following = tuning.judgement.next_step
    asked = [following.figures.get("because"), *following.figures.get("also", ())]
    said = {"", following.sentence, *(fact.remedy for fact in asked if fact)}
    for axis, advice in advised.items():
        facts = [advice] if isinstance(advice, Fact) else [advice.rating, advice.sentence]
        remedies = {facts[-1].remedy} - said
        said |= remedies
        blocks.append(Sentence(" ".join([*map(str, facts), *remedies]), f"{axis.capitalize()}:"))
        if isinstance(advice, Fact):
            continue
        is_advised |= bool(advice.gains)
        if whole:
            blocks += [*_loop_blocks(advice), *gain_blocks(advice)]
        else:
            blocks += gain_blocks(advice)[:2]
    if not whole:
        blocks += gain_limits(advised)
    return [*blocks, *render_section("loop_not_checked", named=is_advised and whole)]


def gain_limits(advised: AdviceByAxis) -> Blocks:
    """Returns what limits gains that change, of the loops that they were found by."""
    cautions = [
        (axis, caution)
        for axis, advice in advised.items()
        if isinstance(advice, Advice) and advice.parameters
        for caution in advice.before.cautions
    ]
    return [*sentences_by_axes(cautions, attrgetter("advised"))]


def compared_loops(advice: Advice) -> LoopsByAxis:
    """Returns the loop now and, where gains are advised, with these."""
    after = {"advised": advice.after} if advice.parameters else {}
    return {"now": advice.before, **after}


def _loop_blocks(advice: Advice) -> Blocks:
    """The margins, now and as advised, and what they rest on."""
    loop = advice.before
    blocks: Blocks = [*margin_tables(compared_loops(advice))]
    if loop.crossover * loop.record.dt > KNOWN_CROSSOVER_SHARE:
        (slow,) = render_section("loop_too_fast", crossover=loop.crossover, rate=1 / loop.record.dt)
        blocks.append(caution(slow.text))
    filters = gyro_filters(loop.controller, loop.crossover)
    blocks += render_section("loop_filters", filters=filters, crossover=loop.crossover)
    return [*blocks, *render_section("loop_measured", loop=loop), *map(caution, loop.cautions)]


def margin_tables(loops: LoopsByAxis) -> Iterator[Table]:
    """Yields a table of the rate loop and one of the attitude loop, a column for each of ``loops``."""
    for which in ("rate", "attitude"):
        values = [getattr(loop, which) for loop in loops.values()]
        rows = [
            [name, *(_interval(value, key, unit) for value in values)]
            for key, (name, unit) in LOOP_FIGURES.items()
        ]
        yield Table([f"{which} loop (90 % interval)", *loops], rows)


def _interval(loop: OpenLoop, name: str, scale: float) -> str:
    value = getattr(loop, name)
    ends = [rounded(scale * end) for end in getattr(loop, f"{name}_interval")]
    shown = rounded(scale * value)
    return shown if "-" in ends else f"{shown} ({ends[0]} to {ends[1]})"


def gain_blocks(advice: Advice) -> Blocks:
    """Returns the gains to set, where they change, and what to expect of them."""
    factors = {
        name: gain.set / gain.now
        for name, gain in advice.gains.items()
        if f"{gain.now:.4g}" != f"{gain.set:.4g}"
    }
    rows = [
        [name, *(f"{value:.4g}" for value in advice.gains[name]), f"{factor:.2f}"]
        for name, factor in factors.items()
    ]
    tables = [Table(["gain", "now", "set", "times"], rows)] if rows else []
    why = render_section(
        "loop_gains",
        advice=advice,
        names=advice.before.controller.parameter_names,
        falling=[name for name, factor in factors.items() if factor < 1],
        rising=[name for name, factor in factors.items() if factor > 1],
        farthest=[
            name
            for name, factor in factors.items()
            if max(factor, 1 / factor) > 0.999 * MAX_GAIN_STEP
        ],
        largest=MAX_ANGLE_GAIN[advice.before.axis],
    )
    return [*tables, *why]
