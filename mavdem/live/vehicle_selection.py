"""The MAVLink components on a link, which of them are vehicles, and which vehicle is followed.

Once a vehicle is selected, it stays. The latest HEARTBEAT of a component says what it is, but a multirotor stays one.
What is kept of each component is bounded.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from math import inf
from typing import NamedTuple

from mavdem.dataset.attitude import ATTITUDE_MESSAGES
from mavdem.facts import Fact
from mavdem.facts.session import VehicleFact
from mavdem.immutable import freeze
from mavdem.ingest.mavlink.dialect import definitions_by_id, enum_name
from mavdem.ingest.mavlink.frame_reader import Frame
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.mavlink.sender_links import SenderLinks
from mavdem.ingest.mavlink.sequence_counters import SEQUENCE_NUMBERS
from mavdem.ingest.mavlink.vehicles import PARAMETER_STORE_COMPONENT
from mavdem.ingest.motors import MULTIROTORS, POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.live.messages import Message, parameters_by_name
from mavdem.live.recent_messages import MAX_ROWS
from mavdem.live.vehicle_state import autopilot_name

MIN_MESSAGES = 3
"""HEARTBEATs, and messages of attitude, before a vehicle is followed: a choice.

HEARTBEATs come once a second, so another vehicle has some seconds to appear.
"""

MIN_HEARTBEATS_WITHOUT_ATTITUDE = 5
"""HEARTBEATs before a vehicle is followed that sends no attitude: a choice, some seconds."""

MIN_ATTITUDES_WITHOUT_HEARTBEAT = 500
"""Messages of attitude before a component is followed that sends no HEARTBEAT: a choice, 5 s at 100 Hz."""

MAX_LISTED_VEHICLES = 8
"""Vehicles that are named in one sentence: a choice."""

MAX_COUNTED_GAP = 1.0
"""Longest time between two frames that counts in their mean interval, s: a choice, so that no pause changes it much."""

INTERVAL_MEMORY_FRAMES = 64
"""Frames over which the mean interval between them is averaged: a choice."""


class Component:
    """One MAVLink component on the link, such as an autopilot: what it is, and how many of its messages came.

    Attributes:
        system: its system id.
        component: its component id.
        name: both, "system:component".
        vehicle_type: name of the MAV_TYPE in its latest HEARTBEAT, or in the latest one of a multirotor.
        autopilot: name of the MAV_AUTOPILOT in its latest HEARTBEAT.
        confirmed_autopilot: the MAV_AUTOPILOT by several HEARTBEATs, whose parameters are kept.
        attitude_count: number of its messages of attitude.
        frame_count: number of its frames, undecoded ones and copies included.
        message_counts: number of its messages by id, without damaged and unknown ones.
        parameters: the latest PARAM_VALUE of each parameter, by name; without those of another kind of autopilot that
            had these ids before.
        parameters_version: increases whenever ``parameters`` is written: the same version means the same values.
        uncounted_gap_seconds: duration of the gaps in which its sequence numbers may have wrapped, s.
    """

    def __init__(self, system: int, component: int) -> None:
        """Begins without a frame, for the component with these ids."""
        self.system = system
        self.component = component
        self.name = f"{system}:{component}"
        self.vehicle_type = UNNAMED
        self.autopilot = UNNAMED
        self.attitude_count = 0
        self.frame_count = 0
        self.message_counts = Counter[int]()
        self.parameters: dict[bytes, Message] = {}
        self.parameters_version = 0
        self.uncounted_gap_seconds = 0.0
        self._heartbeat_count = 0
        self.confirmed_autopilot = UNNAMED
        # How many HEARTBEATs in a row have stated another autopilot than the confirmed one.
        self._other_autopilot_count = 0
        # The parameters that came since the latest HEARTBEAT of the confirmed autopilot.
        self._newest_parameters: dict[bytes, Message] = {}
        self._links = SenderLinks()
        # Missing messages that are not counted, since the gap was too long to count them.
        self._uncounted_messages = 0
        self._last_sequence = 0
        # When the last frame was received, and the mean interval between frames so far, s.
        self._last_frame_time = -inf
        self._mean_interval = 1.0

    @property
    def lost_messages(self) -> int:
        """Number of messages that were not received, by the gaps in its sequence numbers.

        A message that was overtaken counts as missing until it comes, so that the sum may be negative for a moment.
        """
        return max(self._links.missing - self._uncounted_messages, 0)

    @property
    def has_two_senders(self) -> bool:
        """Whether two vehicles send under these ids at present."""
        return self._links.are_two_vehicles

    @property
    def is_identified(self) -> bool:
        """Whether enough HEARTBEATs have come, or none can be expected any more."""
        if self._heartbeat_count:
            return self._heartbeat_count >= MIN_MESSAGES
        return self.attitude_count >= MIN_ATTITUDES_WITHOUT_HEARTBEAT

    @property
    def sends_attitude(self) -> bool:
        """Whether it sends attitude and is, as far as is known, a multirotor."""
        return self.vehicle_type in POSSIBLE_MULTIROTORS and self.attitude_count >= MIN_MESSAGES

    @property
    def is_other_vehicle(self) -> bool:
        """Whether this component certainly is a vehicle of another kind than a multirotor, such as a plane.

        Components that are no autopilots, such as ground stations and cameras, state the autopilot INVALID.
        """
        is_autopilot = self.autopilot not in (UNNAMED, "INVALID")
        is_certain = self._heartbeat_count >= MIN_MESSAGES
        may_be_multirotor = self.vehicle_type in POSSIBLE_MULTIROTORS
        return is_autopilot and is_certain and not may_be_multirotor

    @property
    def can_be_followed(self) -> bool:
        """Whether it is certain enough that this component is a multirotor, which can be followed.

        Usually it has identified itself and sends attitude. It may also have sent HEARTBEATs of a multirotor for some
        seconds without attitude, since many autopilots send nothing else until they are asked.
        """
        if self.is_identified and self.sends_attitude:
            return True
        has_waited_for_attitude = self._heartbeat_count >= MIN_HEARTBEATS_WITHOUT_ATTITUDE
        is_without_attitude = self.attitude_count == 0
        is_multirotor = self.vehicle_type in MULTIROTORS
        return is_multirotor and has_waited_for_attitude and is_without_attitude

    @property
    def description(self) -> str:
        """Its name and, where they are known, type and autopilot in words, as in "1:1 (quadrotor, ArduPilot)"."""
        if self.vehicle_type == UNNAMED:
            return self.name
        vehicle_type = self.vehicle_type.replace("_", " ").lower()
        return f"{self.name} ({vehicle_type}, {autopilot_name(self.autopilot)})"

    def has_sent(self, frame: Frame) -> bool:
        """Returns whether a frame has this component's ids."""
        return (frame.system, frame.component) == (self.system, self.component)

    def count_frame(self, frame: Frame, now: float) -> bool:
        """Counts a frame of this component and the messages that are missing before it, unless it is a copy.

        Args:
            frame: the frame, in the order of arrival.
            now: reception time, s of any clock, since only differences are used.

        Returns:
            Whether the frame is new; False for a copy of an earlier frame, which a second link delivers and the caller
            ignores.
        """
        self.frame_count += 1
        is_readable = frame.checksum == CHECKSUM_MATCHES
        missing_before = self._links.missing
        is_new = self._links.process_frame(
            frame.content, frame.message_id, frame.sequence, is_readable
        )
        if not is_new:
            return False
        self._note_gap(frame.sequence, now, self._links.missing - missing_before)
        if is_readable:
            self.message_counts[frame.message_id] += 1
            if definitions_by_id()[frame.message_id].name in ATTITUDE_MESSAGES:
                self.attitude_count += 1
        return True

    def _note_gap(self, sequence: int, now: float, missing_messages: int) -> None:
        """Notes the gap before a new frame, and counts its duration instead of its missing messages if it was long.

        Each sender numbers its messages from 0 to 255 and then from 0 again. The step between two numbers is the number
        of missing messages plus one, but not after a long gap, in which the numbers may have wrapped once or more. A
        gap counts as long if 128 messages or more would usually come in it, by the mean interval between frames.

        Args:
            sequence: sequence number of the frame.
            now: reception time, s of the clock of :meth:`count_frame`.
            missing_messages: number of messages that are missing in the gap by the sequence numbers.
        """
        # The first frame comes after an infinite gap, in which nothing is missing.
        gap = max(now - self._last_frame_time, 0.0)
        if self._may_have_wrapped(gap, sequence):
            self.uncounted_gap_seconds += gap
            self._uncounted_messages += missing_messages
        self._last_frame_time = now
        self._last_sequence = sequence
        self._update_mean_interval(gap)

    def _update_mean_interval(self, gap: float) -> None:
        """Updates the mean interval between frames, an exponential average over about ``INTERVAL_MEMORY_FRAMES``.

        A long gap counts as ``MAX_COUNTED_GAP`` only, so that a single one does not change the mean much.

        Args:
            gap: time since the frame before, s; infinite for the first frame.
        """
        counted_gap = min(gap, MAX_COUNTED_GAP)
        self._mean_interval += (counted_gap - self._mean_interval) / INTERVAL_MEMORY_FRAMES

    def _may_have_wrapped(self, gap: float, sequence: int) -> bool:
        """Returns whether the sequence numbers may have wrapped in the gap before a frame: it was long.

        A frame with the very next number ends a pause of the sender, in which nothing was sent or lost.

        Args:
            gap: time since the frame before, s; infinite for the first frame.
            sequence: sequence number of the frame.
        """
        # Half of all sequence numbers would usually be sent in this time.
        wrap_seconds = SEQUENCE_NUMBERS / 2 * self._mean_interval
        is_long_gap = wrap_seconds < gap < inf
        is_next_number = (sequence - self._last_sequence) % SEQUENCE_NUMBERS == 1
        return is_long_gap and not is_next_number

    def add_message(self, message: Message) -> None:
        """Stores what a message states about its component: a parameter, or from a HEARTBEAT type and autopilot.

        Other messages change nothing. The number of parameters is bounded, against hostile input.

        Args:
            message: any message of this component.
        """
        if message.name == "PARAM_VALUE":
            parameter = message.values[0]
            if parameter in self.parameters or len(self.parameters) < MAX_ROWS:
                self.parameters[parameter] = message
                self._newest_parameters[parameter] = message
                self.parameters_version += 1
        elif message.name == "HEARTBEAT":
            self._heartbeat_count += 1
            vehicle_type = enum_name("MAV_TYPE", message.values[0])
            # A vehicle that has once sent the type of a multirotor keeps it: a HEARTBEAT of another type is damaged,
            # or only claims to come from this component.
            if self.vehicle_type not in MULTIROTORS or vehicle_type in MULTIROTORS:
                self.vehicle_type = vehicle_type
            self.autopilot = enum_name("MAV_AUTOPILOT", message.values[1])
            self._drop_parameters_of_other_autopilot()

    def _drop_parameters_of_other_autopilot(self) -> None:
        """Drops the parameters of another kind of autopilot than the latest HEARTBEATs state, if there are any.

        Another vehicle may follow under these ids, and parameters of the first one would describe its motors wrongly.
        The new autopilot may send its parameters before its first HEARTBEAT, so that all are kept that came after the
        last HEARTBEAT of the former one. A few HEARTBEATs are awaited, since a single one may be damaged or forged.
        """
        if self.confirmed_autopilot in (UNNAMED, self.autopilot):
            self.confirmed_autopilot = self.autopilot
            self._other_autopilot_count = 0
            self._newest_parameters.clear()
            return
        self._other_autopilot_count += 1
        if self._other_autopilot_count >= MIN_MESSAGES:
            self.parameters = dict(self._newest_parameters)
            self.parameters_version += 1
            self.confirmed_autopilot = self.autopilot
            self._other_autopilot_count = 0


