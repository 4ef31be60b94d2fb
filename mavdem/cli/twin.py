"""``mavdem twin``: a simulated vehicle identified from a log, and how closely it repeats the flight."""

from pathlib import Path

import click

from mavdem.assessment.axis.twin import build_assessed_twin
from mavdem.cli.options import (
    NumberRange,
    json_option,
    params_option,
    source_argument,
    vehicle_option,
)
from mavdem.cli.output import print_result
from mavdem.cli.output_files import check_output_file
from mavdem.cli.sources import assess_without_model
from mavdem.cli.streams import print_to_stderr
from mavdem.files import write_text_atomically
from mavdem.loops.twin_flight import compare_twin_with_flight
from mavdem.report.vehicle_files import OMITTED_QUANTITIES, missing_axes, twin_blocks, vehicle_text


@click.command("twin")
@source_argument
@click.option(
    "--out",
    multiple=True,
    type=click.Path(path_type=Path),
    help="File to write, one or more, by its ending: .toml for `mavdem fly --vehicle`, .json a frame of ArduPilot's "
    "SITL, .params of PX4's SIH, .sdf motors of Gazebo.",
)
@click.option(
    "--mass",
    type=NumberRange(0.005, 1000.0),
    help="Mass of the vehicle, kg.  [default: 1.5, with a remark]",
)
@vehicle_option
@params_option
@json_option
def twin_command(
    source: str,
    out: tuple[Path, ...],
    mass: float | None,
    vehicle: str | None,
    params: Path | None,
    as_json: bool,
) -> None:
    """Makes a simulated vehicle of a log, and flies the log again.

    SOURCE is a log of a quadrotor with its autopilot's parameters, and motor outputs and attitude as `mavdem learn`
    needs them. Beside the vehicle's figures it prints how alike the log and the twin fly.

    \b
    Examples:
      mavdem twin flight.tlog --out mine.toml --mass 1.2
      mavdem fly iris_doublets --vehicle mine.toml --set MC_ROLLRATE_P=0.3 --out tried.tlog
    """
    for path in out:
        check_output_file(path, "--out", (".toml", *OMITTED_QUANTITIES))
    _, evidence = assess_without_model(source, vehicle, params)
    twin, loops, missing_loops = build_assessed_twin(evidence, mass)
    for path in out:
        ending = path.suffix.lower()
        write_text_atomically(path, vehicle_text(twin, ending, Path(source).name))
        if OMITTED_QUANTITIES.get(ending):
            print_to_stderr(f"{path.name} has no place for {OMITTED_QUANTITIES[ending]}.")
    comparison = compare_twin_with_flight(twin, loops)
    missing_blocks = missing_axes(missing_loops)
    document = {
        "vehicle": twin,
        "missing": [sentence.text for sentence in missing_blocks],
        "alike": comparison,
    }
    print_result(document, [*missing_blocks, *twin_blocks(twin, comparison)], as_json=as_json)
    if out:
        names = ", ".join(str(path) for path in out)
        print_to_stderr(f"Written: {names}. Nothing was sent to a vehicle.")
