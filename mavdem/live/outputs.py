"""Motor outputs and demands: the latest samples, which channels move, and which are the inputs of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

import numpy as np

from mavdem.alignment.drive import (
    DEMAND_MESSAGE,
    INPUTS,
    MOTOR_MESSAGES,
    PORT_CHANNELS,
    THRUST_COLUMN,
    TILT_AXES,
    WIDE_PORT_CHANNELS,
    by_preference,
)
from mavdem.alignment.signals import motors_or_demand
from mavdem.ingest.motors import MotorGeometry, OutputScale, demand_geometry, motor_geometry, output_scale
from mavdem.live.messages import LiveMessage, Values, outputs
from mavdem.live.samples import SampleBuffer


class OutputBank:
    """The channels of one port of one message.

    ``samples``: the latest. ``first``: number of the first channel, from 1 on. ``moving``: places of the channels that
    took several values beside 0, which means "no output yet". ``least`` and ``most``: their extremes beside 0.
    """

    def __init__(self, width: int, first: int = 1) -> None:
        self.samples = SampleBuffer()
        self.first = first
        self.moving: set[int] = set()
        self.least, self.most = [inf] * width, [-inf] * width

    def take(self, time: float, values: Values) -> tuple[bool, bool]:
        """Adds a sample; returns whether it is new, and whether the extremes or the moving channels changed."""
        if not self.samples.add(time, values):
            return False, False
        changed = False
        for place, value in enumerate(values):
            if value and not self.least[place] <= value <= self.most[place]:
                seen = self.most[place] >= self.least[place]
                self.least[place], self.most[place] = min(self.least[place], value), max(self.most[place], value)
                changed = True
                if seen:
                    self.moving.add(place)
        return True, changed

    def places(self, channels: tuple[int, ...]) -> dict[int, int]:
        """Which of the channels are here, and their places."""
        return {channel: channel - self.first for channel in channels if 0 <= channel - self.first < len(self.least)}


@dataclass(frozen=True, eq=False)
class Drive:
    """The inputs of the model."""

    message: str  # name of the message
    layout: MotorGeometry  # as of ``Motors``
    banks: tuple[OutputBank, ...]  # those that contain inputs, the one with most first
    picks: tuple[tuple[int, int], ...]  # for each input the number of its bank and its place there

    @property
    def key(self) -> tuple[object, ...]:
        """What must not change within a segment."""
        return self.message, self.layout.channels, self.picks, self.banks

    def scale(self, parameters: Mapping[str, float]) -> OutputScale:
        """By ``output_scale``, from the extremes, the latest samples and the autopilot's parameters."""
        if self.message == DEMAND_MESSAGE:
            return OutputScale("demand", "", -1.0, 1.0, 0.0)
        seen = [0.0]
        for bank, place in self.picks:
            seen += [end for end in (self.banks[bank].least[place], self.banks[bank].most[place]) if abs(end) < inf]
            seen += [values[place] for values in self.banks[bank].samples.values[-100:]]
        return output_scale(np.array(seen), parameters)

    def collective(self, scale: OutputScale) -> float:
        """Mean of the motors of the first bank in the latest sample, or the thrust, 0 to 1; NaN before a sample."""
        latest = self.banks[0].samples.values[-1:]
        if not latest:
            return np.nan
        if self.message == DEMAND_MESSAGE:
            return latest[0][THRUST_COLUMN]
        working = [latest[0][place] for bank, place in self.picks if bank == 0]
        return (sum(working) / len(working) - scale.low) / (scale.high - scale.low)

    def commands(self, scale: OutputScale) -> list[float]:
        """The latest of each motor as a share of its range; empty before all have come, and of a demand."""
        if self.message == DEMAND_MESSAGE or not all(bank.samples.values for bank in self.banks):
            return []
        latest = (self.banks[bank].samples.values[-1][place] for bank, place in self.picks)
        return [(value - scale.low) / (scale.high - scale.low) for value in latest]


