"""The physical range of every figure of a fact, by its unit or its name: what is outside is never printed."""

import math

from mavdem.facts import Fact

RANGES_BY_UNIT = {
    "m/s": (-60.0, 60.0),
    "m": (-1000.0, 10_000.0),
    "rad": (-math.pi, math.pi),
    "°": (-180.0, 360.0),
    "rad/s": (0.0, math.radians(4000.0)),
    "m/s²": (0.0, 1000.0),
    "V": (0.0, 1000.0),
    "A": (0.0, 2000.0),
    "Ω": (0.0, 10.0),
    "1/min": (0.0, 500_000.0),
    "Hz": (0.0, 50_000.0),
}
"""Least and largest value of a figure by its unit.

No multirotor exceeds 60 m/s, 10 km or 4000 °/s, the range of gyros; angles are within half a turn, and a knock within
the 100 g of the widest accelerometers.
"""

RANGES_BY_NAME = {
    "share": (0.0, 1.0),
    "share_before": (0.0, 1.0),
    "share_limit": (0.0, 1.0),
    "used_share": (0.0, 1.0),
    "probability": (0.0, 1.0),
    "coherence": (0.0, 1.0),
    "correlation": (-1.0, 1.0),
    "loss": (0.0, 1.0),
    "headroom": (0.0, 1.0),
    "collective": (0.0, 1.0),
    "excess": (0.0, 1.0),
    "bounds": (0.0, 1.0),
    "trim": (0.0, 1.0),
    "overshoot": (0.0, 1.0),
    "cells": (1.0, 14.0),
    "satellites": (0.0, 60.0),
    "dilution": (0.0, 100.0),
    "count": (0.0, math.inf),
    "clips": (0.0, math.inf),
    "duration": (0.0, math.inf),
    "change": (-1.0, 100.0),
}
"""The same by the name of the figure, where its unit alone does not bound it."""

RANGES_BY_FACT = {
    # The margin over the one that is wanted.
    ("loop_margins", "share"): (0.0, math.inf),
    # Positive for motors that turn counterclockwise.
    ("trim_of_yaw", "share"): (-1.0, 1.0),
}
"""The same for figures of single codes that have another meaning."""

CELL_VOLTAGES = (2.0, 4.5)
"""Voltages, V, of a lithium cell that is not destroyed."""


def figures_out_of_range(fact, path=""):
    """Returns a text for each figure of a fact, and of the facts within it, that is outside its physical range."""
    name_of_fact = f"{path}{fact.code}"
    texts = []
    for name, value in fact.figures.items():
        limits = (
            RANGES_BY_FACT.get((fact.code, name))
            or RANGES_BY_NAME.get(name)
            or RANGES_BY_UNIT.get(fact.units[name])
        )
        values = value if isinstance(value, tuple) else (value,)
        for item in values:
            if isinstance(item, Fact):
                texts += figures_out_of_range(item, f"{name_of_fact}.{name}.")
            elif _is_number(item) and limits is not None:
                low, high = limits
                if not low <= item <= high:
                    texts.append(f"{name_of_fact}.{name} = {item}")
    voltage, cells = fact.figures.get("voltage"), fact.figures.get("cells")
    if voltage and cells and not CELL_VOLTAGES[0] <= voltage / cells <= CELL_VOLTAGES[1]:
        texts.append(f"{name_of_fact}: {voltage / cells} V a cell")
    for name, time in (("time", fact.time), ("end_time", fact.end_time)):
        if time is not None and not (math.isfinite(time) and time >= -1e-6):
            texts.append(f"{name_of_fact}.{name} = {time}")
    return texts


def _is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)
