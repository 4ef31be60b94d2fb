"""Options that several commands share: which motion of which vehicle, and which model."""

import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

import click

from mavdem.assessment.assess import assess_signals
from mavdem.assessment.axis import Options
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.record import Assessment
from mavdem.cli.output import printable, progress, say_aside
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.flights import choose_vehicle, learnable_flight
from mavdem.dataset.signals import Signals
from mavdem.dem import Settings
from mavdem.dem.plant_forecasts import FORECAST_HORIZON_SECONDS
from mavdem.errors import NotLearnable, Unreadable
from mavdem.experiments.window import Length
from mavdem.facts.command import NamedSource
from mavdem.flight import Flight
from mavdem.ingest import Log, read_log
from mavdem.ingest.parameter_file import with_parameters

Command = TypeVar("Command", bound=Callable[..., Any])
ORDERS = {"real": range(2, 2 + Settings().p + 1), "paper": range(1, 11)}
"""The real prior has a state for each of two outputs and at most p hidden ones; a fit's memory is of order n⁴."""
SPOKEN = {preset: f"{orders[0]} to {orders[-1]}" for preset, orders in ORDERS.items()}


def file_option(name: str, text: str) -> Callable[[Command], Command]:
    """Returns an option that names a file, or a folder."""
    return click.option(name, type=click.Path(path_type=Path), help=text)


class Number(click.FloatRange):
    """A range of numbers, without the one that every range accepts: NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Returns the number, without the s of seconds, or refuses it as click does."""
        text: Any = str(value).removesuffix("s")
        number = super().convert(text, param, ctx)
        return number if number == number else self.fail("it must be a number.", param, ctx)


