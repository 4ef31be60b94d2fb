"""Whether two states are of one vehicle, and the warning where they are not, or where that is not known."""

from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.names import NO_NAMES
from mavdem.fleet.report_columns import value_at
from mavdem.fleet.row import UNKNOWN
from mavdem.report.blocks import Sentence, caution
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.fleet import unnamed_vehicle, vehicle_label
from mavdem.report.templates import render_section


def identity_cautions(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the warning that the compared flights may be of different vehicles; empty if they are of one vehicle.

    The reader is warned if one of the flights was simulated and the other is of a real vehicle, if a log does not name
    its vehicle, if the logs name two vehicles, or if the name is a MAVLink system id, which many vehicles share.

    Args:
        reviewed: comparison of two states, with the names of the vehicles in the logs of both.
    """
    difference = reviewed.difference
    first_side, second_side = STATE_NAMES
    if reviewed.is_simulation_against_flight:
        (simulated_side,) = reviewed.simulated_sides
        recorded_side = second_side if simulated_side == first_side else first_side
        sentences = render_section(
            "difference_simulated", simulated_side=simulated_side, recorded_side=recorded_side
        )
        return [caution(sentence.text) for sentence in sentences]
    has_unnamed_vehicle = UNKNOWN in difference.vehicles.before + difference.vehicles.after
    if has_unnamed_vehicle and not difference.is_of_two_vehicles:
        return render_section("difference_unnamed")
    sentences = render_section(
        "difference_vehicles",
        before=shown_vehicles(reviewed, first_side),
        after=shown_vehicles(reviewed, second_side),
        are_two_vehicles=difference.is_of_two_vehicles,
        shared_names=difference.shared,
    )
    return [caution(sentence.text) for sentence in sentences]


def identity_remarks(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the warning that the compared flights may be of different vehicles, for the text below the headline.

    If they are known to be of different vehicles, the headline of the comparison says so, and there is no warning here.

    Args:
        reviewed: comparison of two states.
    """
    if reviewed.are_two_vehicles:
        return []
    return identity_cautions(reviewed)


def shown_vehicles(reviewed: ReviewedDifference, side: str) -> list[str]:
    """Returns the vehicles of one of the two compared states, as they are shown to the reader.

    A log identifies its vehicle by a serial number, by a name, or only by its MAVLink system id, a number that many
    vehicles share. Names that owners gave to vehicles are not used here.

    Args:
        reviewed: comparison of two states, with the names of the vehicles in their logs, and the reviews of these.
        side: name of the state, "A" or "B".

    Returns:
        A text for each vehicle of the state. A vehicle with only a system id is described by its type, such as "unnamed
        PX4 quadrotor". A serial number is shortened and follows the type of the frame, as in "Quadrotor 3A0041…2B37".
        Any other name is returned as it is.
    """
    difference = reviewed.difference
    frame = value_at(reviewed.reviews.get(side, {}), "identity.frame") or ""
    names_by_side = dict(zip(STATE_NAMES, difference.vehicles, strict=True))
    shown_names = []
    for name in names_by_side[side]:
        if name == UNKNOWN:
            # The log does not identify its vehicle at all. A name made of a system id would contain the autopilot.
            shown_names.append(unnamed_vehicle(autopilot="", frame=frame))
        else:
            is_system_id = name in difference.shared
            shown_names.append(vehicle_label(name, frame, NO_NAMES, is_shared=is_system_id))
    return shown_names
