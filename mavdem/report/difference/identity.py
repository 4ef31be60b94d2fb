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

    The reader is warned if only one of the flights was simulated, if a log does not name its vehicle, if the logs name
    two vehicles, or if the name is a MAVLink system id, which many vehicles share.

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
    """Returns the warning that the flights may be of different vehicles, unless the headline says that they are.

    Args:
        reviewed: comparison of two states.
    """
    if reviewed.are_two_vehicles:
        return []
    return identity_cautions(reviewed)


def shown_vehicles(reviewed: ReviewedDifference, side: str) -> list[str]:
    """Returns the vehicles of a side as they are shown to the reader.

    Args:
        reviewed: comparison of two states, with the names of the vehicles in their logs, and the reviews of these.
        side: "A" or "B".

    Returns:
        For a system id what the vehicle is, such as "unnamed PX4 quadrotor"; for a serial number the type of the frame
        with the first and last characters; any other name as it is.
    """
    difference = reviewed.difference
    frame = value_at(reviewed.reviews.get(side, {}), "identity.frame") or ""
    names = dict(zip(STATE_NAMES, difference.vehicles, strict=True))[side]
    vehicles = []
    for name in names:
        if name == UNKNOWN:
            vehicles.append(unnamed_vehicle("", frame))
        else:
            is_shared = name in difference.shared
            vehicles.append(vehicle_label(name, frame, NO_NAMES, is_shared=is_shared))
    return vehicles
