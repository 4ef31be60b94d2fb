"""``mavdem serve``: a web server to which logs are uploaded in a browser, and which shows their results."""

from pathlib import Path

import click

from mavdem.cli.options import (
    NumberRange,
    WholeNumberRange,
    host_option,
    jobs_option,
    token_option,
    vehicle_option,
)
from mavdem.cli.sign_in_links import print_sign_in_link
from mavdem.cli.streams import print_to_stderr
from mavdem.dem.parallel import available_workers
from mavdem.extras import require_extra
from mavdem.facts import Fact
from mavdem.fleet.workers import JobLimits
from mavdem.machine import has_screen

SAMPLE_LOG = Path(__file__).parents[1] / "serve" / "sample_flight.tlog"
"""Log of a simulated flight that the server offers to visitors without a log."""

BYTES_PER_GB = 1e9
"""Bytes in a gigabyte."""

MAX_QUOTA = 1_000_000
"""Largest --quota, GB: more than any disk, so that a mistyped number is refused."""

READER_LIMITS = JobLimits(megabytes=1000, logs=8)
"""Limits of a process that reads logs for the server.

They are wider in memory than those of ``mavdem track``, since the page and the recording need more than rows, and
a process is replaced after a few logs, since Rerun leaves 20 MB and four threads for each recording.
"""


@click.command("serve")
@click.argument(
    "folder",
    default="mavdem-data",
    type=click.Path(file_okay=False, path_type=Path),
)
@host_option
@click.option("--port", default=8600, show_default=True, type=WholeNumberRange(0, 65535))
@token_option("Secret that uploading and the list of flights need")
@click.option(
    "--behind-proxy",
    is_flag=True,
    help="A reverse proxy in front of the server checks who may use it.",
)
@click.option(
    "--quota",
    metavar="GB",
    type=NumberRange(0.001, MAX_QUOTA),
    help="What logs and results may take on the disk. [default: all but 64 MB]",
)
@jobs_option
@click.option(
    "--scheduler",
    metavar="tcp://HOST:PORT",
    help="Read logs on this Dask cluster instead, whose machines share FOLDER.",
)
@click.option(
    "--link",
    metavar="LINK",
    help="Attach to a vehicle, as `mavdem live` does: its page while it flies, and its log once it falls silent.",
)
@click.option(
    "--request-rate",
    type=NumberRange(1, 1000),
    metavar="HZ",
    help="Ask the vehicle of --link for rates and parameters, as `mavdem live` does; without it nothing is sent.",
)
@vehicle_option
@click.option("--no-browser", is_flag=True, help="Open no browser.")
def serve_command(
    folder: Path,
    host: str,
    port: int,
    token: str,
    behind_proxy: bool,
    quota: float | None,
    jobs: int | None,
    scheduler: str | None,
    link: str | None,
    request_rate: float | None,
    vehicle: str | None,
    no_browser: bool,
) -> None:
    """Shows dropped logs in a browser, and the library of flights.

    FOLDER has logs, pages and the index; it may be that of `mavdem track`. Without --token or --behind-proxy the server
    listens on this machine only. Each flight has a link that cannot be guessed; its owner shares it, or not.

    \b
    Examples:
      mavdem serve
      mavdem serve fleet/ --port 8000
      mavdem serve --link udpin:127.0.0.1:14550
      MAVDEM_TOKEN=$(openssl rand -hex 16) mavdem serve --host 0.0.0.0 --quota 100
      curl -F filearg=@flight.bin http://127.0.0.1:8600/api/logs

    QGroundControl, PX4's upload_log.py and ARK's logloader upload to http://127.0.0.1:8600/upload, or to the address
    that the first page shows. The interface for programs is described at /api/openapi.json.
    """
    if request_rate is not None and link is None:
        raise click.UsageError(
            "--request-rate asks the vehicle of --link: give --link LINK too, or leave --request-rate out."
        )
    if vehicle is not None and link is None:
        raise click.UsageError(
            "--vehicle chooses among those of --link: give --link LINK too, or leave --vehicle out."
        )
    require_extra("serve", "`mavdem serve`")
    # The web framework takes a second to import, live sessions as long, and `mavdem serve --help` does not need them.
    from mavdem.cli.console import STDERR
    from mavdem.cli.live_status import StatusLines
    from mavdem.serve.run import ServerOptions, serve

    options = ServerOptions(
        folder=folder,
        host=host,
        port=port,
        token=token,
        is_behind_proxy=behind_proxy,
        quota=None if quota is None else int(quota * BYTES_PER_GB),
        processes=jobs or available_workers(),
        limits=READER_LIMITS,
        scheduler=scheduler,
        sample_log=SAMPLE_LOG,
        link=link,
        request_rate=request_rate,
        vehicle=vehicle,
    )

    def report_address(address: str, sign_in_link: str) -> None:
        print_to_stderr(f"Serving {folder} at {address}; Ctrl-C ends it.")
        print_sign_in_link(sign_in_link)

    def report_warning(fact: Fact) -> None:
        print_to_stderr(f"mavdem: {fact.sentence_and_remedy}")

    status_lines = StatusLines(console=STDERR)
    opens_browser = has_screen() and not no_browser
    serve(
        options,
        report_address,
        report_warning,
        status_lines.print_event,
        status_lines.show_status,
        opens_browser=opens_browser,
    )
