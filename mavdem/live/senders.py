"""Who is talking, which of them are vehicles, and which one is followed: once chosen, it stays.

A sender is what most of its first HEARTBEATs say, as in a recorded stream. All that is kept is bounded, whatever comes:
of more senders than fit, those heard least make room.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from mavdem.ingest.decode import definitions
from mavdem.ingest.framing import GOOD
from mavdem.ingest.geometry import MULTIROTORS
from mavdem.ingest.live_frames import Frame
from mavdem.ingest.live_messages import Message
from mavdem.ingest.meaning import ATTITUDE_MESSAGES
from mavdem.ingest.sequence import missing_between
from mavdem.ingest.vehicles import UNNAMED, identity

MOST_SENDERS = 64
"""Senders of which something is kept."""
MOST_PARAMETERS = 2048
"""Parameters kept of each; autopilots have up to 1500."""
ELECTORATE = 31
"""HEARTBEATs that decide what a sender is; later ones change nothing."""
CONVINCING = 3
"""HEARTBEATs, and messages of attitude, before a vehicle is followed; as many seconds in which another one shows."""
MOST_LISTED = 8
"""Vehicles named in one sentence."""
SILENT = 500
"""Messages of attitude without a HEARTBEAT after which none is waited for."""
MUTE = 5
"""HEARTBEATs of a multirotor without a message of attitude after which none is waited for: many an autopilot sends
nothing else before it is asked."""


@dataclass(eq=False)
class Sender:
    """One component heard on the link.

    Attributes:
        system, component: MAVLink ids.
        messages: number of messages by name.
        frames: all of them, those that could not be read included.
        parameters: the last PARAM_VALUE of each by name.
        kind, autopilot: what most of its HEARTBEATs say it is, as of ``Speaker``.
        held: whether that stays as it is once ``CONVINCING`` of them have come: of a vehicle that is followed no flood
            of forged HEARTBEATs shall make another.
    """

    system: int
    component: int
    messages: dict[str, int] = field(default_factory=dict)
    frames: int = 0
    parameters: dict[bytes, Message] = field(default_factory=dict, repr=False)
    kind: str = UNNAMED
    autopilot: str = UNNAMED
    held: bool = False
    _beats: list[tuple[int, int]] = field(default_factory=list, repr=False)
    _last: Frame | None = field(default=None, repr=False)
    _missing: int = field(default=0, repr=False)

    @property
    def name(self) -> str:
        """system:component."""
        return f"{self.system}:{self.component}"

    @property
    def lost(self) -> int:
        """Messages missing by the gaps in its sequence numbers."""
        return max(self._missing, 0)

    @property
    def known(self) -> bool:
        """Whether it has said often enough what it is, or will not say."""
        return len(self._beats) >= CONVINCING or (not self._beats and self.attitudes >= SILENT)

    @property
    def flies(self) -> bool:
        """Whether it is a multirotor, as far as it says, that sends attitude."""
        return self.kind in (*MULTIROTORS, UNNAMED) and self.attitudes >= CONVINCING

    @property
    def told(self) -> bool:
        """Whether enough came of it to follow it: what it is, and attitude, or no attitude for long."""
        mute = self.kind in MULTIROTORS and len(self._beats) >= MUTE and not self.attitudes
        return mute or (self.known and self.flies)

    @property
    def attitudes(self) -> int:
        """Messages of attitude it sent."""
        return sum(self.messages.get(name, 0) for name in ATTITUDE_MESSAGES)

    def take(self, frame: Frame) -> bool:
        """Counts a frame of this sender, and tells whether it is more than a copy of its last, as some links make."""
        self.frames += 1
        if frame == self._last:
            return False
        if self._last is not None:
            self._missing += missing_between(self._last.sequence, frame.sequence)
        self._last = frame
        if frame.verdict == GOOD:
            name = definitions()[frame.message_id].name
            self.messages[name] = self.messages.get(name, 0) + 1
        return True

    def take_parameter(self, message: Message) -> bool:
        """Keeps a PARAM_VALUE, and tells whether it is new."""
        name = message.values[0]
        if self.parameters.get(name) == message or (
            name not in self.parameters and len(self.parameters) >= MOST_PARAMETERS
        ):
            return False
        self.parameters[name] = message
        return True

    def take_heartbeat(self, message: Message) -> None:
        """Counts what one of its HEARTBEATs says it is."""
        kind, autopilot, _ = message.values
        if len(self._beats) < (CONVINCING if self.held else ELECTORATE):
            self._beats.append((kind, autopilot))
            kinds, autopilots = np.array(self._beats).T
            self.kind, self.autopilot = identity({"type": kinds, "autopilot": autopilots})


class Senders:
    """All senders of a link and the one that is followed.

    Attributes:
        followed: None before it is known which.
        others: frames of senders of which nothing is kept any more.
        obstacle: why none is followed, one sentence; empty when one is.
    """

    def __init__(self, wanted: str | None) -> None:
        """Takes which vehicle to follow, "system" or "system:component"; None for the only one."""
        self.followed: Sender | None = None
        self.others = 0
        self.obstacle = "No vehicle is heard yet." if wanted is None else f"Vehicle {wanted} is not heard yet."
        self._wanted = wanted
        self._senders: dict[int, Sender] = {}
        self._rivals: set[int] = set()
        self._sentences: list[str] = []

    def __iter__(self) -> Iterator[Sender]:
        """Those that are kept, by system and component."""
        return iter([sender for _, sender in sorted(self._senders.items())])

    def sentences(self) -> list[str]:
        """What became known since the last call."""
        told, self._sentences = self._sentences, []
        return told

    def of(self, frame: Frame) -> Sender:
        """The sender of a frame."""
        key = frame.system << 8 | frame.component
        sender = self._senders.get(key)
        if sender is None:
            if len(self._senders) >= MOST_SENDERS:
                self._make_room()
            sender = self._senders[key] = Sender(frame.system, frame.component)
        return sender

    def get(self, system: int, component: int) -> Sender | None:
        """The sender of these ids, if anything is kept of it."""
        return self._senders.get(system << 8 | component)

    def decide(self, sender: Sender) -> None:
        """Follows this sender, from which a message came, if it is the one to follow."""
        if self.followed is not None:
            self._notice(sender)
        elif self._wanted is not None:
            if self._wanted == sender.name or (self._wanted == str(sender.system) and sender.told):
                self._follow(sender)
        elif sender.told:
            flying = [one for one in self if one.flies] or [one for one in self if one.kind in MULTIROTORS]
            if flying == [sender]:
                self._follow(sender)
            elif len(flying) > 1 and self._rivals != (rivals := {one.system << 8 | one.component for one in flying}):
                self._rivals = rivals
                choose = f"choose one, for example with `--vehicle {flying[0].name}`."
                self.obstacle = f"Several vehicles are heard: {choose}"
                listed = ", ".join(f"{one.name} ({one.kind}, {one.autopilot})" for one in flying[:MOST_LISTED])
                listed += " and more" * (len(flying) > MOST_LISTED)
                self._sentences.append(f"There are several vehicles: {listed}. {choose.capitalize()}")

    def _follow(self, sender: Sender) -> None:
        self.followed, sender.held, self.obstacle = sender, True, ""
        known = f" ({sender.kind}, {sender.autopilot})" if sender.kind != UNNAMED else ""
        self._sentences.append(f"Following vehicle {sender.name}{known}.")

    def _notice(self, sender: Sender) -> None:
        """Another vehicle, once."""
        key = sender.system << 8 | sender.component
        if sender is self.followed or key in self._rivals or not (sender.known and sender.flies):
            return
        if len(self._rivals) < MOST_SENDERS:
            self._rivals.add(key)
            assert self.followed is not None
            self._sentences.append(
                f"Vehicle {sender.name} ({sender.kind}, {sender.autopilot}) is heard too; {self.followed.name} is "
                "still followed."
            )

    def _make_room(self) -> None:
        key, least = min(
            ((key, one) for key, one in self._senders.items() if one is not self.followed),
            key=lambda entry: entry[1].frames,
        )
        self.others += least.frames
        del self._senders[key]
