"""Loops in words: the verdict, the margins with their intervals, and the gains to set."""

from __future__ import annotations

from collections.abc import Mapping

from mavdem.condition.loop.loop import Advice, Loop
from mavdem.condition.loop.margins import OpenLoop
from mavdem.facts import Fact
from mavdem.report.blocks import Block, Sentence, Table, caution
from mavdem.report.numbers import rounded
from mavdem.report.words import go_on

FIGURES = {  # header, and what makes the unit shown, by name of the figure
    "crossover": ("crossover (Hz)", 1.0),
    "phase_margin": ("phase margin (°)", 1.0),
    "gain_margin": ("gain margin (dB)", 1.0),
    "delay_margin": ("delay margin (ms)", 1e3),
    "ms": ("largest sensitivity Ms", 1.0),
    "bandwidth": ("bandwidth, -3 dB (Hz)", 1.0),
    "rejection": ("motion per 100 °/s² torque (°/s, °)", 100.0),
}
# of the log's rate: the crossover up to which delay and time constant are known well enough
FASTEST = 0.15
NOT_CHECKED = (
    "bending of the frame, notch filters against it, and another battery voltage, load or propeller: the margins are "
    "those of this flight."
)


def tune_blocks(found: Mapping[str, Advice | Fact]) -> list[Block]:
    """Returns what is said of the loops by axis; a fact is why nothing is known of them."""
    blocks = list[Block]()
    for axis, advice in found.items():
        lead = f"{axis.capitalize()}:"
        if isinstance(advice, Fact):
            blocks.append(Sentence(str(advice), lead))
            continue
        loop = advice.before
        after = {"advised": advice.after} if advice.parameters else {}
        blocks += [
            Sentence(f"{advice.rating} {advice.sentence}", lead),
            *margin_tables({"now": loop, **after}),
        ]
        if loop.crossover * loop.record.dt > FASTEST:
            slow = f"A crossover at {loop.crossover:.0f} Hz is fast for a log at {1 / loop.record.dt:.0f} Hz"
            blocks.append(caution(f"{slow}: record faster, for delay and time constant."))
        blocks += [_measured(loop), *map(caution, loop.cautions)]
        blocks += _gains(advice) if advice.gains else []
    named = any(isinstance(advice, Advice) and advice.gains for advice in found.values())
    return [*blocks, *([Sentence(NOT_CHECKED, "Not checked:")] if named else [])]


def _measured(loop: Loop) -> Sentence:
    """How the response of the rate in flight fits the predicted one."""
    found = loop.measured
    lead = "Measured response:"
    if found is None:
        ask = "record ATTITUDE_TARGET, RATE or vehicle_rates_setpoint for 20 s of settled flight"
        return Sentence(f"too few setpoints of the rate to check the margins against: {ask}.", lead)
    if loop.agrees is None:
        return Sentence(f"{go_on(found.reason)}. The margins are not checked against it.", lead)
    low, high = found.band
    text = f"the flight's response of the rate to its setpoint fits the predicted one by {found.agreement:.0f} % from "
    text += (
        f"{low:g} to {high:.1f} Hz (100 % − NRMSE; {found.fit:.0f} % with the wind's part in it)."
    )
    return Sentence(text, lead)


def margin_tables(loops: Mapping[str, Loop]) -> list[Block]:
    """Returns a table of the rate loop and one of the attitude loop, a column for each of ``loops``."""
    tables = list[Block]()
    for which in ("rate", "attitude"):
        values = [getattr(one, which) for one in loops.values()]
        rows = [
            [name, *(_interval(one, key, unit) for one in values)]
            for key, (name, unit) in FIGURES.items()
        ]
        tables.append(Table([f"{which} loop (90 % interval)", *loops], rows))
    return tables


def _interval(loop: OpenLoop, name: str, scale: float) -> str:
    value = getattr(loop, name)
    (low, high) = getattr(loop, f"{name}_interval")
    return f"{rounded(scale * value)} ({rounded(scale * low)} to {rounded(scale * high)})"


def _gains(advice: Advice) -> list[Block]:
    rows = [
        [name, f"{gain.now:.4g}", f"{gain.set:.4g}", f"{gain.set / gain.now:.2f}"]
        for name, gain in advice.gains.items()
    ]
    before, after = (rounded(loop.lean_in_wind) for loop in (advice.before, advice.after))
    does = "the heading moves" if advice.before.axis == "yaw" else "it leans"
    expected = f"in the wind of this flight {does} by {after}° instead of {before}° "
    expected += "(standard deviation about the mean)."
    noise = "the log is too slow to show what the gyro's noise does to the motors: feel how warm they become."
    if advice.noise is not None:
        lowest, highest, now, then, by_d, heat = advice.noise
        noise = f"from {lowest:.0f} to {highest:.0f} Hz, the highest that the log shows, the gyro moves the demand by "
        noise += f"{100 * now:.2g} % of its range (D alone by {100 * by_d:.2g} %), "
        noise += f"with these gains by {100 * then:.2g} %. "
        noise += f"That heats the motors {heat:.2g} times as much: feel how warm they become."
    return [
        Table(["gain", "now", "set", "times"], rows),
        Sentence(expected, "To expect:"),
        Sentence(noise, "Noise:"),
    ]
