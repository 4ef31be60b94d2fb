"""``mavdem tune``: margins of the rate and attitude loops with intervals, and gains to set; ``mavdem twin``."""

from pathlib import Path

import click

from mavdem.alignment.drive import AXES
from mavdem.analysis.figures import ALL
from mavdem.cli.learn import start_option
from mavdem.cli.options import (
    assessed,
    file_option,
    params_option,
    source_options,
    verbose_option,
)
from mavdem.cli.output import check_folder, files_in, print_json, print_screen, say_aside
from mavdem.condition.loop.advice import Advice, advise, lowered
from mavdem.condition.loop.filters import gyro_filters
from mavdem.condition.loop.loop import TARGETS, Loop
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import Loops
from mavdem.heading import Values
from mavdem.ingest.telemetry import Parameters, Telemetry
from mavdem.ingest.vocabulary import number_of
from mavdem.report.blocks import Sentence
from mavdem.report.loops import tune_blocks
from mavdem.report.page import tune_page
from mavdem.report.screen import conclusion

REAL32 = number_of("MAV_PARAM_TYPE_REAL32")


@click.command("tune")
@source_options((*AXES, ALL), "Axis of the loops; all: roll, pitch and yaw.")
@click.option(
    "--margins",
    type=click.Choice(list(TARGETS)),
    default="default",
    show_default=True,
    help="; ".join(
        f"{name}: phase {a:g}°, gain {b:g} dB, Ms {c:g}" for name, (a, b, c) in TARGETS.items()
    )
    + ".",
)
@click.option("--more", is_flag=True, help="Use the room of loops that have enough margin.")
@params_option
@click.option("--filters", is_flag=True, help="Advise a notch filter too, and gains with it.")
@start_option
@file_option("--out", "Folder for tune.html and the parameter files.")
@verbose_option
def tune_command(
    source: str,
    axis: str,
    vehicle: str | None,
    inputs: str | None,
    as_json: bool,
    margins: str,
    more: bool,
    params: Path | None,
    filters: bool,
    start: float,
    out: Path | None,
    verbose: bool,
) -> None:
    """Reports the margins of the rate and attitude loops, and gains to set.

    SOURCE is a log with the autopilot's parameters. Advised gains have the --margins in 95 % of the plants that fit the
    flight, at 0.8 to 1.2 times the control effectiveness; of such gains, wind moves the vehicle least with these. Loops
    with enough margin keep their gains, unless --more is asked. With --filters a notch filter is advised on the motors'
    line in the gyro's spectrum, and gains have the margins with it. With --verbose it prints all margins, and what they
    rest on. Nothing is ever sent to a vehicle: --out writes the gains for QGroundControl (.params) and Mission Planner
    (.param). Exit code: 1 if no gains are advised, with the reason.

    \b
    Examples:
      mavdem tune flight.tlog --out tune
      mavdem tune flight.tlog --axis all --margins soft
      mavdem tune flight.bin --params vehicle.param --filters
    """
    if out is not None:
        check_folder(out)
    assessment, evidence = assessed(source, vehicle, params, inputs=inputs, start=start)
    telemetry = evidence.signals.telemetry
    grounds = evidence.grounds
    if (oscillation := evidence.condition.oscillation) is not None:
        grounds = (*grounds, lowered(oscillation, telemetry.parameters))
    notch = assessment.noise.notch if filters and not grounds else None
    settings = dict(notch.figures.get("settings", ())) if notch else {}
    measured = {margin.axis: margin.facts[0] for margin in evidence.margins if margin.injected}
    found = dict[str, Advice | Fact]()
    for rated in AXES if axis == ALL else (axis,):
        loop = evidence.loops[rated]
        if isinstance(loop, Fact) and rated in measured:
            loop = Fact(Loops.NO_LOOP, reasons=(measured[rated], loop))
        if isinstance(loop, Loop):
            advice = advise(loop, margins, grounds, more=more)
            if settings and not advice.refusals:
                advice = advise(loop.changed(settings), margins, more=more)
            found[rated] = advice
        elif grounds or axis == ALL:
            found[rated] = Fact(Loops.NO_LOOP, reasons=grounds or (loop,))
        else:
            raise NotLearnable(loop)
    advised_axes = [advised for advised in found.values() if isinstance(advised, Advice)]
    if not advised_axes:
        raise NotLearnable(Loops.NO_LOOP, reasons=list(dict.fromkeys(found.values())))
    gains = {
        name: value for advised in advised_axes for name, value in advised.parameters.items()
    } | settings
    refusal = None if any(advised.gains for advised in advised_axes) else advised_axes[0].sentence
    document = {
        "source": source,
        "margins": margins,
        "axes": {name: axis_document(advised) for name, advised in found.items()},
        "parameters": gains,
        "notch": notch,
    }
    judgement = assessment.judgement
    if gains:
        level = judgement.headline.level
        doubted = {caution.code for advised in advised_axes for caution in advised.before.cautions}
        step = Fact(
            NextStep.LOAD_GAINS,
            level,
            is_written=out is not None,
            is_biased=Loops.EFFECT_BIASED in doubted and level is not Level.BAD,
        )
        judgement = judgement._replace(next_step=step)
    document |= judgement._asdict()
    document |= {"error": {"reason": str(refusal), "remedy": ""}} if refusal else {}
    names = ["tune.html"]
    if gains:
        names += ["gains.params", *["gains.param"] * (telemetry.autopilot == "ARDUPILOTMEGA")]
    if out is not None:
        texts = tune_page(Path(source).name, found), *parameter_files(gains, telemetry)
        with files_in(out, names) as paths:
            for path, text in zip(paths, texts, strict=False):
                path.write_text(text, "utf-8", "replace")
        say_aside(f"Written: {', '.join(names)}. Nothing was sent to the vehicle.")
    if as_json:
        print_json(document)
    else:
        above, *lights, following = conclusion(judgement)
        blocks = tune_blocks(found, verbose)
        blocks += [Sentence(notch.advised, "Notch filter:")] if notch else []
        page = [] if out is None else [Sentence(str(out / names[0]), "Page:")]
        print_screen(None, [], lights, [*blocks, above, following, *page], verbose)
    if refusal:
        raise click.exceptions.Exit(1)


def axis_document(advice: Advice | Fact) -> Values:
    """Returns what the document holds of an axis: its loops and gains, or why there are none."""
    if isinstance(advice, Fact):
        return {"refusal": advice}
    return {
        "loop": advice.before,
        "filters": gyro_filters(advice.before.controller, advice.before.crossover),
        "target": advice.target,
        "verdict": advice.rating,
        "sentence": advice.sentence,
        "sure": advice.sure,
        "gains": advice.gains,
        "expected": None if advice.refusals else advice.after,
        "noise": advice.noise,
    }


def parameter_files(gains: Parameters, telemetry: Telemetry) -> tuple[str, str]:
    """Returns ``gains`` as QGroundControl loads them, and as Mission Planner does.

    The former has a line of vehicle id, component id, name, value and type, by tabs; the latter of name and value.
    """
    who = f"{telemetry.system}\t{telemetry.component}"
    head = "# Gains by mavdem tune\n"
    ground = "".join(f"{who}\t{name}\t{value:.9g}\t{REAL32}\n" for name, value in gains.items())
    return head + ground, head + "".join(f"{name},{value:.9g}\n" for name, value in gains.items())
