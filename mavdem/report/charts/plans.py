"""Plans: a vehicle from above with its motors, a wind rose, and the flown path, as pictures of a page."""

from itertools import pairwise
from typing import Any

import numpy as np
from markupsafe import Markup

from mavdem.arrays import Array
from mavdem.assessment.condition import Condition
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.facts import Level
from mavdem.motors.change_hypotheses import FAULT_RISE
from mavdem.report.charts.chart import Plan
from mavdem.report.charts.timeline import Timeline
from mavdem.report.numbers import listed
from mavdem.report.pages.page import environment
from mavdem.wind_velocity.compass import compass_text, speed_and_direction
from mavdem.wind_velocity.estimation import WindVelocity

REACH = 100.0
"""Of the farthest motor, the largest petal, or the path, in the units of a plan."""
CLASSES = 0, 2, 4, 6, 8, 10, np.inf
"""m/s, of a wind's speed."""
WAY = 600  # points of a path


def frame_plan(motors: MotorOutputs | None, condition: Condition | None) -> Plan | None:
    """Returns the motors where they are, with their trim deviation and their headroom; None where that is not known."""
    hover = None if condition is None else condition.hover
    places = () if motors is None else motors.geometry.positions
    if condition is None or hover is None or len(places) != len(hover.motors):
        return None
    at = np.array(places, np.float64)
    at *= REACH / max(np.hypot(*at.T).max(), 1e-9)
    halves = condition.share_interval or (None,) * len(places)
    drawn = [
        {
            "name": number + 1,
            "x": round(right, 1),
            "y": round(-forward, 1),
            "share": hover.trim_of_range[number] ** 0.5,
            "deviation": f"{100 * (hover.trim_share[number] - 1):+.1f} %".replace("-", "−"),
            "half": "" if half is None else f"± {100 * half:.1f} %",
            "headroom": f"{100 * hover.headroom[number]:.0f} % left",
            "level": Level.WATCH if abs(hover.imbalance[number]) > 100 * FAULT_RISE else Level.GOOD,
        }
        for number, ((forward, right), half) in enumerate(zip(at.tolist(), halves, strict=True))
    ]
    told = [
        f"motor {motor['name']} {motor['deviation']} {motor['half']}, {motor['headroom']}"
        for motor in drawn
    ]
    drawing = _drawn("frame", motors=drawn, size=150.0 / len(drawn) ** 0.9)
    return Plan("From above", f"Trim deviation and headroom: {listed(told)}.", drawing)


def rose_of_wind(wind: WindVelocity) -> Plan:
    """Returns what share of a flight the ``wind`` came from where, in classes of speed, %, and its mean direction."""
    speed, origin, *_ = speed_and_direction(wind.velocity, wind.band, wind.direction)
    said = f"The wind came from {compass_text(wind.direction)}, {wind.speed:.1f} m/s."
    return _rose(said, origin, speed, 100 / len(speed), wind.direction)


def rose_of_flights(winds: Array) -> Plan:
    """Returns how many flights had wind from where, in classes of speed, by ``winds`` (N, 2), rad and m/s."""
    angle, speed = winds.T
    return _rose(f"Wind of {len(winds)} flights.", np.degrees(angle), speed, 1.0)


def _rose(
    said: str,
    origin: Array,
    speed: Array,
    each: float,
    arrow: float | None = None,
) -> Plan:
    sector = np.rint(origin / 22.5).astype(int) % 16
    counts = each * np.histogram2d(speed, sector, (CLASSES, np.arange(17)))[0]
    edges = np.vstack([np.zeros(16), counts.cumsum(axis=0)])
    scale = REACH / max(edges.max(), 1e-9)
    petals = [
        (number, scale * inner, scale * outer, 0.25 + 0.14 * row)
        for row, (below, above) in enumerate(pairwise(edges))
        for number, (inner, outer) in enumerate(zip(below, above, strict=True))
        if outer > inner
    ]
    unit = " %" if each != 1.0 else ""
    decimals = 0 if scale < REACH else 1
    rings = [(radius, f"{radius / scale:.{decimals}f}{unit}") for radius in (REACH / 2, REACH)]
    return Plan("Wind rose", said, _drawn("rose", petals=petals, rings=rings, arrow=arrow))


def flown_path(timeline: Timeline | None) -> Plan | None:
    """Returns the path over ground in a ``timeline``, north up; None without one."""
    position = None if timeline is None else timeline.position
    if position is None:
        return None
    north, east = position.values[:, :2].T
    size = max(np.ptp(north), np.ptp(east), 2.0)
    length = float(f"{size / 3:.0e}")
    scale = 2 * REACH / size
    every = slice(None, None, -(-len(north) // WAY))
    x = scale * (east[every] - (east.min() + east.max()) / 2)
    y = -scale * (north[every] - (north.min() + north.max()) / 2)
    way = "M" + " ".join(f"{across:.1f} {down:.1f}" for across, down in zip(x, y, strict=True))
    drawing = _drawn(
        "path",
        way=way,
        first=(x[0], y[0]),
        last=(x[-1], y[-1]),
        scale=(scale * length, f"{length:g} m"),
    )
    said = (
        f"Path over ground, {np.ptp(east):.0f} m wide and {np.ptp(north):.0f} m high; north is up."
    )
    return Plan("Flown path", said, drawing)


def _drawn(name: str, **values: Any) -> Markup:
    made = environment().get_template("plans.html").module
    return Markup(getattr(made, name)(**values))