class _ParameterSource(NamedTuple):
    """What the parameters of a vehicle were decoded from: where it is the same, they need not be decoded again."""

    vehicle: str
    """Name of the vehicle."""

    autopilot: str
    """Name of its MAV_AUTOPILOT, which decides how integers are encoded."""

    version: int
    """``parameters_version`` of the vehicle."""

    store_version: int
    """``parameters_version`` of the component that stores them, too; 0 without one."""


class VehicleSelector:
    """Selects the vehicle to follow among all components of a link: the one that the user named, or the only one.

    Attributes:
        followed: the vehicle that is followed; None before one is selected.
        not_followed_reason: why none is followed; None when one is.
        components: all components of the link, by system and component id.
        other_vehicles: names of the vehicles that were reported, and are not followed.
    """

    def __init__(self, wanted: str | None, report: Callable[[Fact], None]) -> None:
        """Begins without a component.

        Args:
            wanted: "system" or "system:component"; None for the only vehicle of the link.
            report: is called with each fact about the selection.
        """
        self.followed: Component | None = None
        self.not_followed_reason: Fact | None = Fact(
            VehicleFact.NO_VEHICLE_YET, subject=wanted or ""
        )
        self.components: dict[tuple[int, int], Component] = {}
        self.other_vehicles: set[str] = set()
        self._wanted = wanted
        self._report = report
        # The ``confirmed_autopilot`` of the followed vehicle when that was reported last.
        self._followed_autopilot = UNNAMED
        # Names of the components under whose ids two vehicles were found to send.
        self._refused = set[str]()
        # What the decoded parameters were decoded from, and their values by name; None before they are used first.
        self._parameter_source: _ParameterSource | None = None
        self._decoded_parameters: Parameters = {}

    @property
    def followed_parameters(self) -> Parameters:
        """The followed vehicle's parameters received so far, by name; also those that MAVProxy stores for it.

        MAVProxy answers requests itself, as another component of the same system, with the parameters that it has read
        before. The mapping stays the same object until another parameter comes.
        """
        vehicle = self.followed
        if vehicle is None:
            return {}
        store = self.components.get((vehicle.system, PARAMETER_STORE_COMPONENT))
        # Decoding takes long, so that it is only done again when one of these has changed.
        store_version = 0 if store is None else store.parameters_version
        source = _ParameterSource(
            vehicle.name, vehicle.autopilot, vehicle.parameters_version, store_version
        )
        if source != self._parameter_source:
            self._parameter_source = source
            self._decoded_parameters = _decoded_parameters(vehicle, store)
        return self._decoded_parameters

    def __iter__(self) -> Iterator[Component]:
        """Iterates over the components by system and component id."""
        for _, component in sorted(self.components.items()):
            yield component

    def sender(self, frame: Frame) -> Component:
        """Returns the component that sent a frame."""
        ids = (frame.system, frame.component)
        if ids not in self.components:
            self.components[ids] = Component(frame.system, frame.component)
        return self.components[ids]

    def update(self, sender: Component) -> None:
        """Decides, after each intact message, whether its sender is the vehicle to follow, or another one to report.

        Once a vehicle is followed, others are only reported. A vehicle that the user named is followed as soon as it
        sends anything or, if only its system was named, once it is certain to be a multirotor. If the user named none,
        the only multirotor of the link is followed; among several the user must choose. Vehicles that send attitude
        come first, since it is not known of the others whether they fly at all.

        Args:
            sender: component that has just sent a message, which is counted already.
        """
        if sender.has_two_senders:
            self._refuse_duplicate_ids(sender)
        elif sender is self.followed:
            self._report_other_autopilot(sender)
        elif self.followed is not None:
            self._report_other_vehicle(sender, self.followed)
        elif self._wanted is not None:
            if self._is_wanted(sender):
                self._follow(sender)
        elif sender.can_be_followed:
            self._follow_if_only_candidate(sender)
        elif sender.is_other_vehicle and not self.other_vehicles:
            self.not_followed_reason = Fact(
                VehicleFact.NO_MULTIROTOR_YET,
                subject=sender.name,
                vehicle_type=sender.vehicle_type,
            )

    def _is_wanted(self, sender: Component) -> bool:
        """Returns whether a component is the vehicle that the user has named, and can be followed.

        Args:
            sender: the component. The user has named it ("1:1"), or a system ("1") that may have other components, too.
        """
        is_wanted_component = self._wanted == sender.name
        is_of_wanted_system = self._wanted == str(sender.system)
        return is_wanted_component or (is_of_wanted_system and sender.can_be_followed)

    def _follow_if_only_candidate(self, sender: Component) -> None:
        """Follows a multirotor if no other one of the link may be followed; among several, the user must choose.

        Args:
            sender: the multirotor, which has just sent a message.
        """
        candidates = self._candidates()
        if candidates == [sender]:
            self._follow(sender)
        elif len(candidates) > 1:
            self._report_choice(candidates)

    def _candidates(self) -> list[Component]:
        """Returns the vehicles that may be followed: those that send attitude or, if none does, all multirotors."""
        with_attitude = [component for component in self if component.sends_attitude]
        if with_attitude:
            return with_attitude
        return [component for component in self if component.vehicle_type in MULTIROTORS]

    def _refuse_duplicate_ids(self, sender: Component) -> None:
        """Stops following ids under which two vehicles send, and reports it once.

        The messages of the two cannot be distinguished, so that alarms about them would be false. Once one of them is
        silent, the other may be followed.

        Args:
            sender: the ids, as the component that has just sent a message.
        """
        fact = Fact(VehicleFact.TWO_VEHICLES_LIVE, subject=sender.name)
        if self.followed is sender:
            self.followed = None
        # A third vehicle may still be followed.
        if self.followed is None:
            self.not_followed_reason = fact
        if sender.name not in self._refused:
            self._refused.add(sender.name)
            self._report(fact)

    def _follow(self, vehicle: Component) -> None:
        """Follows a vehicle from now on."""
        self.followed = vehicle
        self.not_followed_reason = None
        self._followed_autopilot = vehicle.confirmed_autopilot
        self._report(Fact(VehicleFact.FOLLOWING_VEHICLE, subject=vehicle.description))

    def _report_other_autopilot(self, vehicle: Component) -> None:
        """Reports that another kind of autopilot has the ids of the followed vehicle now, and is followed.

        Args:
            vehicle: the followed vehicle, which has just sent a message.
        """
        former_autopilot = self._followed_autopilot
        if vehicle.confirmed_autopilot == former_autopilot:
            return
        self._followed_autopilot = vehicle.confirmed_autopilot
        if former_autopilot != UNNAMED:
            self._report(Fact(VehicleFact.FOLLOWING_VEHICLE, subject=vehicle.description))

    def _report_choice(self, vehicles: list[Component]) -> None:
        """Reports that the user must choose one of several vehicles, unless these were reported already.

        Until the user has chosen, that is the reason why none is followed, and all of them are watched for alarms
        (``other_vehicles``).

        Args:
            vehicles: the vehicles, by system and component id; at least two.
        """
        names = {vehicle.name for vehicle in vehicles}
        if names == self.other_vehicles:
            return
        self.other_vehicles = names
        first_name = vehicles[0].name
        self.not_followed_reason = Fact(VehicleFact.CHOOSE_VEHICLE, name=first_name)
        # Of many vehicles the report lists the first ones, and how many others there are.
        listed = [vehicle.description for vehicle in vehicles[:MAX_LISTED_VEHICLES]]
        unlisted_count = max(len(vehicles) - MAX_LISTED_VEHICLES, 0)
        self._report(
            Fact(VehicleFact.VEHICLES_FOUND, name=first_name, names=listed, others=unlisted_count)
        )

    def _report_other_vehicle(self, sender: Component, followed: Component) -> None:
        """Reports a vehicle besides the followed one, once it is certain, and has it watched for alarms from then on.

        Args:
            sender: component that has just sent a message, not the followed vehicle.
            followed: the vehicle that is followed.
        """
        if sender.name in self.other_vehicles:
            return
        if not (sender.is_identified and sender.sends_attitude):
            return
        self.other_vehicles.add(sender.name)
        self._report(
            Fact(VehicleFact.OTHER_VEHICLE, subject=sender.description, name=followed.name)
        )


def _decoded_parameters(vehicle: Component, store: Component | None) -> Parameters:
    """Returns the parameters of a vehicle by name, from its own messages and the messages of a store.

    Args:
        vehicle: the autopilot whose parameters are decoded.
        store: component that sends parameters of the vehicle as it read them before; what the vehicle has sent itself
            replaces them. None without one.
    """
    # The messages PARAM_VALUE by the name of the parameter.
    messages: dict[bytes, Message] = {}
    if store is not None:
        messages.update(store.parameters)
    messages.update(vehicle.parameters)
    if not messages:
        return {}
    # Each ``Telemetry`` of the vehicle has the same mapping: one that could be changed would be copied for each.
    return freeze(parameters_by_name(messages.values(), vehicle.autopilot))
