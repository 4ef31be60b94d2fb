"""The senders on a link, which of them are vehicles, and which one is followed: once chosen, it stays.

What a sender is, most of its first HEARTBEATs decide, as in a recorded stream. All that is kept is bounded: beyond
that, the sender with the fewest frames is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from mavdem.alignment.signals import ATTITUDE_MESSAGES
from mavdem.ingest.mavlink.definitions import definitions
from mavdem.ingest.mavlink.framing import GOOD
from mavdem.ingest.mavlink.vehicles import identity, missing_between
from mavdem.ingest.motors import MULTIROTORS
from mavdem.ingest.vocabulary import RADIO, RADIO_MESSAGES, UNNAMED
from mavdem.live.messages import Frame, Message

MAX_SENDERS = 64
MAX_PARAMETERS = 2048  # Parameters kept of each; autopilots have up to 1500
VOTING_HEARTBEATS = 31  # HEARTBEATs that decide what a sender is; later ones change nothing
ENOUGH_MESSAGES = 3
"""HEARTBEATs, and messages of attitude, before a vehicle is followed: about three seconds in which another may show."""
MAX_LISTED = 8  # Vehicles named in one sentence


@dataclass(eq=False)
class Sender:
    """One component on the link."""

    system: int  # with component: MAVLink ids
    component: int
    attitudes: int = 0  # number of messages of attitude
    frames: int = 0  # number of frames, unread ones included
    # number of messages by id, damaged and unknown ones excluded
    arrived: dict[int, int] = field(default_factory=dict, repr=False)
    parameters: dict[bytes, Message] = field(default_factory=dict, repr=False)  # the last PARAM_VALUEs
    kind: str = UNNAMED  # with autopilot: names of the MAV_TYPE and MAV_AUTOPILOT that most of its HEARTBEATs have
    autopilot: str = UNNAMED
    # whether ``ENOUGH_MESSAGES`` of them decide that: a flood of forged ones must not change the followed one
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
        """Whether enough HEARTBEATs have come, or none can be expected."""
        return len(self._beats) >= ENOUGH_MESSAGES or (not self._beats and self.attitudes >= 500)

    @property
    def flies(self) -> bool:
        """Whether it sends attitude and is, as far as known, a multirotor."""
        return self.kind in (*MULTIROTORS, UNNAMED) and self.attitudes >= ENOUGH_MESSAGES

    @property
    def can_be_followed(self) -> bool:
        """Whether it is known what it is and whether it sends attitude."""
        # Many autopilots send nothing but HEARTBEATs until asked.
        mute = self.kind in MULTIROTORS and len(self._beats) >= 5 and not self.attitudes
        return mute or (self.known and self.flies)

    def take(self, frame: Frame) -> bool:
        """Counts a frame; returns False for a copy of the last one, which some links send."""
        self.frames += 1
        if frame == self._last:
            return False
        if self._last is not None:
            self._missing += missing_between(self._last.sequence, frame.sequence)
        self._last = frame
        if frame.verdict == GOOD:
            self.arrived[frame.message_id] = self.arrived.get(frame.message_id, 0) + 1
            if self.kind in (UNNAMED, RADIO) and not self._beats:
                names = {definitions()[number].name for number in self.arrived}
                self.kind = RADIO if RADIO_MESSAGES.issuperset(names) else UNNAMED
            self.attitudes += definitions()[frame.message_id].name in ATTITUDE_MESSAGES
        return True

    def take_parameter(self, message: Message) -> bool:
        """Keeps a PARAM_VALUE; returns whether it is new."""
        name = message.values[0]
        if self.parameters.get(name) == message or (
            name not in self.parameters and len(self.parameters) >= MAX_PARAMETERS
        ):
            return False
        self.parameters[name] = message
        return True

    def take_heartbeat(self, message: Message) -> None:
        """Counts the type and autopilot in a HEARTBEAT."""
        kind, autopilot, *_ = message.values
        if len(self._beats) < (ENOUGH_MESSAGES if self.held else VOTING_HEARTBEATS):
            self._beats.append((kind, autopilot))
            kinds, autopilots = np.array(self._beats).T
            self.kind, self.autopilot = identity({"type": kinds, "autopilot": autopilots})


class Senders:
    """All senders of a link and the one that is followed: ``wanted``, "system" or "system:component", or the only one.

    ``followed``: the chosen vehicle; None before the choice. ``obstacle``: why none is followed, one sentence; empty
    when one is.
    """

    def __init__(self, wanted: str | None, report: Callable[[str], None]) -> None:
        self.followed: Sender | None = None
        self.obstacle = "No vehicle found yet." if wanted is None else f"Vehicle {wanted} not found yet."
        self._wanted = wanted
        self._senders: dict[int, Sender] = {}
        self._rivals: set[int] = set()
        self._report = report

    def __iter__(self) -> Iterator[Sender]:
        """The senders that are kept, by system and component."""
        return iter([sender for _, sender in sorted(self._senders.items())])

    def of(self, frame: Frame) -> Sender:
        """The sender of a frame."""
        key = frame.system << 8 | frame.component
        sender = self._senders.get(key)
        if sender is None:
            if len(self._senders) >= MAX_SENDERS:
                others = [key for key, other in self._senders.items() if other is not self.followed]
                del self._senders[min(others, key=lambda key: self._senders[key].frames)]
            sender = self._senders[key] = Sender(frame.system, frame.component)
        return sender

    def get(self, system: int, component: int) -> Sender | None:
        """The sender with these ids, if it is kept."""
        return self._senders.get(system << 8 | component)

    def decide(self, sender: Sender) -> None:
        """Follows this sender, which sent a message, if it is the one to follow."""
        if self.followed is not None:
            self._notice(sender)
        elif self._wanted is not None:
            if self._wanted == sender.name or (self._wanted == str(sender.system) and sender.can_be_followed):
                self._follow(sender)
        elif sender.can_be_followed:
            flying = [other for other in self if other.flies] or [other for other in self if other.kind in MULTIROTORS]
            if flying == [sender]:
                self._follow(sender)
            elif len(flying) > 1 and self._rivals != (
                rivals := {other.system << 8 | other.component for other in flying}
            ):
                self._rivals = rivals
                choose = f"choose one, for example with `--vehicle {flying[0].name}`."
                self.obstacle = f"Several vehicles found: {choose}"
                listed = ", ".join(f"{other.name} ({other.kind}, {other.autopilot})" for other in flying[:MAX_LISTED])
                listed += " and more" * (len(flying) > MAX_LISTED)
                self._report(f"Several vehicles found: {listed}. {choose.capitalize()}")

    def _follow(self, sender: Sender) -> None:
        self.followed, sender.held, self.obstacle = sender, True, ""
        known = f" ({sender.kind}, {sender.autopilot})" if sender.kind != UNNAMED else ""
        self._report(f"Following vehicle {sender.name}{known}.")

    def _notice(self, sender: Sender) -> None:
        """Reports another vehicle, once."""
        key = sender.system << 8 | sender.component
        if sender is self.followed or key in self._rivals or not (sender.known and sender.flies):
            return
        if len(self._rivals) < MAX_SENDERS:
            self._rivals.add(key)
            assert self.followed is not None
            self._report(
                f"Vehicle {sender.name} ({sender.kind}, {sender.autopilot}) found too; still following "
                f"{self.followed.name}."
            )
