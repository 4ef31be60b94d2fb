#!/usr/bin/env python
"""What each manoeuvre identifies, by its length; prints a table.

The 3DR Iris is flown once by each manoeuvre, in each wind and for each length, at 100 Hz. A cell has the half width of
the 90 % interval over the estimate, b where it is biased, - where it is not identifiable. The wind's level is that of
Dryden turbulence, light by MIL-F-8785C.

Usage: tools/validation/manoeuvres.py [--seed N]
"""

from __future__ import annotations

import click

from mavdem.dem import physical
from mavdem.errors import NotLearnable
from mavdem.paper.flights import logged
from sitl_scenarios.files import scenario_of

MANOEUVRES = {
    "none": None,
    "doublets of 6°, 0.4 s each way, every 3 s": {"kind": "doublets", "amplitude": 6, "width": 0.4, "period": 3},
    "sweep of 3°, 0.2 to 5 Hz in 10 s": {"kind": "chirp", "amplitude": 3, "lowest": 0.2, "highest": 5, "period": 10},
    "sines together, 3° sd, 0.2 to 5 Hz": {"kind": "multisine", "sd": 3, "lowest": 0.2, "highest": 5, "period": 10},
    "sticks without rest, 5° sd": {"kind": "sticks", "sd": 5, "s": 0.25},
    "side steps of 2 m, every 5 s": {"kind": "steps", "distance": 2, "period": 5},
}
WINDS = {"calm": [], "light wind": [{"kind": "dryden", "speed": 3, "direction": 90, "wind_at_20_feet": 7.7}]}
SECONDS = {10: 30.0, 25: 45.0, 55: 75.0}  # of settled flight, and from arming to disarming
MARKS = {"reported": "", "biased": " b"}


def cells(manoeuvre: str, wind: str, duration: float, seed: int) -> str:
    """Relative half widths of effect, damping and lag, %."""
    values = {"vehicle": {"model": "iris"}, "wind": WINDS[wind], "duration": duration, "seed": seed}
    if excitation := MANOEUVRES[manoeuvre]:
        values["excitation"] = excitation
    if manoeuvre.startswith("sticks"):
        values["stream"] = {"rates": {"RC_CHANNELS": 50}}
    try:
        found = physical(logged(scenario_of(values)))
    except NotLearnable:
        return "nothing moves"
    effect, damping, lag, _ = found.interval(0.9)
    numbers = {
        "effect": float((effect / abs(found.effect)).mean()),
        "damping": damping / found.damping,
        "lag": lag / found.lag,
    }
    shown = (
        "-" if (mark := MARKS.get(found.status[name])) is None else f"{100 * number:.0f}{mark}"
        for name, number in numbers.items()
    )
    return ", ".join(shown)


@click.command(help=__doc__)
@click.option("--seed", default=1, show_default=True)
def main(seed: int) -> None:
    print("| manoeuvre | wind | " + " | ".join(f"{settled} s" for settled in SECONDS) + " |")
    print("|---|---|" + "---|" * len(SECONDS))
    for manoeuvre in MANOEUVRES:
        for wind in WINDS:
            row = (cells(manoeuvre, wind, duration, seed) for duration in SECONDS.values())
            print(f"| {manoeuvre} | {wind} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
