"""Transmitter: the frames an autopilot sends while it flies, block of cycles after block of cycles."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.compose import Sender, compose, compose_1
from sitl_scenarios.mavlink.autopilots import AUTOPILOTS, DISARMED, INFO
from sitl_scenarios.mavlink.batch import Batch, joined
from sitl_scenarios.mavlink.messages import Payloads, Speaker, named, payload
from sitl_scenarios.mavlink.parameters import Parameter, parameters
from sitl_scenarios.mavlink.schedule import Schedule
from sitl_scenarios.motion import Motion
from sitl_scenarios.scenario import Scenario

COMPONENT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
FIRST_HEARD = 0.01
"""Seconds on the boot clock before an autopilot is heard at first: at zero, messages would seem to have no stamp."""
REBOOTING = 1.0
"""Seconds on the new boot clock before an autopilot that began anew is heard."""
LAST_OF_MAVLINK_1 = 255
"""The greatest message id that MAVLink 1 can carry."""
NOT_LISTED = 65535
"""PARAM_VALUE.param_index of a parameter that is told by itself."""

Placed = tuple[str, NDArray[np.intp], Payloads]
"""A message by name, the rows (n,) of the block in which it is sent, its payloads (n,)."""


class Transmitter:
    """An autopilot's sending side: what is due by its schedule, what changes, and what it was asked for.

    What it sends by itself does not depend on how a flight is cut into blocks.

    Attributes:
        autopilot: who speaks.
        system: its MAVLink system id.
        parameters: by name.
        schedule: of its streams, on the boot clock.
        clock: s on the boot clock, at the end of the last block.
    """

    def __init__(self, scenario: Scenario, cycle: float) -> None:
        """Takes the flight's scenario and the cycle of the autopilot's loop, s.

        Raises:
            ValueError: the scenario names rates of a message that is not sent.
        """
        self.autopilot = AUTOPILOTS[scenario.stream.speaks]
        self.system = scenario.stream.system
        self._rates = self.autopilot.rates(scenario.stream.rate, scenario.stream.rates)
        self._scenario, self._cycle = scenario, cycle
        self._speaker = Speaker(self.autopilot)
        self._asked: list[tuple[str, Payloads]] = []
        self._reboots_at = np.inf if scenario.faults.reboot is None else scenario.faults.reboot
        self._armed_at = np.inf
        self._begin(0.0, FIRST_HEARD)

    def send(self, motion: Motion) -> Batch:
        """The frames sent during the rows of the next block, one at least, at the times of the motion."""
        armed = motion.time[motion.armed]
        if len(armed):
            self._armed_at = min(self._armed_at, float(armed[0]))
        before = int(np.searchsorted(motion.time, self._armed_at + self._reboots_at))
        if before == len(motion):
            return self._sent(motion)
        batches = [self._sent(rows_of_motion(motion, slice(before)))] if before else []
        first = float(motion.time[before])
        self._reboots_at = np.inf
        self._begin(first, first + REBOOTING)
        return joined([*batches, self._sent(rows_of_motion(motion, slice(before, None)))])

    def ask(self, name: str, **values: object) -> None:
        """Sends a message once, with the next block; fields that are not given are zero."""
        self._asked.append((name, payload(name, **values)))

    def ask_streamed(self, name: str) -> None:
        """Sends a message that comes by itself once more, with the next block."""
        self._once.add(name)

    def tell(self, parameter: Parameter) -> None:
        """Sends one parameter, with the next block."""
        self._asked.append(("PARAM_VALUE", self._told(parameter, NOT_LISTED)))

    def tell_parameters(self) -> None:
        """Sends all parameters, one in a cycle."""
        self._to_tell = [self._told(parameter, index) for index, parameter in enumerate(self.parameters.values())]

    def _begin(self, boot: float, heard: float) -> None:
        """Begins anew with a boot clock that is zero at ``boot``, heard from ``heard`` on, s of the motion."""
        self._boot, self._heard = boot, heard
        self._sequence = 0
        self._state = DISARMED
        self._once: set[str] = set()
        self.clock = heard - boot
        self.schedule = self._scheduled(self.clock)
        self.parameters = parameters(self._scenario, self.autopilot, self._cycle)
        self.tell_parameters()
        self._say(f"Simulated by mavdem, frame {self._scenario.vehicle.frame}")
        self._fresh = True

    def _scheduled(self, start: float) -> Schedule:
        return Schedule(self._rates, start, self._cycle, self.autopilot.interval_step, self.autopilot.apart)

    def _say(self, text: str) -> None:
        self.ask("STATUSTEXT", severity=INFO, text=text.encode())

    def _told(self, parameter: Parameter, index: int) -> Payloads:
        return payload(
            "PARAM_VALUE",
            param_id=parameter.name.encode(),
            param_value=parameter.encoded(self.autopilot.bitwise),
            param_type=parameter.kind,
            param_count=len(self.parameters),
            param_index=index,
        )

    def _sent(self, motion: Motion) -> Batch:
        motion = rows_of_motion(motion, slice(int(np.searchsorted(motion.time, self._heard)), None))
        if not len(motion):
            return _nothing()
        clock = motion.time - self._boot
        if self._fresh:
            self.schedule, self._fresh = self._scheduled(float(clock[0])), False
        self.clock = float(clock[-1])
        placed = [*self._answers(), *self._changes(motion), *self._listed(len(motion))]
        placed += self._streams(motion, clock)
        version = self._scenario.stream.version
        placed = [one for one in placed if version == 2 or named(one[0]).message_id <= LAST_OF_MAVLINK_1]
        return self._framed(placed, motion.time, version) if placed else _nothing()

    def _answers(self) -> list[Placed]:
        asked, self._asked = self._asked, []
        return [(name, np.zeros(1, dtype=np.intp), one) for name, one in asked]

    def _changes(self, motion: Motion) -> list[Placed]:
        """STATUSTEXT where the state changes."""
        states = np.where(motion.armed, motion.landed_state.astype(np.int64), DISARMED)
        placed: list[Placed] = []
        for row in np.flatnonzero(np.diff(states, prepend=self._state)):
            text = self.autopilot.words.get((self._state, int(states[row])))
            self._state = int(states[row])
            if text is not None:
                said = payload("STATUSTEXT", severity=INFO, text=text.encode())
                placed.append(("STATUSTEXT", np.array([row]), said))
        return placed

    def _listed(self, count: int) -> list[Placed]:
        """The next parameters of those to be told, one in each row."""
        now, self._to_tell = self._to_tell[:count], self._to_tell[count:]
        return [("PARAM_VALUE", np.arange(len(now)), np.concatenate(now))] if now else []

    def _streams(self, motion: Motion, clock: NDArray[np.float64]) -> list[Placed]:
        placed: list[Placed] = []
        for name in self._rates:
            rows = self.schedule.due(name, clock)
            if name in self._once:
                rows = np.union1d(rows, [0])
            if len(rows):
                boot = np.round(clock[rows] * 1e6).astype(np.int64)
                placed.append((name, rows, self._speaker.say(name, rows_of_motion(motion, rows), boot)))
        self._once.clear()
        return placed

    def _framed(self, placed: list[Placed], time: NDArray[np.float64], version: int) -> Batch:
        rows = np.concatenate([rows for _, rows, _ in placed])
        order = np.argsort(rows, kind="stable")
        sequence = np.empty(len(rows), dtype=np.int64)
        sequence[order] = np.arange(self._sequence, self._sequence + len(rows))
        self._sequence = int(self._sequence + len(rows)) % 256
        sender = Sender(self.system, COMPONENT)
        batches, begin = [], 0
        for name, own, payloads in placed:
            numbers = (sequence[begin : begin + len(own)] % 256).astype(np.uint8)
            begin += len(own)
            if version == 1:
                data, frames = compose_1(payloads, named(name), sender, numbers)
            else:
                data, frames = compose(payloads, named(name), sender, numbers, np.ones(len(own), dtype=np.bool_))
            batches.append(Batch(time[own], data, frames))
        return joined(batches).taken(order, time[rows[order]])


def rows_of_motion(motion: Motion, rows: slice | NDArray[np.intp]) -> Motion:
    """Some rows of a motion."""
    return Motion(**{field.name: getattr(motion, field.name)[rows] for field in fields(Motion)})


def _nothing() -> Batch:
    data, frames = compose(
        payload("HEARTBEAT")[:0],
        named("HEARTBEAT"),
        Sender(0, 0),
        np.empty(0, dtype=np.uint8),
        np.empty(0, dtype=np.bool_),
    )
    return Batch(np.empty(0), data, frames)
