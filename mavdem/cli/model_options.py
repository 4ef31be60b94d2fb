"""The options that choose the model which is learnt, the same for logs and for links."""

from __future__ import annotations

from dataclasses import replace

import click

from mavdem.cli.source import Command
from mavdem.dem import Settings

MOST_STATES = 10
"""A roll model has a few states; the memory a fit takes grows with the fourth power of their number."""

OUTPUTS = 2
"""Of an axis: its angle and its rate."""

ORDERS = {"real": range(OUTPUTS, OUTPUTS + Settings().p + 1), "paper": range(1, MOST_STATES + 1)}
"""The real prior has a state for each output, and of more hidden ones than p it would see nothing."""


def _spoken(orders: range) -> str:
    return f"{orders[0]} to {orders[-1]}"


def model_options(command: Command) -> Command:
    """Adds --preset and --order to a command."""
    for decorate in (
        click.option(
            "--order",
            type=int,
            help=f"Number of states, {_spoken(ORDERS['real'])}; for paper {_spoken(ORDERS['paper'])}. "
            "[default: 3: angle, rate and one hidden, for the motors' lag; for paper 2]",
        ),
        click.option(
            "--preset",
            type=click.Choice(["real", "paper"]),
            default="real",
            show_default=True,
            help="real: scaling and priors for real flights; paper: those of the paper, section V.D, to compare with.",
        ),
    ):
        command = decorate(command)
    return command


def chosen_settings(preset: str, order: int | None) -> Settings:
    """The settings that --preset and --order ask for.

    Raises:
        click.BadParameter: a preset's models do not come in that order.
    """
    if order is not None and order not in ORDERS[preset]:
        raise click.BadParameter(
            f"{order} is not in {_spoken(ORDERS[preset])}, the numbers of states that --preset {preset} can have.",
            param_hint="--order",
        )
    settings = Settings.paper() if preset == "paper" else Settings()
    return settings if order is None else replace(settings, order=order)
