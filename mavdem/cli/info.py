"""``mavdem info``: what a log holds, and whether a model can be learned from it."""

import click

from mavdem.alignment.read import choose_vehicle
from mavdem.alignment.signals import Signals
from mavdem.analysis import Options
from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_signals
from mavdem.cli.options import read_source, source_options, verbose_option
from mavdem.cli.output import complain, print_json, print_screen, say
from mavdem.condition.inventory import inventory
from mavdem.facts import Fact
from mavdem.facts.learnability import Reason
from mavdem.heading import Values
from mavdem.health.in_flight import alarm_figures
from mavdem.report.condition import sender, stream_contents, vehicle_contents
from mavdem.report.review import title_of
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
    vehicles = []
    known = {}
    for telemetry in log.vehicles if vehicle is None else [choose_vehicle(log.vehicles, vehicle)]:
        options = Options(inputs=inputs, whole=False)
        found = assess_signals(log, Signals(telemetry, axis, inputs), axis, options)
        analysis = found.analysis
        assert analysis is not None
        vehicles.append((document_of(found), title_of(found), conclusion(found.judgement)))
        place = telemetry.system, telemetry.component
        known[place] = (analysis.learnability, analysis.condition, analysis.identity)
    held = inventory(log, axis, vehicle, inputs, known)
    streams = [] if as_json else stream_contents(held)
    for shown, (document, title, said) in zip(held["vehicles"], vehicles, strict=True):
        shown |= document
        if not as_json:
            above, *lights, following = said
            more = [*lights, *streams]
            print_screen(title, vehicle_contents(shown), more, [above, following], verbose)
    held["learnable"] = any(vehicle["model"] for vehicle in held["vehicles"])
    if as_json:
        print_json(held)
    elif not held["vehicles"]:
        say("There is no vehicle in this log: check that the autopilot's messages are recorded.")
    if not held["learnable"]:
        if as_json:
            # The document is printed already, with all the reasons.
            because = Fact(
                Reason.LOG_NOT_LEARNABLE,
                axis=axis,
                path=source,
                names=[sender(shown) for shown in held["vehicles"]],
                because=next((learnability.reason for learnability, *_ in known.values()), None),
            )
            complain(because, as_json=False)
        context.exit(1)


def document_of(assessment: Assessment) -> Values:
    """Returns what the document holds of a vehicle beside its inventory."""
    analysis = assessment.analysis
    assert analysis is not None
    return {
        **analysis.findings.as_dict(),
        **assessment.of_documents,
        **alarm_figures(analysis.alarms),
        "model": analysis.model,
        "watched": analysis.watched,
        "wind_velocity": assessment.wind and assessment.wind.as_dict(),
    }
