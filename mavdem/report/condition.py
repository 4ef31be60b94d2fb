"""The condition of a vehicle, which a log has at any rate, and the contents of the log, in sentences and tables."""

from collections.abc import Mapping

import numpy as np

from mavdem.assessment import Assessment
from mavdem.containers import JsonValues
from mavdem.dataset.axes import TILT_AXES
from mavdem.facts.online import DragSource
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.report.blocks import Blocks, Sentence, Table, caution
from mavdem.report.templates import render_section
from mavdem.wind_velocity.compass import meteorological_direction
from mavdem.wind_velocity.estimation import WindVelocity
from mavdem.wind_velocity.from_log import WindEvidence
from mavdem.wind_velocity.vehicle_drag import Drag

# what a tier is called where it is shown
TIER_WORDS = {
    "a": "full model",
    "b": "slow motion",
    "c": "condition only",
    "": "of unknown tier",
}
# what a drag is known from, in words
DRAG_SOURCES = {
    DragSource.POPULATION: "typical vehicles",
    DragSource.PARAMETERS: "the autopilot's parameters",
    DragSource.FLIGHT: "flight",
    DragSource.CALIBRATION: "calibration",
}
# messages below this rate are listed together: they are too slow to describe the motion
SLOW_HZ = 0.95
# share of missing sequence numbers from which it is reported; less is a radio link in good order
MIN_LOST_SHARE = 0.01


def log_blocks(held: JsonValues) -> Blocks:
    """Returns all that a log ``held``, by ``mavdem.assessment.inventory``: each vehicle, then what came from whom."""
    return [
        *(block for vehicle in held["vehicles"] for block in vehicle_contents(vehicle)),
        *stream_contents(held),
    ]


def vehicle_contents(vehicle: JsonValues) -> Blocks:
    """Returns what a log holds of a ``vehicle``: whether a model can be learned, repairs, settled flight, messages."""
    learnability = vehicle["verdict"]
    names = vehicle["names"]
    # names of the periodic messages by their rounded rate, the fastest first
    streams = dict[str, list[str]]()
    for name, message in sorted(
        vehicle["messages"].items(), key=lambda message: -(message[1]["rate"] or 0.0)
    ):
        if (rate := message["rate"]) and name != "PARAM_VALUE":
            key = f"{rate:.1f} Hz" if rate >= SLOW_HZ else "below 1 Hz"
            shown = f"{name} ({names[name]})" if name in names else name
            streams.setdefault(key, []).append(shown)
    rows = [[rate, ", ".join(group)] for rate, group in streams.items()]
    return [
        *render_section("vehicle", **vehicle, is_tilt=learnability.axis in TILT_AXES),
        *render_section("tier", **vehicle),
        *map(caution, learnability.cautions),
        *(Sentence(str(repair), "Noted:") for repair in vehicle["repairs"]),
        *render_section("settled", **vehicle),
        *([Table(["rate", "messages"], rows, words=True)] if rows else []),
    ]


def stream_contents(held: JsonValues) -> list[Sentence]:
    """Returns what was received from each sender, by the inventory ``held``, and what could not be decoded."""
    vehicles = [component_id(vehicle) for vehicle in held["vehicles"]]
    blocks = []
    for speaker in held["speakers"]:
        is_vehicle = component_id(speaker) in vehicles
        lost, missing = speaker["lost_share"], speaker["missing_share"]
        blocks += render_section(
            "sender",
            **speaker,
            is_ordinary=is_vehicle or bool(vehicles),
            is_silent=speaker["kind"] == UNNAMED and not is_vehicle,
            # A ground station numbers its messages to all links together, so its gaps have no meaning. Where no stream
            # has gaps, the log keeps only some kinds of messages.
            is_lossy=is_vehicle
            and lost >= MIN_LOST_SHARE
            and (missing is None or missing >= min(MIN_LOST_SHARE, lost / 2)),
        )
    return [*blocks, *render_section("unread", unread=held["unread"])]


def component_id(component: JsonValues) -> str:
    """Returns system and number of a ``component``, as in "1:1"."""
    return f"{component['system']}:{component['component']}"


def wind_blocks(air: WindEvidence) -> Blocks:
    """Returns speed and direction with intervals, what is not reported, and how far the autopilot's own is off."""
    wind, own, reason = air
    if wind is None:
        return [Sentence(reason.advised, "Wind:")] if reason else []
    first, last = wind.time[[0, -1]]
    estimate = None
    if own is not None:
        rows = (own.boot == wind.boot) & (own.time >= first) & (own.time <= last)
        if rows.any():
            mean = own.values[rows].mean(axis=0)
            estimate = {"size": np.hypot(*mean), "origin": meteorological_direction(*mean)}
    reasons = (
        Sentence(str(why), f"{quantity.capitalize()}:") for quantity, why in wind.reasons.items()
    )
    return [*render_section("wind", wind=wind, own=estimate), *reasons]


def wind_tables(wind: WindVelocity) -> Blocks:
    """Returns the mean wind of each minute, and of each layer, where its speed is known and there are several."""
    wind = wind.identified_figures
    courses = ("Time (s)", "start", wind.minutes), ("Height (m)", "height", wind.profile)
    return [
        Table(
            [header, "Wind (m/s)", "From (°)"],
            [
                [f"{row[name]:.0f}", f"{row['speed']:.1f}", f"{row['direction']:.0f}"]
                for row in rows
            ],
        )
        for header, name, rows in courses
        if len(rows) > 1
    ]


def drag_table(drag: Drag, settings: Mapping[str, tuple[float, float, float]]) -> Table:
    """Returns the linear ``drag`` and the ``settings`` of the autopilot for it, with both ends of 90 % intervals."""
    numbers = {
        **settings,
        "linear drag (1/s)": (drag.linear.mean(), *drag.interval("linear").mean(axis=1)),
    }
    rows = [[name, *(f"{value:.3g}" for value in values)] for name, values in numbers.items()]
    return Table([f"Drag, from {DRAG_SOURCES[drag.source]}", "value", "from", "to"], rows)


def air_blocks(assessment: Assessment) -> Blocks:
    """Returns the :func:`wind_blocks` of an ``assessment``, and what share of the wind torque that wind explains."""
    if assessment.evidence is None:
        return []
    explained = assessment.wind_share_of_torque
    share = [] if explained is None else [Sentence(str(explained), "Wind torque:")]
    return [*wind_blocks(assessment.evidence.wind), *share]
