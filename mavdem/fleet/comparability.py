"""Facts (coded findings) why quantities of two states of a vehicle, before and after a change, cannot be compared."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.facts import Fact
from mavdem.facts.fleet import ComparedSubject, Incomparable
from mavdem.facts.identifiability import Status
from mavdem.facts.vehicle import GENERIC_FRAME
from mavdem.fleet.flights import Flights
from mavdem.fleet.quantities import (
    ATTITUDE_LOOP_KINDS,
    DAMPING,
    EFFECT,
    GAIN_MARGIN,
    LAG,
    MAX_SENSITIVITY,
    OVERSHOOT,
    PHASE_MARGIN,
    RISE,
    SHARE,
    Quantity,
)
from mavdem.fleet.row import FlightRow, FlightRows

STATE_NAMES = ("A", "B")
"""How the two states are called in messages."""

MARGINS = "margins"
"""What messages call the margins of both loops of an axis, as one quantity that cannot be compared."""

LOOP_FIGURE_KINDS = {
    MARGINS: (PHASE_MARGIN, GAIN_MARGIN, MAX_SENSITIVITY, *ATTITUDE_LOOP_KINDS),
    "step response": (OVERSHOOT, RISE),
}
"""Kinds of quantities of the loops of an axis that are estimated together, by what messages call them."""

UNRELIABLE_STATUSES = {Status.BIASED, Status.NOT_IDENTIFIABLE}
"""Statuses of a physical parameter with which it is not compared."""


class MissingQuantity(NamedTuple):
    """What cannot be compared, and the reason."""

    quantity: Fact
    """Names the quantity."""

    reason: Fact
    """Why it is not known in both states."""


def incomparability_reason(states: Sequence[Flights]) -> Fact | None:
    """Returns the reason why two states of a vehicle cannot be compared, or only in part.

    A state is a vehicle in one flight or several, before or after a change. Figures of two states have the same meaning
    only if the number of motors, the unit of trim and the inputs of the models are the same. With other inputs, which
    are checked last, the trim can still be compared, since it needs no model.

    Args:
        states: the flights of the first and of the second state.

    Returns:
        The reason, as a fact with a code of ``Incomparable``; None if all figures can be compared.
    """
    for state_name, flights in zip(STATE_NAMES, states, strict=True):
        if not flights:
            return Fact(Incomparable.NO_FLIGHT, subject=state_name)
    properties = {
        Incomparable.OTHER_VEHICLES: _motor_count,
        Incomparable.OTHER_UNITS: _trim_unit,
        Incomparable.OTHER_INPUTS: _inputs_of_model,
    }
    state_before, state_after = states
    for code, property_of in properties.items():
        values_before = _known_properties(state_before, property_of)
        values_after = _known_properties(state_after, property_of)
        if _are_different(values_before, values_after):
            return Fact(
                code, before=_sorted_texts(values_before), after=_sorted_texts(values_after)
            )
    return None


def has_other_frame(states: Sequence[Flights]) -> bool:
    """Returns whether two states differ in frame or autopilot, so that they are of two vehicles.

    The serial number of the board does not show that: a board that was moved to another frame keeps it.

    Args:
        states: the flights of the first and of the second state.
    """
    state_before, state_after = states
    for property_of in (_frame, _autopilot):
        values_before = _known_properties(state_before, property_of)
        values_after = _known_properties(state_after, property_of)
        if _are_different(values_before, values_after):
            return True
    return False


def have_different_autopilots(rows_before: FlightRows, rows_after: FlightRows) -> bool:
    """Returns whether two states are known to have different autopilots, such as ArduPilot and PX4.

    Args:
        rows_before: rows of the first state's flights in the fleet's table.
        rows_after: rows of the second state's flights.
    """
    autopilots_before = _known_properties([rows_before], _autopilot)
    autopilots_after = _known_properties([rows_after], _autopilot)
    return _are_different(autopilots_before, autopilots_after)


def _are_different(values_before: set[str], values_after: set[str]) -> bool:
    """Returns whether two states are known to differ in a property, such as the autopilot.

    Flights of one state may differ among themselves, so that one value in common is enough to be comparable.

    Args:
        values_before: the known values of the property in the first state.
        values_after: those in the second state.
    """
    are_both_known = bool(values_before) and bool(values_after)
    return are_both_known and values_before.isdisjoint(values_after)


def _known_properties(flights: Flights, property_of: Callable[[FlightRow], str | None]) -> set[str]:
    """Collects the different values of a property, such as the autopilot, over all flights of one state of a vehicle.

    Args:
        flights: the flights, each as rows of the fleet's table, one for each axis.
        property_of: function that returns the property of a row; None or an empty text if it is not known.

    Returns:
        The known values.
    """
    known_values = set()
    for flight in flights:
        for row in flight:
            value = property_of(row)
            if value:
                known_values.add(value)
    return known_values


def _frame(row: FlightRow) -> str | None:
    """Returns the kind of frame, such as "QUADROTOR"; ``None`` if the log names none, or only ``GENERIC_FRAME``."""
    return None if row.frame == GENERIC_FRAME else row.frame


def _autopilot(row: FlightRow) -> str | None:
    """Returns the autopilot, such as "PX4"; ``None`` where it is not known."""
    return row.autopilot


def _motor_count(row: FlightRow) -> str | None:
    """Returns the number of motors in words; ``None`` where it is not known."""
    return f"{len(row.motors)} motors" if row.motors else None


def _trim_unit(row: FlightRow) -> str | None:
    """Returns the unit of the motors' trim; ``None`` where it is not known."""
    return row.trim_unit


