"""``mavdem info``: what a log holds, its status lights, and the fact (coded finding) why no model can be learned."""

from collections.abc import Sequence
from dataclasses import replace
from shlex import quote

import click

from mavdem.assessment.assess import assess_signals, loss_of_flight
from mavdem.assessment.axis import LogAnalysis, Options, analyse
from mavdem.assessment.inventory import inventory
from mavdem.assessment.record import Assessment, analysed_contents
from mavdem.cli.exit_codes import EXIT_UNSUPPORTED
from mavdem.cli.options import source_options, verbose_option
from mavdem.cli.output import print_json, print_screen, report_error
from mavdem.cli.sources import read_source
from mavdem.cli.streams import print_to_stdout
from mavdem.containers import JsonValues
from mavdem.dataset.flights import choose_vehicle
from mavdem.dataset.signals import Signals
from mavdem.documents.inventory import analysis_document, vehicle_document
from mavdem.facts import Fact
from mavdem.facts.learnability import NotLearnableReason
from mavdem.ingest import Log
from mavdem.report.blocks import Sentence, headline_sentence
from mavdem.report.condition import component_id, stream_contents, vehicle_contents_blocks
from mavdem.report.review import review_title, vehicle_title
from mavdem.report.screen import instance_blocks, judgement_sentences


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
    if a model can be learned (a model of the slow motion too; if not, why and what to change), how a lost flight was
    lost and, if 15 lines suffice, settled flight and message rates. `mavdem SOURCE` says what happened and what is
    wrong; with --verbose and --json, which take as long as that, it is added: headline, lights, senders, instances, and
    what can be trusted. With --json the reason why no model can be learned is also printed on standard error.

    Exit code: 0 if a model can be learned from at least one vehicle, otherwise 1.
    """
    log = read_source(source)
    vehicles = log.vehicles
    if vehicle is not None:
        vehicles = (choose_vehicle(log.vehicles, vehicle),)
    options = Options(inputs=inputs, with_model=False)
    all_signals = [Signals(telemetry, axis, inputs) for telemetry in vehicles]
    if as_json or verbose:
        assessments = [assess_signals(log, signals, axis, options) for signals in all_signals]
        contents = [assessment.contents for assessment in assessments]
        findings = [vehicle_document(assessment) for assessment in assessments]
    else:
        # The screen has nothing of the motors.
        options = replace(options, with_motors=False)
        analyses = [analyse(log, signals, axis, options) for signals in all_signals]
        contents = list(map(analysed_contents, all_signals, analyses))
        findings = [analysis_document(analysis) for analysis in analyses]
    document = inventory(log, contents)
    for values, findings_of_vehicle in zip(document["vehicles"], findings, strict=True):
        values |= findings_of_vehicle
    is_learnable = any(values["model"] for values in document["vehicles"])
    document["learnable"] = is_learnable
    if as_json:
        print_json(document)
        if not is_learnable:
            # The document has all the reasons; one of them is for a user who does not read it.
            report_error(_why_not_learnable(document, source, axis), as_json=False)
    elif not vehicles:
        print_to_stdout(
            "There is no vehicle in this log: check that the autopilot's messages are recorded."
        )
    elif verbose:
        _print_assessments(document, assessments)
    else:
        _print_analyses(document, log, all_signals, analyses)
    if not is_learnable:
        context.exit(EXIT_UNSUPPORTED)


def _print_analyses(
    document: JsonValues,
    log: Log,
    all_signals: Sequence[Signals],
    analyses: Sequence[LogAnalysis],
) -> None:
    """Prints a screen for each vehicle of a log: what was received, and whether a model can be learned.

    At the end stands how the vehicle was lost, if it was, and the command that says more.

    Args:
        document: JSON document of the command. Its key "vehicles" has what was received of each vehicle, and its key
            "speakers" all senders of messages.
        log: the log of a flight, with the messages of each vehicle.
        all_signals: signals of each vehicle, in the document's order.
        analyses: analysis of each vehicle, in the same order.
    """
    next_step = Sentence(
        f"`mavdem {quote(log.source)}` says what happened and what is wrong.", "Next:"
    )
    vehicles = zip(document["vehicles"], all_signals, analyses, strict=True)
    for received_values, signals, analysis in vehicles:
        footer = [next_step]
        loss = loss_of_flight(signals)
        if loss is not None:
            footer = [headline_sentence(loss), next_step]
        print_screen(
            title=[vehicle_title(log, signals, analysis)],
            summary=vehicle_contents_blocks(received_values),
            # Only a verbose screen has details.
            details=[],
            footer=footer,
            verbose=False,
        )


def _print_assessments(document: JsonValues, assessments: Sequence[Assessment]) -> None:
    """Prints all that a log holds of each vehicle: contents, lights, sensors, batteries, headline and next step.

    Args:
        document: JSON document of the command. Its key "vehicles" has what was received of each vehicle, and its key
            "speakers" all senders of messages.
        assessments: assessments of the vehicles, in the document's order.
    """
    sender_blocks = stream_contents(document)
    for received_values, assessment in zip(document["vehicles"], assessments, strict=True):
        sentences = judgement_sentences(assessment.judgement)
        print_screen(
            title=[review_title(assessment)],
            summary=vehicle_contents_blocks(received_values),
            details=[*sentences.lights, *instance_blocks(assessment), *sender_blocks],
            footer=[sentences.headline, sentences.next_step],
            verbose=True,
        )


def _why_not_learnable(document: JsonValues, source: str, axis: str) -> Fact:
    """Returns the error message of ``mavdem info --json`` for a log from which no model can be learned.

    A log may have several vehicles. The message names them all but explains the reason for the first one only; the
    JSON document has the reasons for the others.

    Args:
        document: The JSON document that was printed. In its ``vehicles``, the key "verdict" has the learnability of the
            log for each vehicle, with the reason.
        source: Path of the log.
        axis: Axis of the model: roll, pitch or yaw.

    Returns:
        The fact, whose sentence is printed on standard error. It has no reason if the log has no vehicle.
    """
    vehicles = document["vehicles"]
    reason = None
    if vehicles:
        learnability = vehicles[0]["verdict"]
        reason = learnability.reason
    return Fact(
        NotLearnableReason.LOG_NOT_LEARNABLE,
        axis=axis,
        path=source,
        names=[component_id(values) for values in vehicles],
        reason=reason,
    )
