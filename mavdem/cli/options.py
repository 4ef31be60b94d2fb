"""Options that several commands share: axis and vehicle, model settings, and lengths of training and test data."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import click

from mavdem.dataset.axes import AXES, TILT_AXES

if TYPE_CHECKING:
    from mavdem.dem import Settings
    from mavdem.experiments.window import Length

Command = TypeVar("Command", bound=Callable[..., Any])
"""The function of a command, or the command that Click has made of it."""


OUTPUT_COUNT = 2
"""Number of outputs of a model of a real flight, angle and rate, each of which is a state as well."""

MAX_PAPER_ORDER = 10
"""Largest number of states of a model of --preset paper: a choice, since the memory of a fit with n grows with n⁴."""


class OrderRange(NamedTuple):
    """The range of orders, which are numbers of states of a model, that a user may choose."""

    smallest: int
    """Smallest order."""

    largest: int
    """Largest order."""

    def __str__(self) -> str:
        """Returns the range in words, such as "2 to 8", for the help and for error messages."""
        return f"{self.smallest} to {self.largest}"


def allowed_orders() -> dict[str, OrderRange]:
    """Returns the orders that --order accepts, by the value of --preset: "real" or "paper".

    The states of a model of a real flight are its outputs and a chain of hidden states. Each hidden state needs one
    more derivative of the outputs, of which DEM tracks ``Settings.p``.
    """
    # Commands without a model need not wait for the import.
    from mavdem.dem import Settings

    return {
        "real": OrderRange(OUTPUT_COUNT, OUTPUT_COUNT + Settings().p),
        "paper": OrderRange(1, MAX_PAPER_ORDER),
    }


class NumberRange(click.FloatRange):
    """Type of an option for a number in a range; unlike ``click.FloatRange`` it refuses NaN, and accepts "7s" for 7."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Parses the number that a user has given.

        Args:
            value: Text from the user, such as "7.5" or "7.5s", or the default.
            param: The option.
            ctx: Context of the command.

        Returns:
            The number.

        Raises:
            click.BadParameter: It is no number, or outside the range.
        """
        text: Any = str(value).removesuffix("s")
        number: float = super().convert(text, param, ctx)
        if math.isnan(number):
            self.fail("it must be a number.", param, ctx)
        return number


class WholeNumberRange(click.IntRange):
    """Type of an option for a whole number in a range, whose limits it states in words, not as an inequality."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parses the number that a user has given.

        Args:
            value: Text from the user, such as "7", or the default.
            param: The option.
            ctx: Context of the command.

        Returns:
            The number.

        Raises:
            click.BadParameter: It is no whole number, or outside the range.
        """
        limits = f"from {self.min} on" if self.max is None else f"from {self.min} to {self.max}"
        try:
            number: int = super().convert(value, param, ctx)
        except click.BadParameter:
            self.fail(f"{value} is no whole number {limits}.", param, ctx)
        return number


def token_option(use: str) -> Callable[[Command], Command]:
    """Returns a decorator for ``token``, the secret of a server; empty unless given.

    Args:
        use: what the token is for, as the beginning of the help.
    """
    return click.option(
        "--token",
        default="",
        envvar="MAVDEM_TOKEN",
        help=f"{use}; better in the environment as MAVDEM_TOKEN.",
    )


def file_option(name: str, text: str) -> Callable[[Command], Command]:
    """Returns a decorator that adds an option for the path of a file or a folder.

    Args:
        name: Name of the option, such as "--out".
        text: Text for the command's help.
    """
    return click.option(name, type=click.Path(path_type=Path), help=text)


def _combined_options(*decorators: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Returns a decorator that adds several options to a command; the help lists them in the given order.

    Args:
        decorators: The decorators; each adds one option.
    """

    def decorate(command: Command) -> Command:
        # Click lists first what is added last, as with decorators in a source file.
        for decorator in reversed(decorators):
            command = decorator(command)
        return command

    return decorate


jobs_option = click.option(
    "--jobs",
    type=WholeNumberRange(1, 1024),
    help="Logs read at a time. [default: one for each core]",
)
"""Decorator for ``jobs``, the number of processes that read logs; None unless given."""

source_argument = click.argument("source", type=click.Path())
"""Decorator for ``source``, the path of one log."""

sources_argument = click.argument(
    "sources", metavar="SOURCE...", type=click.Path(), nargs=-1, required=True
)
"""Decorator for ``sources``, the paths of one or more logs."""

vehicle_option = click.option(
    "--vehicle", metavar="SYSTEM[:COMPONENT]", help="Which vehicle, of several."
)
"""Decorator for ``vehicle``, the name of one of several vehicles; None unless given."""

host_option = click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address to listen on: 0.0.0.0 for all of this machine, which needs a token.",
)
"""Decorator for ``host``, the address at which a server listens."""

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document and nothing else."
)
"""Decorator for ``as_json``: whether the result is printed as a JSON document."""

verbose_option = click.option(
    "--verbose", is_flag=True, help="Print all figures, not only the summary."
)
"""Decorator for ``verbose``: whether a screen may have more than ``SCREEN_LINES`` lines."""

rrd_option = click.option(
    "--rrd",
    is_flag=True,
    help="Also write flight.rrd, the plots for `rerun`, if a model can be learned.",
)
"""Decorator for ``rrd``: whether the recording for the Rerun Viewer is written, which takes a second and more."""

