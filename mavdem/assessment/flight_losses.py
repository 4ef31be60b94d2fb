"""How one flight was lost: by a loss of attitude in the air, or by a contact with the ground."""

from typing import NamedTuple

from mavdem.assessment.flights import loss_onset
from mavdem.facts import Fact
from mavdem.facts.ending import MotionEvent

CONTACTS = (MotionEvent.HIT, MotionEvent.TIPPED, MotionEvent.TOPPLED)
"""Losses of a vehicle by the ground, or by something that it hit."""


class FlightLosses(NamedTuple):
    """How one flight was lost."""

    attitude_loss: Fact | None
    """The loss of attitude in the air that the flight did not recover from; None without one."""
    contact: Fact | None
    """The contact with the ground; None without one. It has the figure ``is_after_loss`` if it only followed a loss in
    the air."""


def flight_losses(attitude_loss: Fact | None, contact: Fact | None) -> FlightLosses:
    """Decides which of a loss of attitude and a contact with the ground was how the flight was lost.

    If the ground came first, they are one event, the contact. Otherwise both are events: the loss was in the air, and
    the contact, which then has the figure ``is_after_loss``, only followed.

    Args:
        attitude_loss: the loss of attitude that the flight did not recover from; None if there was none.
        contact: the contact with the ground (:func:`ground_contact`); None if there was none.
    """
    if attitude_loss is None or contact is None:
        return FlightLosses(attitude_loss, contact)
    # A contact whose onset is not known is taken as the first of the two.
    is_ground_first = (loss_onset(contact) or 0.0) <= attitude_loss.start_time
    if is_ground_first or attitude_loss.code in CONTACTS:
        # Both events are the same contact, which is described more exactly by ``contact``.
        return FlightLosses(None, contact)
    # A loss is bad only if a second sensor confirms it.
    is_loss_confirmed = attitude_loss.is_bad
    if not is_loss_confirmed:
        # The contact is then how the flight was lost.
        return FlightLosses(attitude_loss, contact)
    return FlightLosses(attitude_loss, contact.replace(is_after_loss=True))