def _adding(*options: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Adds options to a command, in this order on its page of help."""
    return lambda command: reduce(lambda made, option: option(made), reversed(options), command)


jobs_option = click.option(
    "--jobs", type=click.IntRange(1, 1024), help="Logs read at a time. [default: one for each core]"
)
source_argument = click.argument("source", type=click.Path())
sources_argument = click.argument(
    "sources", metavar="SOURCE...", type=click.Path(), nargs=-1, required=True
)
vehicle_option = click.option("--vehicle", metavar="SYSTEM[:COMPONENT]", help="Which, of several.")
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document and nothing else."
)
verbose_option = click.option("--verbose", is_flag=True, help="Print all, not 15 lines.")
params_option = file_option(
    "--params",
    "Parameters that the log lacks: a file of QGroundControl (.params) or Mission Planner (.param).",
)


def motion_options(
    axes: Sequence[str] = TILT_AXES, text: str = "Axis to model."
) -> Callable[[Command], Command]:
    """Adds --axis with these choices, --vehicle, --inputs and --json to a command."""
    return _adding(
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
    """Adds SOURCE and the same options to a command."""
    return _adding(source_argument, motion_options(axes, text))


def model_options(command: Command) -> Command:
    """Adds --preset and --order to a command, which receives their ``settings``."""
    return _adding(
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
            callback=_settings,
            help=f"Number of states, {SPOKEN['real']}; for paper {SPOKEN['paper']}. [default: 3 (angle, rate, and a "
            "hidden state for the motors' lag); for paper 2]",
        ),
    )(command)


def _settings(context: click.Context, parameter: click.Parameter, order: int | None) -> Settings:
    preset = context.params.pop("preset")
    if order is not None and order not in ORDERS[preset]:
        refusal = f"{order} is not in {SPOKEN[preset]}, the numbers of states of --preset {preset}."
        raise click.BadParameter(refusal, param_hint="--order")
    settings = Settings.paper() if preset == "paper" else Settings()
    return settings if order is None else replace(settings, order=order)


def _length(context: click.Context, parameter: click.Parameter, value: str | None) -> Length | None:
    """Seconds, as in ``7s``, or samples, as in ``700``."""
    if value is None:
        return None
    match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,9})?s|\d{1,9})", value, re.ASCII)
    number = float(value.removesuffix("s")) if match else 0.0
    if not number:
        wrong = f"{value!r} is no length: give seconds, as in 7s, or samples, as in 700."
        raise click.BadParameter(wrong, context, parameter)
    return Length(number, value.endswith("s"))


def window_options(train_default: str, test_help: str) -> Callable[[Command], Command]:
    """Adds --train and --test, lengths in samples or seconds, to a command."""
    train_help = f"Training data: seconds (7s) or samples (700). [default: {train_default}]"
    test_help = f"{test_help} [default: {FORECAST_HORIZON_SECONDS:g}s]"
    return _adding(
        click.option("--train", callback=_length, metavar="LENGTH", help=train_help),
        click.option("--test", callback=_length, metavar="LENGTH", help=test_help),
    )


Result = TypeVar("Result")

LINK_PATTERN = re.compile(r"(udp|tcp|mcast|ws)\w*:|/dev/(tty|cu|serial)|COM\d", re.IGNORECASE)
"""The beginning of pymavlink's connection strings (``mavutil.mavlink_connection``)."""


def refuse_link(source: str) -> None:
    """Raises ``Unreadable`` for a link and for standard input, where a log is needed."""
    if source == "-":
        raise Unreadable(NamedSource.STANDARD_INPUT_IS_NO_LOG)
    if LINK_PATTERN.match(source) and not os.path.isfile(source):
        attach = shlex.join(["mavdem", "live", source])
        raise Unreadable(NamedSource.LINK_IS_NO_LOG, path=source, name=attach)


def read_source(source: str, params: Path | None = None) -> Log:
    """Returns the log that SOURCE names; raises ``Unreadable`` for a link and for what ``read_log`` cannot read.

    Parameters that it does not have are those of the file ``params``.
    """
    refuse_link(source)
    with progress(f"Reading {source}", measured=False):
        log = read_log(source)
    return log if params is None else with_parameters(log, params)


def assessed(
    source: str, vehicle: str | None, params: Path | None = None, **options: Any
) -> tuple[Assessment, Evidence]:
    """Returns the assessment of a vehicle of the log that SOURCE names, without a model, and what it rests on."""
    log = read_source(source, params)
    signals = Signals(choose_vehicle(log.vehicles, vehicle), inputs=options.get("inputs"))
    chosen = Options(with_model=False, **options)
    assessment = assess_signals(log, signals, AXES[0], chosen, progress=progress)
    assert assessment.evidence is not None
    return assessment, assessment.evidence


def names_of(sources: Sequence[str]) -> dict[str, str]:
    """Returns SOURCEs by the flight's name: the file's without ending, or the whole SOURCE if others have the same."""
    stems = [printable(Path(source).stem) for source in sources]
    return {
        stem if stems.count(stem) == 1 else printable(source): source
        for stem, source in zip(stems, sources, strict=True)
    }


def of_each(
    sources: Sequence[str],
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    use: Callable[[str, Flight], Result],
) -> dict[str, Result]:
    """Returns what ``use`` makes of each settled flight, by the flight's name.

    A SOURCE that cannot be used is reported on standard error; the first one's error is raised if that are all.
    """
    if len({*sources}) < len(sources):
        raise click.BadParameter(
            "one is named twice: each flight counts once.", param_hint="SOURCE"
        )
    results = {}
    refused = {}
    for name, source in names_of(sources).items():
        try:
            flight, _ = learnable_flight(read_source(source), axis, vehicle, inputs)
            results[name] = use(name, flight)
        except (NotLearnable, Unreadable) as error:
            refused[source] = error
    report_refused(results, refused)
    return results


def report_refused(results: Sized, refused: Mapping[str, NotLearnable | Unreadable]) -> None:
    """Reports on standard error what is ``refused``, by name; raises the first error if there are no ``results``."""
    for name, error in refused.items():
        if not results:
            raise error
        say_aside(f"mavdem: {name} is left out: {error}")
