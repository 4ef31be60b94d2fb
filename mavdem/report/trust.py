"""What can be trusted: a small table of the checks of the sensors against each other, a row for each."""

from collections.abc import Sequence

from mavdem.facts import Fact, Level
from mavdem.facts.trust import TrustCheck
from mavdem.report.blocks import Rated, Table
from mavdem.witnesses import SensorTrust

HEADER = ["check", "trusted", "why"]
"""Header of the table."""

NAMES = {
    TrustCheck.FLIGHT: "that it flew",
    TrustCheck.BAROMETER: "barometer",
    TrustCheck.ACCELEROMETER: "accelerometer at rest",
    TrustCheck.POSITION: "position fix",
    TrustCheck.ATTITUDE_RESPONSE: "attitude response",
    TrustCheck.GYRO: "gyro against attitude",
    TrustCheck.STICK: "throttle stick",
}
"""Names of the rows."""

ANSWERS = {Level.GOOD: "yes", Level.WATCH: "no", Level.UNKNOWN: "not known"}
"""What the level of a check answers."""


def trust_table(trust_of_boots: Sequence[SensorTrust]) -> Table:
    """Returns a table with a row for each check of each boot. With several boots, a row has the number of its boot.

    Args:
        trust_of_boots: checks of the sensors in each boot, at least one.
    """
    rows: list[list[str]] = []
    for trust in trust_of_boots:
        for check in trust.checks:
            name = NAMES[TrustCheck(check.code)]
            if len(trust_of_boots) > 1:
                name = f"{name}, boot {trust.boot + 1}"
            rows.append([name, _answer(check), str(check)])
    return Table(HEADER, rows, words=True)


def _answer(check: Fact) -> Rated:
    """Returns the answer of a check in one or two words, with its level."""
    # What is reported of settled flight rests on this assumption.
    if check.figures.get("is_assumed"):
        return Rated("assumed", check.level)
    return Rated(ANSWERS[check.level], check.level)