def _inputs_of_model(row: FlightRow) -> str | None:
    """Returns the inputs of a flight's model and their unit; ``None`` where it has no model."""
    return f"{row.inputs} {row.input_unit}" if row.effect_status else None


def missing_quantities(
    states: Sequence[Flights],
    estimates: Sequence[Sequence[Iterable[Quantity]]],
    incomparability: Fact | None,
) -> Iterator[MissingQuantity]:
    """Lists the quantities that a reader expects in a comparison of two states, but that could not be compared.

    Expected are the trim shares, the effects of the motors, and damping and motor time constant of roll and pitch.
    So are margins and step responses of roll, pitch, and every axis on which one of the states has them.

    Args:
        states: the flights of both states.
        estimates: quantities that have an estimate, by state and flight.
        incomparability: reason why nothing, or nothing that needs a model, can be compared, from
            :func:`incomparability_reason`; None if all figures can.

    Yields:
        Each quantity with the reason. If nothing can be compared, one entry for all quantities together. If only
        quantities of models cannot be compared, one entry for all of these.
    """
    # The trim share is the mean output of a motor relative to the others, which needs no model.
    expected_quantities = [Quantity(SHARE)]
    if incomparability is None:
        expected_quantities.append(Quantity(EFFECT))
        for kind in (DAMPING, LAG):
            for axis in TILT_AXES:
                expected_quantities.append(Quantity(kind, axis=axis))
    elif incomparability.code is Incomparable.OTHER_INPUTS:
        yield MissingQuantity(Fact(ComparedSubject.OF_MODELS), incomparability)
    else:
        yield MissingQuantity(Fact(ComparedSubject.EVERYTHING), incomparability)
        return
    for quantity in expected_quantities:
        reasons = _reasons_by_state(quantity, (quantity.kind,), states, estimates)
        if reasons:
            yield _missing_quantity(quantity, reasons)
    yield from _missing_loop_figures(states, estimates)


def _missing_loop_figures(
    states: Sequence[Flights], estimates: Sequence[Sequence[Iterable[Quantity]]]
) -> Iterator[MissingQuantity]:
    """Yields the margins and step responses of each axis that not both of two states have, with the reason.

    Those of yaw are left out where neither state has them: its loop is often too slow for margins.

    Args:
        states: the flights of both states.
        estimates: quantities that have an estimate, by state and flight.
    """
    for name, kinds in LOOP_FIGURE_KINDS.items():
        for axis in AXES:
            quantity = Quantity(name, axis=axis)
            reasons = _reasons_by_state(quantity, kinds, states, estimates)
            is_expected = axis in TILT_AXES or len(reasons) < len(STATE_NAMES)
            if reasons and is_expected:
                yield _missing_quantity(quantity, reasons)