class Outputs:
    """All outputs and demands of one vehicle; ``axis`` and ``inputs`` as for ``Signals``.

    ``changes``: increases when a channel's extremes, or which channels move, change. Raises ValueError: unknown inputs.
    """

    def __init__(self, axis: str, inputs: str | None) -> None:
        if inputs not in (None, *INPUTS):
            raise ValueError(f"inputs must be one of {', '.join(INPUTS)}, not {inputs!r}")
        self.changes = 0
        self._axis, self._inputs = axis, inputs
        self._banks: dict[str, dict[int, OutputBank]] = {name: {} for name in (*MOTOR_MESSAGES, DEMAND_MESSAGE)}
        self._width = PORT_CHANNELS

    def restart(self) -> None:
        """Drops the samples after a reboot; which channels move stays."""
        for banks in self._banks.values():
            for bank in banks.values():
                bank.samples = SampleBuffer()
        self.changes += 1

    def take(self, message: LiveMessage, time: float) -> SampleBuffer | None:
        """Adds a message; returns the stream that it is a new sample of, if it is."""
        if message.name == DEMAND_MESSAGE:
            group, *controls = message.values
            port, values = 0, tuple(controls)
            if group != 0:
                return None
        else:
            port, values = outputs(message)
        if message.name == "SERVO_OUTPUT_RAW":
            if self._width == PORT_CHANNELS and any(values[PORT_CHANNELS:]):
                self._width = WIDE_PORT_CHANNELS
                self.changes += 1
                self._banks[message.name].clear()
            values = values[: self._width]
        banks = self._banks[message.name]
        if port not in banks:
            if len(banks) >= 4:  # PX4 has two
                return None
            banks[port] = OutputBank(len(values), 1 + len(values) * port)
        new, changed = banks[port].take(time, values)
        self.changes += changed
        return banks[port].samples if new else None

    def rates(self, now: float, over: float) -> dict[str, float]:
        """Hz of each message over the last ``over`` seconds; of several ports the fastest."""
        return {
            name: max(bank.samples.rate(now, over) for bank in banks.values())
            for name, banks in self._banks.items()
            if banks
        }

    def choose(
        self,
        now: float,
        over: float,
        vehicle: str,
        autopilot: str,
        parameters: Mapping[str, float],
        staying: str | None = None,
    ) -> Drive | None:
        """The inputs by the rule of ``Signals.drive``, from the messages of the last ``over`` seconds before ``now``.

        ``vehicle``, ``autopilot`` and ``parameters`` are as for ``motor_geometry``; ``staying`` is the message to keep.
        """
        if staying == DEMAND_MESSAGE:
            return self._demand()
        rates = self.rates(now, over)
        names = MOTOR_MESSAGES if staying is None else (staying,)
        counts = {name: sum(bank.samples.count(now, over) for bank in self._banks[name].values()) for name in names}
        ordered = () if self._inputs == "demand" else by_preference(counts)
        found = (self._motors(message, vehicle, autopilot, parameters) for message in ordered)
        motors = next((drive for drive in found if drive is not None), None)
        demand = None if self._inputs == "motors" or staying is not None else self._demand()
        # Motors that do not move count too: before take-off they have not moved yet.
        motor_rate = 0.0 if self._inputs == "demand" else max(rates.get(name, 0.0) for name in MOTOR_MESSAGES)
        return motors_or_demand(motors, demand, motor_rate, rates.get(DEMAND_MESSAGE, 0.0))

    def _motors(self, message: str, vehicle: str, autopilot: str, parameters: Mapping[str, float]) -> Drive | None:
        banks = [bank for _, bank in sorted(self._banks[message].items())]
        moving = [bank.first + place for bank in banks for place in sorted(bank.moving)]
        plan = motor_geometry(vehicle, autopilot, parameters, moving, len(banks[0].least))
        if plan is None or not set(plan.channels) & set(moving):
            return None
        found = [(bank, places) for bank in banks if (places := bank.places(plan.channels))]
        found.sort(key=lambda entry: -len(entry[1]))
        at = {channel: (number, place) for number, (_, places) in enumerate(found) for channel, place in places.items()}
        if set(at) != set(plan.channels):
            return None
        return Drive(message, plan, tuple(bank for bank, _ in found), tuple(at[channel] for channel in plan.channels))

    def _demand(self) -> Drive | None:
        bank = self._banks[DEMAND_MESSAGE].get(0)
        place = TILT_AXES.index(self._axis)
        if bank is None or place not in bank.moving:
            return None
        return Drive(DEMAND_MESSAGE, demand_geometry(self._axis), (bank,), ((0, place),))
