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
        # The latest good judgement, until another level or code was confirmed; None before one.
        self._good_margins: Fact | None = None

    def confirmed_light(self, margins: Fact) -> Fact:
        """Returns the light of the margins after a new judgement of them.

        Args:
            margins: the new judgement, a fact (a coded finding) with a level.

        Returns:
            The judgement itself if it is good or bad, or if the judgement before had the same code and level; the axis
            and the figures may differ. Otherwise the good judgement that is shown so far. Without one, a warning
            becomes the reason of unknown margins, and unknown margins are returned as they are.
        """
        former_margins = self._former_margins
        self._former_margins = margins
        is_same_judgement = (
            former_margins is not None
            and former_margins.code is margins.code
            and former_margins.level is margins.level
        )
        if margins.is_good:
            self._good_margins = margins
            return margins
        if margins.is_bad or is_same_judgement:
            self._good_margins = None
            return margins
        if self._good_margins is not None:
            return self._good_margins
        if margins.level is Level.UNKNOWN:
            return margins
        unconfirmed = Fact(WatchFact.MARGINS_UNCONFIRMED, reason=margins)
        return Fact(MarginsLight.MARGINS_UNKNOWN, reason=unconfirmed, rate=None)
