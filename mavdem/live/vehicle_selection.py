"""The senders on a link, which of them are vehicles, and which one is followed: once chosen, it stays.

What a sender is, its latest HEARTBEAT decides. What is kept of each is bounded.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from math import inf

from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.facts import Fact
from mavdem.facts.session import VehicleFact
from mavdem.ingest.mavlink.definitions import definitions_by_id, enum_name
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.mavlink.vehicles import missing_messages
from mavdem.ingest.motors import MULTIROTORS, POSSIBLE_MULTIROTORS
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.live.messages import Frame, Message
from mavdem.live.recent_messages import MAX_ROWS

# HEARTBEATs, and of attitude, before a vehicle is followed: seconds in which another may show
ENOUGH_MESSAGES = 3
MAX_LISTED = 8  # Vehicles named in one sentence
COPY_FRAMES = 128  # Frames of a sender within which an equal one is a copy: half of its numbers


class Component:
    """One component on the link, by its MAVLink ids."""

    def __init__(self, system: int, component: int) -> None:
        self.system = system
        self.component = component
        self.name = f"{system}:{component}"
        # MAV_TYPE and MAV_AUTOPILOT of its latest HEARTBEAT
        self.kind = self.autopilot = UNNAMED
        self.attitudes = self.frames = 0  # messages of attitude, and frames, unread ones included
        # number of messages by id, damaged and unknown ones excluded
        self.arrived = Counter[int]()
        self.parameters: dict[bytes, Message] = {}  # the last PARAM_VALUEs
        self._beats = 0
        # by its number the latest frame, and frames so far then
        self._recent: dict[int, tuple[Frame, int]] = {}
        self._missing = self._last = 0
        self.missing_seconds = 0.0  # of gaps longer than sequence numbers can count
        # s, of the last frame, and mean between two
        self._came = -inf
        self._interval = 1.0

    @property
    def lost(self) -> int:
        """Messages missing by the gaps in its sequence numbers."""
        return max(self._missing, 0)

    @property
    def known(self) -> bool:
        """Whether enough HEARTBEATs have come, or none can be expected."""
        return self._beats >= ENOUGH_MESSAGES or (not self._beats and self.attitudes >= 500)

    @property
    def flies(self) -> bool:
        """Whether it sends attitude and is, as far as known, a multirotor."""
        return self.kind in POSSIBLE_MULTIROTORS and self.attitudes >= ENOUGH_MESSAGES

    @property
    def can_be_followed(self) -> bool:
        """Whether it is known what it is; many autopilots send nothing but HEARTBEATs until asked."""
        mute = self.kind in MULTIROTORS and self._beats >= 5 and not self.attitudes
        return mute or (self.known and self.flies)

    @property
    def identity(self) -> str:
        """Its name, and what it is where that is known."""
        return f"{self.name} ({self.kind}, {self.autopilot})" if self.kind != UNNAMED else self.name

    def take(self, frame: Frame, now: float) -> bool:
        """Counts a frame that came ``now``, s; returns False for a copy, as some links send."""
        self.frames += 1
        number = frame.sequence
        same, then = self._recent.get(number, (None, 0))
        if same == frame and self.frames - then < COPY_FRAMES:
            return False
        self._recent[number] = frame, self.frames
        self._count_missing(number, now, missing_messages(self._last, number))
        self._last = number
        if frame.checksum == CHECKSUM_MATCHES:
            self.arrived[frame.message_id] += 1
            self.attitudes += definitions_by_id()[frame.message_id].name in ATTITUDE_MESSAGES
        return True

    def _count_missing(self, number: int, now: float, missing: int) -> None:
        """Counts ``missing`` messages before one that came ``now``, s; a long gap in seconds, since numbers wrap."""
        gap = max(now - self._came, 0.0)
        self._came = now
        wrapped = (number - self._last) % 256 != 1 and 128 * self._interval < gap < inf
        if wrapped:
            self.missing_seconds += gap
        elif self.frames > 1:
            self._missing += missing
        self._interval += (min(gap, 1.0) - self._interval) / 64

    def take_message(self, message: Message) -> None:
        """Keeps a PARAM_VALUE; takes type and autopilot of a HEARTBEAT."""
        first = message.values[0]
        if message.name == "PARAM_VALUE" and (
            first in self.parameters or len(self.parameters) < MAX_ROWS
        ):
            self.parameters[first] = message
        if message.name == "HEARTBEAT":
            self._beats += 1
            self.kind = enum_name("MAV_TYPE", first)
            self.autopilot = enum_name("MAV_AUTOPILOT", message.values[1])


class VehicleSelector:
    """All senders of a link and the one followed: ``wanted``, "system" or "system:component", or the only one."""

    def __init__(self, wanted: str | None, report: Callable[[Fact], None]) -> None:
        self.followed: Component | None = None
        # why none is followed; None when one is
        self.obstacle: Fact | None = Fact(VehicleFact.NO_VEHICLE_YET, subject=wanted or "")
        self._wanted = wanted
        self.by_ids: dict[tuple[int, int], Component] = {}  # those that are kept
        self.rivals: set[str] = set()
        self._report = report

    def __iter__(self) -> Iterator[Component]:
        """The senders that are kept, by system and component."""
        return (sender for _, sender in sorted(self.by_ids.items()))

    def of(self, frame: Frame) -> Component:
        """Returns the sender of a frame."""
        ids = frame.system, frame.component
        if ids not in self.by_ids:
            self.by_ids[ids] = Component(*ids)
        return self.by_ids[ids]

    def decide(self, sender: Component) -> None:
        """Follows this sender, which sent a message, if it is the one to follow."""
        if self.followed is not None:
            self._notice(sender)
        elif self._wanted is not None:
            if self._wanted == sender.name or (
                self._wanted == str(sender.system) and sender.can_be_followed
            ):
                self._follow(sender)
        elif sender.can_be_followed:
            flying = [other for other in self if other.flies] or [
                other for other in self if other.kind in MULTIROTORS
            ]
            if flying == [sender]:
                self._follow(sender)
            elif len(flying) > 1 and self.rivals != (rivals := {other.name for other in flying}):
                self.rivals = rivals
                name = flying[0].name
                self.obstacle = Fact(VehicleFact.CHOOSE_VEHICLE, name=name)
                self._report(
                    Fact(
                        VehicleFact.VEHICLES_FOUND,
                        name=name,
                        names=[other.identity for other in flying[:MAX_LISTED]],
                        others=max(len(flying) - MAX_LISTED, 0),
                    )
                )

    def _follow(self, sender: Component) -> None:
        self.followed = sender
        self.obstacle = None
        self._report(Fact(VehicleFact.FOLLOWING_VEHICLE, subject=sender.identity))

    def _notice(self, sender: Component) -> None:
        """Reports another vehicle, once."""
        assert self.followed is not None
        if (
            sender is self.followed
            or sender.name in self.rivals
            or not (sender.known and sender.flies)
        ):
            return
        self.rivals.add(sender.name)
        self._report(
            Fact(VehicleFact.OTHER_VEHICLE, subject=sender.identity, name=self.followed.name)
        )