def _reasons_by_state(
    quantity: Quantity,
    kinds: Iterable[str],
    states: Sequence[Flights],
    estimates: Sequence[Sequence[Iterable[Quantity]]],
) -> list[Fact]:
    """Returns for each state of a vehicle that does not have a quantity the reason why.

    Args:
        quantity: the quantity as messages call it, such as the margins of pitch.
        kinds: kinds of the quantities that it stands for; a state has it if it has any of these.
        states: the flights of both states.
        estimates: quantities that have an estimate, by state and flight.

    Returns:
        At most one reason for each state; empty if both have the quantity.
    """
    quantities = [Quantity(kind, axis=quantity.axis) for kind in kinds]
    reasons = []
    for state_name, flights, state_estimates in zip(STATE_NAMES, states, estimates, strict=True):
        if not any(_has_estimate(estimated, state_estimates) for estimated in quantities):
            reasons.append(missing_reason(quantity, state_name, flights))
    return reasons


def _missing_quantity(quantity: Quantity, reasons: Sequence[Fact]) -> MissingQuantity:
    """Returns the entry that a quantity cannot be compared, since not both states have it.

    Args:
        quantity: the quantity as messages call it, such as the margins of pitch.
        reasons: for each state without the quantity the reason why.
    """
    return MissingQuantity(
        Fact(ComparedSubject.QUANTITY, subject=quantity.axis, name=quantity.kind),
        Fact(Incomparable.NOT_IN_BOTH, reasons=reasons),
    )


def _has_estimate(quantity: Quantity, estimated_quantities: Sequence[Iterable[Quantity]]) -> bool:
    """Returns whether any flight of a state estimates a quantity of this kind, and of this axis if it has one.

    Args:
        quantity: the quantity. A quantity of motors has no axis (""); the number of its motor is not compared.
        estimated_quantities: quantities that have an estimate, for each flight of the state.
    """
    for quantities_of_flight in estimated_quantities:
        for estimated_quantity in quantities_of_flight:
            has_same_axis = quantity.axis in ("", estimated_quantity.axis)
            if estimated_quantity.kind == quantity.kind and has_same_axis:
                return True
    return False


def missing_reason(quantity: Quantity, state_name: str, flights: Flights) -> Fact:
    """Finds out why one state of a vehicle has no estimate of a quantity, such as a margin.

    Either a motor failed, or all its values are biased or not identifiable, or no flight has a value at all.

    Args:
        quantity: kind of the missing quantity, such as a margin, with its axis or motor.
        state_name: "A" or "B", for the message.
        flights: the flights of the state, each as rows of the fleet's table, one for each axis.

    Returns:
        The reason as a fact (coded finding).
    """
    failed_motors = set()
    for flight in flights:
        for row in flight:
            if row.failed_motor is not None:
                failed_motors.add(row.failed_motor)
    # With a failed motor, the others do not work as usual: their commands are not compared.
    if quantity.kind in (SHARE, EFFECT) and failed_motors:
        return Fact(
            Incomparable.FAILED_MOTOR, subject=state_name, motors=_sorted_texts(failed_motors)
        )
    statuses = set()
    for flight in flights:
        for row in flight:
            is_about_axis = quantity.axis in ("", row.axis)
            if is_about_axis:
                # Shares have no status: they need no model.
                statuses.add(getattr(row, f"{quantity.kind}_status", None))
    unreliable_statuses = statuses & UNRELIABLE_STATUSES
    if not unreliable_statuses:
        return Fact(Incomparable.NOT_ESTIMATED, subject=state_name)
    return Fact(
        Incomparable.NOT_REPORTED, subject=state_name, names=_sorted_texts(unreliable_statuses)
    )


def _sorted_texts(values: Iterable[object]) -> list[str]:
    """Returns values as text, in alphabetical order."""
    return sorted(str(value) for value in values)
