"""What drives the vehicle: the latest motor outputs and demands, which channels move, on which scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

import numpy as np

from mavdem.align import INPUTS, MINIMUM_RATE
from mavdem.ingest.geometry import Layout, layout, of_demand
from mavdem.ingest.live_messages import Message, Values, outputs
from mavdem.ingest.meaning import AXES, DEMAND, MOTOR_MESSAGES, fastest
from mavdem.ingest.scale import Scale, recognise
from mavdem.live.samples import Samples

MOST_BANKS = 4
"""Ports of one message that are listened to; PX4 has two."""
THRUST = 3
"""Place of thrust in ACTUATOR_CONTROL_TARGET.controls of group 0."""
NARROW, WIDE = 8, 16
"""Channels a port of SERVO_OUTPUT_RAW: it began with 8; firmware that fills the extension counts ports by 16."""


class Bank:
    """The channels of one port of one message.

    Attributes:
        samples: the latest.
        first: number of the first channel, from 1 on.
        moving: places of the channels that took several values beside 0, which stands for "no output yet".
        least, most: the extremes beside 0, of each channel.
    """

    def __init__(self, width: int) -> None:
        """Takes how many channels there are."""
        self.samples = Samples()
        self.first = 1
        self.moving: set[int] = set()
        self.least, self.most = [inf] * width, [-inf] * width

    def take(self, time: float, values: Values) -> tuple[bool, bool]:
        """Takes a sample; tells whether it is new and whether an extreme or a moving channel is."""
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


@dataclass(frozen=True, eq=False)
class Drive:
    """What is taken for a model's inputs.

    Attributes:
        message: where they are read from.
        layout: as of ``Motors``.
        banks: those that hold them, the one with most first.
        picks: for each input the number of its bank and its place there.
    """

    message: str
    layout: Layout
    banks: tuple[Bank, ...]
    picks: tuple[tuple[int, int], ...]

    @property
    def key(self) -> tuple[object, ...]:
        """What must stay for rows to stay comparable."""
        return self.message, self.layout.channels, self.picks, self.banks

    def scale(self, parameters: Mapping[str, float]) -> Scale:
        """As ``recognise`` tells it from the extremes so far, and the step from the latest samples.

        ``parameters`` are the autopilot's.
        """
        if self.message == DEMAND:
            return Scale("demand", "", -1.0, 1.0, 0.0)
        seen = [0.0]
        for bank, place in self.picks:
            seen += [end for end in (self.banks[bank].least[place], self.banks[bank].most[place]) if abs(end) < inf]
            seen += [values[place] for values in self.banks[bank].samples.values[-100:]]
        return recognise(np.array(seen), parameters)

    def collective(self, scale: Scale) -> float:
        """How hard the motors of the first bank work together, by the latest sample, 0 to 1; NaN before one."""
        latest = self.banks[0].samples.values[-1:]
        if not latest:
            return np.nan
        if self.message == DEMAND:
            return latest[0][THRUST]
        working = [latest[0][place] for bank, place in self.picks if bank == 0]
        return (sum(working) / len(working) - scale.low) / (scale.high - scale.low)


class Outputs:
    """Everything heard that may drive the vehicle.

    Attributes:
        changes: grows whenever what is known of the channels does.
    """

    def __init__(self, axis: str, inputs: str | None) -> None:
        """Takes the axis and the choice of inputs of ``align.drive``."""
        if inputs not in (None, *INPUTS):
            raise ValueError(f"inputs must be one of {', '.join(INPUTS)}, not {inputs!r}")
        self.changes = 0
        self._axis, self._inputs = axis, inputs
        self._banks: dict[str, dict[int, Bank]] = {name: {} for name in (*MOTOR_MESSAGES, DEMAND)}
        self._width = NARROW

    def begin_anew(self) -> None:
        """Forgets the samples, after a reboot; which channels move is still known."""
        for banks in self._banks.values():
            for bank in banks.values():
                bank.samples = Samples()
        self.changes += 1

    def take(self, message: Message, time: float) -> Samples | None:
        """Takes a message; answers the stream it is a new sample of."""
        if message.name == DEMAND:
            group, *controls = message.values
            port, values = 0, tuple(controls)
            if group != 0:
                return None
        else:
            port, values = outputs(message)
        if message.name == "SERVO_OUTPUT_RAW":
            if self._width == NARROW and any(values[NARROW:]):
                self._width = WIDE
                self.changes += 1
                self._banks[message.name].clear()
            values = values[: self._width]
        banks = self._banks[message.name]
        if port not in banks:
            if len(banks) >= MOST_BANKS:
                return None
            banks[port] = Bank(len(values))
            banks[port].first = 1 + len(values) * port
        new, changed = banks[port].take(time, values)
        self.changes += changed
        return banks[port].samples if new else None

    def rates(self, now: float, over: float) -> dict[str, float]:
        """Hz of each message over the last seconds; of several ports that of the fastest."""
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
        """What drives the axis, by the messages of the last ``over`` seconds before ``now``, as ``align.drive`` has it.

        Args:
            now, over: s.
            vehicle, autopilot, parameters: of the vehicle, as for ``layout``.
            staying: the message to stay with, if any.
        """
        if staying == DEMAND:
            return self._demand()
        rates = self.rates(now, over)
        names = MOTOR_MESSAGES if staying is None else (staying,)
        counts = {
            name: count
            for name in names
            if (count := sum(bank.samples.count(now, over) for bank in self._banks[name].values()))
        }
        message = None if self._inputs == "demand" else fastest(counts)
        motors = None if message is None else self._motors(message, vehicle, autopilot, parameters)
        demand = None if self._inputs == "motors" or staying is not None else self._demand()
        # Motors that come fast are waited for: before take-off they have not moved yet.
        fast = self._inputs != "demand" and any(rates.get(name, 0.0) >= MINIMUM_RATE for name in MOTOR_MESSAGES)
        if demand is None or fast:
            return motors
        return demand if motors is None or rates[DEMAND] >= MINIMUM_RATE else motors

    def _motors(self, message: str, vehicle: str, autopilot: str, parameters: Mapping[str, float]) -> Drive | None:
        banks = [bank for _, bank in sorted(self._banks[message].items())]
        moving = [bank.first + place for bank in banks for place in sorted(bank.moving)]
        plan = layout(vehicle, autopilot, parameters, moving, len(banks[0].least))
        if plan is None or not set(plan.channels) & set(moving):
            return None

        def places(bank: Bank) -> dict[int, int]:
            return {
                channel: channel - bank.first
                for channel in plan.channels
                if bank.first <= channel < bank.first + len(bank.least)
            }

        holding = sorted((bank for bank in banks if places(bank)), key=lambda bank: -len(places(bank)))
        at = {
            channel: (number, place) for number, bank in enumerate(holding) for channel, place in places(bank).items()
        }
        if set(at) != set(plan.channels):
            return None
        return Drive(message, plan, tuple(holding), tuple(at[channel] for channel in plan.channels))

    def _demand(self) -> Drive | None:
        bank = self._banks[DEMAND].get(0)
        place = AXES.index(self._axis)
        if bank is None or place not in bank.moving:
            return None
        return Drive(DEMAND, of_demand(self._axis), (bank,), ((0, place),))
