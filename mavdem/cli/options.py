"""Options that several commands share: which motion of which vehicle, and which model."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from mavdem.alignment.drive import AXES, TILT_AXES
from mavdem.dem import Settings
from mavdem.dem.learning import FEWEST_SAMPLES
from mavdem.evaluate.windows import TEST_SECONDS, Length

Command = TypeVar("Command", bound=Callable[..., Any])

VEHICLE_PATTERN = re.compile(r"\d{1,3}(:\d{1,3})?", re.ASCII)  # MAVLink's ids
MAX_STATES = 10  # A roll model has a few states; the memory of a fit increases with the fourth power of their number
AXIS_OUTPUTS = 2  # of an axis: its angle and its rate

ORDERS = {"real": range(AXIS_OUTPUTS, AXIS_OUTPUTS + Settings().p + 1), "paper": range(1, MAX_STATES + 1)}
"""The real prior has a state for each output and at most p hidden ones."""


Value = TypeVar("Value")


def file_option(name: str, text: str) -> Callable[[Command], Command]:
    """Returns an option that names a file."""
    return click.option(name, type=click.Path(path_type=Path), callback=no_option, help=text)


def no_option(context: click.Context, parameter: click.Parameter, value: Value) -> Value:
    """Refuses an option as the value of another, which was then forgotten: ``--out --json``."""
    if str(value).startswith("--"):
        raise click.BadParameter(f"{value} is an option, and no value was given.", context, parameter)
    return value


def _vehicle(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    no_option(context, parameter, value)
    if value is not None and not VEHICLE_PATTERN.fullmatch(value):
        raise click.BadParameter(
            f"{value!r} is no vehicle: give its MAVLink system id, or system and component as in 1:1.",
            context,
            parameter,
        )
    return value


def motion_options(axes: Sequence[str] = TILT_AXES, text: str = "Axis to model.") -> Callable[[Command], Command]:
    """Adds --axis with these choices, --vehicle, --inputs and --json to a command."""

    def decorate(command: Command) -> Command:
        for option in (
            click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else."),
            click.option(
                "--inputs",
                type=click.Choice(["motors", "demand"]),
                help="The inputs of the model: the motor outputs, or the controller's demand before the mixer. "
                "[default: motors; demand if only that is logged fast enough]",
            ),
            click.option(
                "--vehicle",
                metavar="SYSTEM[:COMPONENT]",
                callback=_vehicle,
                help="Which vehicle, if there are several.",
            ),
            click.option("--axis", type=click.Choice(axes), default="roll", show_default=True, help=text),
        ):
            command = option(command)
        return command

    return decorate


def source_options(axes: Sequence[str] = AXES, text: str = "Axis of the vehicle.") -> Callable[[Command], Command]:
    """Adds SOURCE and the same options to a command."""
    return lambda command: click.argument("source", type=click.Path())(motion_options(axes, text)(command))


def _spoken(orders: range) -> str:
    return f"{orders[0]} to {orders[-1]}"


def model_options(command: Command) -> Command:
    """Adds --preset and --order to a command."""
    for decorate in (
        click.option(
            "--order",
            type=int,
            help=f"Number of states, {_spoken(ORDERS['real'])}; for paper {_spoken(ORDERS['paper'])}. "
            "[default: 3 (angle, rate, and a hidden state for the motors' lag); for paper 2]",
        ),
        click.option(
            "--preset",
            type=click.Choice(["real", "paper"]),
            default="real",
            show_default=True,
            help="real: scaling and priors for real flights; paper: the settings of the paper, section V.D.",
        ),
    ):
        command = decorate(command)
    return command


def chosen_settings(preset: str, order: int | None) -> Settings:
    """The settings of --preset and --order; raises ``BadParameter`` for an order that the preset does not have."""
    if order is not None and order not in ORDERS[preset]:
        raise click.BadParameter(
            f"{order} is not in {_spoken(ORDERS[preset])}, the numbers of states of --preset {preset}.",
            param_hint="--order",
        )
    settings = Settings.paper() if preset == "paper" else Settings()
    return settings if order is None else replace(settings, order=order)


class LengthType(click.ParamType):  # type: ignore[type-arg]  # generic from click 8.4 on
    """Seconds, as in ``7s``, or samples, as in ``700``; the latter at least ``fewest``."""

    name = "length"

    def __init__(self, fewest: int) -> None:
        self.fewest = fewest

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> Length:
        """From the words of a command line."""
        if isinstance(value, Length):
            return value
        found = LENGTH_PATTERN.fullmatch(str(value))
        if found is None:
            self.fail(f"{value!r} is no length: give seconds, as in 7s, or samples, as in 700.", parameter, context)
        number, in_seconds = float(found["number"]), bool(found["unit"])
        if not in_seconds and (number != round(number) or number < self.fewest):
            self.fail(f"{value} is not a whole number of at least {self.fewest} samples.", parameter, context)
        if in_seconds and not 0 < number < LONGEST_SECONDS:
            self.fail(f"{value} is not a length of flight.", parameter, context)
        return Length(number, in_seconds)


LENGTH_PATTERN = re.compile(r"(?P<number>\d{1,9}(\.\d{1,9})?)(?P<unit>s?)", re.ASCII)
LONGEST_SECONDS = 1e6


def window_options(train_default: str, test_help: str) -> Callable[[Command], Command]:
    """Adds --train and --test, lengths in samples or seconds, to a command."""

    def decorate(command: Command) -> Command:
        for option, default, fewest, what in (
            ("--test", f"{TEST_SECONDS:g}s", 1, test_help),
            ("--train", train_default, FEWEST_SAMPLES, "Training data: seconds (7s) or samples (700)."),
        ):
            text = f"{what} [default: {default}]"
            command = click.option(option, type=LengthType(fewest), metavar="LENGTH", help=text)(command)
        return command

    return decorate
