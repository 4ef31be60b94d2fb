"""The pages of ``mavdem serve``: the library, a flight while it is read, a vehicle, what changed, and refusals.

The page of a flight is that of its folder, with a bar above it. No page has a script of its own: there is one, apart,
and those that draw the charts, whose hashes a policy can name.
"""

import base64
import hashlib
import re
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment

from mavdem.containers import Names
from mavdem.facts import Fact
from mavdem.facts.lights import Light
from mavdem.files import load_adjacent_toml
from mavdem.fleet.flights import AxisRows
from mavdem.report.blocks import Block
from mavdem.report.charts.vehicle_charts import vehicle_group
from mavdem.report.fleet import HEALTH_LEVELS, vehicle_words
from mavdem.report.pages.fleet_page import with_fleet_remark
from mavdem.report.pages.page import environment, render_page

POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
SCRIPTS = ("sharp.js", "uplot/uPlot.iife.min.js", "charts.js")
"""Those that draw the charts within a page."""


@cache
def interface_words() -> dict[str, dict[str, str]]:
    """Returns what stages, sharing and the interface are called."""
    return load_adjacent_toml(__file__, "../serve/words.toml")


@cache
def script() -> bytes:
    """Returns the script of these pages."""
    return (files("mavdem.report") / "serve" / "serve.js").read_bytes()


@cache
def script_hashes() -> Names:
    """Returns the hashes, as a content security policy names them, of the scripts within a flight's page."""
    sources = [_environment().get_template(name).render() for name in SCRIPTS]
    digests = [hashlib.sha256(source.encode()).digest() for source in sources]
    return tuple(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)


@cache
def _environment() -> Environment:
    """Jinja's environment, with all templates compiled: whoever asks first should not wait for that."""
    made = environment().overlay()
    made.filters["brief"] = lambda name: name if len(name) < 20 else f"{name[:4]}…{name[-4:]}"
    choices = {"lights": [str(light) for light in Light], "healths": HEALTH_LEVELS}
    made.globals = {**made.globals, **interface_words(), **choices}
    for name in made.list_templates(["html"]):
        made.get_template(name)
    return made


def render_server_page(name: str, /, **values: Any) -> str:
    """Returns the HTML of the page of this ``name``, with these ``values``."""
    return render_page(_environment().get_template(f"serve/{name}.html"), **values)


def with_bar(page: str, **values: Any) -> str:
    """Returns the ``page`` of a flight with a bar above it, for a server whose policy takes the place of its own."""
    return with_fleet_remark(without_policy(page, **values), render_server_page("bar", **values))


def without_policy(page: str, **values: Any) -> str:
    """Returns a ``page`` for a server whose policy takes the place of its own."""
    key = render_server_page("key", **values)
    return POLICY.sub(lambda _: key, page, count=1)


def vehicle_page(flights: Sequence[AxisRows], changes: Iterable[Block], **values: Any) -> str:
    """Returns the HTML of one vehicle: its flights over time, and what differs from the baseline."""
    said = vehicle_words(flights).difference if flights else ""
    group = vehicle_group(flights) if len(flights) > 1 else None
    groups = [group] if group else []
    return render_server_page("vehicle", words=said, changes=[*changes], groups=groups, **values)


def refusal_page(fact: Fact, asks: bool, **values: Any) -> str:
    """Returns the HTML of why there is no other page; it ``asks`` for the token."""
    return render_server_page(
        "message", sentence=fact.sentence, remedy=fact.remedy, asks=asks, **values
    )
