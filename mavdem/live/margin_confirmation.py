"""Confirmation of warnings about stability margins in flight: a warning counts once two judgements in a row give it."""

from mavdem.facts import Fact, Level
from mavdem.facts.margins import MarginsLight
from mavdem.facts.watch import WatchFact


class MarginConfirmation:
    """Compares each judgement of the margins of a flight with the one before it.

    Margins are judged again and again by the whole of a flight so far. The first judgement has hardly more settled
    flight than it needs, 20 s, and so may warn of what the next one, with 10 to 15 s more, does not find. A pilot must
    not read a warning that is withdrawn after seconds. A bad margin is an alarm, which counts at once.
    """

    def __init__(self) -> None:
        """Begins a flight, of which no margins are judged yet."""
        self._former_margins: Fact | None = None

    def confirmed_light(self, margins: Fact) -> Fact:
        """Returns the light of the margins: a warning of a new judgement only once a second judgement confirms it.

        Args:
            margins: the new judgement, a fact (a coded finding) with a level.

        Returns:
            The judgement. If it is a warning that the judgement before did not give, it is returned as the reason of
            unknown margins. The axis and the figures of a warning may differ from one judgement to the next.
        """
        former_margins = self._former_margins
        self._former_margins = margins
        is_same_judgement = (
            former_margins is not None
            and former_margins.code is margins.code
            and former_margins.level is margins.level
        )
        if margins.level is not Level.WATCH or is_same_judgement:
            return margins
        unconfirmed = Fact(WatchFact.MARGINS_UNCONFIRMED, reason=margins)
        return Fact(MarginsLight.MARGINS_UNKNOWN, reason=unconfirmed, rate=None)