mcap_option = click.option(
    "--mcap",
    is_flag=True,
    help="Also write flight.mcap, the series for Foxglove or PlotJuggler, if a model can be learned.",
)
"""Decorator for ``mcap``: whether the recording for Foxglove and PlotJuggler is written."""

params_option = file_option(
    "--params",
    "Parameters that the log lacks: a file of QGroundControl (.params) or Mission Planner (.param).",
)
"""Decorator for ``params``, a file with parameters of the autopilot; None unless given."""

start_option = click.option(
    "--start",
    metavar="SECONDS",
    type=NumberRange(0, 86400),
    default=0.0,
    show_default=True,
    help="Leave out this time at the beginning of the settled flight.",
)
"""Decorator for ``start``, the time at the beginning of the settled flight that is left out, s."""


def motion_options(
    axes: Sequence[str] = TILT_AXES, text: str = "Axis to model."
) -> Callable[[Command], Command]:
    """Returns a decorator that adds --axis, --vehicle, --inputs and --json to a command.

    Args:
        axes: Choices of --axis.
        text: Text on --axis for the command's help.
    """
    return _combined_options(
        click.option(
            "--axis", type=click.Choice(axes), default="roll", show_default=True, help=text
        ),
        vehicle_option,
        click.option(
            "--inputs",
            type=click.Choice(["motors", "demand"]),
            help="The inputs of the model: the motor outputs, or the controller's demand before the mixer. "
            "[default: motors; demand if only that is logged fast enough]",
        ),
        json_option,
    )


def source_options(
    axes: Sequence[str] = AXES, text: str = "Axis of the vehicle."
) -> Callable[[Command], Command]:
    """Returns a decorator that adds the argument SOURCE and the :func:`motion_options` to a command.

    Args:
        axes: Choices of --axis.
        text: Text on --axis for the command's help.
    """
    return _combined_options(source_argument, motion_options(axes, text))


def model_options(command: Command) -> Command:
    """Adds --preset and --order to a command, which receives the selected ``Settings`` as the argument ``settings``.

    The preset decides which orders exist. So Click handles --preset first (``is_eager``), and the callback of --order
    makes the settings from both values.

    Args:
        command: command to which the options are added.

    Returns:
        The command with both options.
    """
    orders = allowed_orders()
    add_options = _combined_options(
        click.option(
            "--preset",
            type=click.Choice(["real", "paper"]),
            default="real",
            show_default=True,
            is_eager=True,
            help="real: scaling and priors for real flights; paper: the settings of the paper, section V.D.",
        ),
        click.option(
            "--order",
            "settings",
            type=int,
            callback=_settings_from_options,
            help=f"Number of states, {orders['real']}; for paper {orders['paper']}. "
            "[default: 3 (angle, rate, and a hidden state for the motors' lag); for paper 2]",
        ),
    )
    return add_options(command)


def _settings_from_options(
    context: click.Context, parameter: click.Parameter, order: int | None
) -> Settings:
    """Returns the settings that --preset and --order select; Click's callback for --order.

    Args:
        context: Context of the command. The value of --preset, which Click has processed before since it is eager, is
            removed from its parameters, so that the command does not receive it.
        parameter: The option --order; not used.
        order: Number of states; None for that of the preset.

    Raises:
        click.BadParameter: The preset has no model of that order.
    """
    from mavdem.dem import Settings

    preset = context.params.pop("preset")
    settings = Settings.paper() if preset == "paper" else Settings()
    if order is None:
        return settings
    orders = allowed_orders()[preset]
    if not orders.smallest <= order <= orders.largest:
        raise click.BadParameter(
            f"{order} is not in {orders}, the numbers of states of --preset {preset}.",
            param_hint="--order",
        )
    return replace(settings, order=order)


def window_options(train_default: str, test_help: str) -> Callable[[Command], Command]:
    """Returns a decorator that adds --train and --test to a command: lengths of flight in seconds or samples.

    Args:
        train_default: Default of --train, in words for the command's help.
        test_help: Text on --test for the command's help, without its default.
    """
    from mavdem.dem.plant_forecasts import FORECAST_HORIZON_SECONDS

    train_help = f"Training data: seconds (7s) or samples (700). [default: {train_default}]"
    test_help = f"{test_help} [default: {FORECAST_HORIZON_SECONDS:g}s]"
    return _combined_options(
        click.option("--train", callback=_length_from_text, metavar="LENGTH", help=train_help),
        click.option("--test", callback=_length_from_text, metavar="LENGTH", help=test_help),
    )


def _length_from_text(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> Length | None:
    """Parses a length of flight that a user has given; Click's callback for --train and --test.

    Args:
        context: Click's context of the command that is parsed.
        parameter: The option.
        text: Seconds, as in "7s" or "1.5s", or samples, as in "700"; None if the option was not given.

    Returns:
        The length; None without the option.

    Raises:
        click.BadParameter: The text is neither, or the length is zero.
    """
    from mavdem.experiments.window import Length

    if text is None:
        return None
    # Up to six digits of seconds with up to nine decimals, or up to nine digits of samples.
    is_valid = re.fullmatch(r"(\d{1,6}(?:\.\d{1,9})?s|\d{1,9})", text, re.ASCII) is not None
    number = 0.0
    if is_valid:
        number = float(text.removesuffix("s"))
    if number == 0.0:
        raise click.BadParameter(
            f"{text!r} is no length: give seconds, as in 7s, or samples, as in 700.",
            context,
            parameter,
        )
    is_in_seconds = text.endswith("s")
    return Length(number, is_in_seconds)
