"""What breaks in flight beside a motor (``vehicle.weak_motor``): a propeller that chips, a load that shifts."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sitl_scenarios.sections.base import NotNegative, Section

Left = Annotated[float, Field(gt=0, le=1)]
Millimetres = Annotated[float, Field(ge=-100, le=100)]


class Propeller(Section):
    """A propeller that chips in flight: it gives less thrust, takes less torque, and shakes the vehicle."""

    motor: Annotated[int, Field(ge=0, le=4)] = 0
    """Motor that turns it, counted from 1 as the autopilot does; 0: none."""
    start: NotNegative = 0.0
    """Seconds into the flight at which it chips."""
    thrust: Left = 0.85
    """Share of its thrust that is left, at the same speed."""
    torque: Left = 0.82
    """Share of its torque that is left; where blades get shorter, thrust goes with R⁴ and torque with R⁵."""
    unbalance: Annotated[float, Field(ge=0, le=1000)] = 20.0
    """Mass that is missing times its distance from the shaft, g mm: a force that turns with the rotor."""


class Load(Section):
    """A load that shifts in flight, and the vehicle's centre of mass with it."""

    start: NotNegative = 0.0
    """Seconds into the flight at which it shifts."""
    forward: Millimetres = 0.0
    """How far the centre of mass moves forward, mm; back where negative."""
    right: Millimetres = 0.0
    """How far it moves to the right, mm; to the left where negative."""
