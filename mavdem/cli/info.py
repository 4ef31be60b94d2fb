"""``mavdem info``: what a log holds, and whether a model can be learned from it."""

import click

from mavdem.assessment.assess import assess_signals
from mavdem.assessment.axis import Options
from mavdem.assessment.inventory import inventory
from mavdem.cli.options import source_options, verbose_option
from mavdem.cli.output import print_json, print_screen, report_error
from mavdem.cli.sources import read_source
from mavdem.cli.streams import print_to_stdout
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.documents.inventory import vehicle_document
from mavdem.facts import Fact
from mavdem.facts.learnability import Reason
from mavdem.report.condition import component_id, stream_contents, vehicle_contents
from mavdem.report.review import review_title
from mavdem.report.screen import conclusion


@click.command("info")
@source_options()
@verbose_option
@click.pass_context
def info_command(
    context: click.Context,
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    verbose: bool,
) -> None:
    """Reports what a log holds and if a model can be learned.

    SOURCE is a log: .tlog, .mcap (MAVLink or ROS 2), .bin, .log, .ulg or .ulg.xz. For each vehicle it prints
    if a model can be learned (a model of the slow motion too; if not, why and what to change), headline and next step
    and, if 15 lines suffice, settled flight and message rates; with --verbose all, and the senders. --json
    has details, for example message counts and the vehicle's condition; the reason is then also printed on standard
    error.

    Exit code: 0 if a model can be learned from at least one vehicle, otherwise 1.
    """
    log = read_source(source)
    vehicles = log.vehicles if vehicle is None else [choose_vehicle(log.vehicles, vehicle)]
    options = Options(inputs=inputs, with_model=False)
    assessments = [
        assess_signals(log, Signals(telemetry, axis, inputs), axis, options)
        for telemetry in vehicles
    ]
    held = inventory(log, [assessment.contents for assessment in assessments])
    streams = [] if as_json else stream_contents(held)
    for shown, assessment in zip(held["vehicles"], assessments, strict=True):
        shown |= vehicle_document(assessment)
        if not as_json:
            above, *lights, following = conclusion(assessment.judgement)
            more = [*lights, *streams]
            contents = vehicle_contents(shown)
            print_screen(review_title(assessment), contents, more, [above, following], verbose)
    held["learnable"] = any(vehicle["model"] for vehicle in held["vehicles"])
    if as_json:
        print_json(held)
    elif not held["vehicles"]:
        print_to_stdout(
            "There is no vehicle in this log: check that the autopilot's messages are recorded."
        )
    if not held["learnable"]:
        if as_json:
            # The document is printed already, with all the reasons.
            because = Fact(
                Reason.LOG_NOT_LEARNABLE,
                axis=axis,
                path=source,
                names=[component_id(shown) for shown in held["vehicles"]],
                because=next((shown["verdict"].reason for shown in held["vehicles"]), None),
            )
            report_error(because, as_json=False)
        context.exit(1)
