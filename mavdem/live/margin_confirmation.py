"""Confirmation of stability margins in flight: good ones count until two judgements in a row give something else."""

from mavdem.facts import Fact, Level
from mavdem.facts.margins import MarginsLight
from mavdem.facts.watch import WatchFact


class MarginConfirmation:
    """Compares each judgement of the margins of a flight with the one before it.

    Margins are judged again and again by the whole of a flight so far. The first judgement has hardly more settled
    flight than it needs, 20 s, and so may warn of what the next one, with 10 to 15 s more, does not find. A pilot must
    not read a warning that is withdrawn after seconds, and good margins stay until two judgements in a row warn or
    cannot tell. A bad margin is an alarm, which counts at once.
    """

    def __init__(self) -> None:
        """Begins a flight, of which no margins are judged yet."""
        self._former_margins: Fact | None = None

    def confirmed_light(self, margins: Fact) -> Fact:
        """Returns the light of the margins after a new judgement of them.

        Args:
            margins: the new judgement, a fact (a coded finding) with a level.

        Returns:
            The judgement itself if it is good or bad. Otherwise the judgement before it, if that was good. Otherwise
            the new one if both have the same code and level, whose axis and figures may differ, or if it is unknown. A
            warning after another judgement becomes the reason of unknown margins.
        """
        former_margins = self._former_margins
        self._former_margins = margins
        if margins.is_good or margins.is_bad:
            return margins
        if former_margins is not None and former_margins.is_good:
            return former_margins
        is_confirmed = (
            former_margins is not None
            and former_margins.code is margins.code
            and former_margins.level is margins.level
        )
        if is_confirmed or margins.level is Level.UNKNOWN:
            return margins
        return _unconfirmed(margins)


def _unconfirmed(warning: Fact) -> Fact:
    """Returns the light of unknown margins whose reason is a warning that the next judgement has to confirm."""
    reason = Fact(WatchFact.MARGINS_UNCONFIRMED, reason=warning)
    return Fact(MarginsLight.MARGINS_UNKNOWN, reason=reason, rate=None)
