"""What the rows are, and how things stand with the link and the vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mavdem.ingest.geometry import Layout
from mavdem.ingest.scale import Scale


@dataclass(frozen=True, eq=False)
class Setup:
    """What the rows of a segment are, as the ``provenance`` of a ``Flight`` has it.

    Attributes:
        segment: its number.
        boot: number of the boot.
        dt: step, s.
        attitude, motors: the messages they are read from.
        layout, scale: of the inputs.
        rates: Hz of attitude and motors, from which the step was decided.
        start: first point of the grid, s; rows may begin a few seconds later, once it was decided.
    """

    segment: int
    boot: int
    dt: float
    attitude: str
    motors: str
    layout: Layout
    scale: Scale
    rates: tuple[float, ...]
    start: float


@dataclass(frozen=True)
class Status:
    """How things stand; ``dataclasses.asdict`` makes it plain JSON values.

    Attributes:
        vehicle: the one that is followed, "system:component"; None before it is known.
        speakers: every sender kept: system, component, kind, autopilot, frames, lost, flies.
        others: frames of senders beyond those.
        rates: Hz of the vehicle's messages of attitude and outputs over the last two seconds of its clock.
        frames: whole frames received.
        unread: those of another dialect or damaged.
        garbage: bytes that belong to no frame.
        lost: messages of the vehicle that are missing by its sequence numbers.
        late: samples that came too late to be told in their place.
        strays: messages whose time stamps were far off.
        verdict: what keeps rows from coming, one sentence; empty while nothing does.
        armed_and_airborne: whether the vehicle flies.
    """

    vehicle: str | None
    speakers: tuple[dict[str, Any], ...]
    others: int
    rates: dict[str, float]
    frames: int
    unread: int
    garbage: int
    lost: int
    late: int
    strays: int
    verdict: str
    armed_and_airborne: bool
