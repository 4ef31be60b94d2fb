"""What is said of a live flight: how well it was predicted, and what the link brought."""

from collections.abc import Mapping, Sequence
from math import sqrt

from mavdem.facts import Fact
from mavdem.facts.session import Session, Spent
from mavdem.live.history import REPORTED_HORIZON, HorizonErrors, LiveHistory
from mavdem.live.session_status import SessionStatus
from mavdem.motors.motor_changes import FALSE_ALARMS
from mavdem.report.blocks import Blocks, Sentence, Table
from mavdem.report.numbers import display_unit, name_with_unit
from mavdem.report.templates import as_clause, capitalize_first, render_section


def watched_quantities(watched: Sequence[Fact]) -> str:
    """Returns what is ``watched`` without a model since when, and why the rest is not, in one line."""
    return "".join(
        f"{capitalize_first(said.text)}."
        for said in render_section("live_watched", watched=watched)
    )


def live_report(
    history: LiveHistory,
    status: SessionStatus,
    account: Mapping[Spent, float],
    axis: str,
    seconds: float = 0.0,
) -> Blocks:
    """Returns the errors of what was predicted on an ``axis``, and the parts trained on, by the vehicle's clock.

    ``history`` was collected in flight, ``status`` is that at its end; ``account`` are seconds by what they
    were; ``seconds`` of the last ones are in the model.
    """
    errors = history.errors()
    best = min(errors, key=lambda error: abs(error.seconds - REPORTED_HORIZON), default=None)
    headline, *state = render_section(
        "live_state", best=best, axis=axis, status=status, false_alarms=FALSE_ALARMS
    )
    whole = {kind: round(seconds) for kind, seconds in account.items()}
    spent = [
        [capitalize_first(Fact(Session.SECONDS_SPENT, kind=kind)), f"{whole[kind]} s"]
        for kind in Spent
        if whole[kind]
    ]
    return [
        headline,
        *(Sentence(f"{as_clause(alarm.fact)}.", "Motors:") for alarm in status.motor_alarms),
        *state,
        *([_errors(errors, axis)] if errors else []),
        *render_section(
            "live_learned", errors=errors, parts=history.learned_intervals, seconds=seconds
        ),
        Table([f"of {sum(whole.values())} s", "time"], spent),
        *render_section("live_link", status=status),
    ]


def _errors(errors: Sequence[HorizonErrors], axis: str) -> Table:
    header = ["RMSE of predictions"]
    rows = [[f"{error.seconds:.2g} s ahead"] for error in errors]
    for i, (name, radians) in enumerate(((axis, "rad"), (f"{axis} rate", "rad/s"))):
        unit = display_unit(radians)
        header += [name_with_unit(name, unit.name), "baseline", "in its 90 % band"]
        for row, error in zip(rows, errors, strict=True):
            row += [
                f"{unit.scale * sqrt(square[i]):.2g}" for square in (error.mse, error.baseline_mse)
            ]
            row.append(f"{100 * error.coverage[i]:.0f} %")
    return Table(header, rows)
