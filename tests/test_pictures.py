"""The pictures of README and docs, which tools/pictures makes, are as new as what they show; and so are the screens."""

import ast
import contextlib
import hashlib
import io
import json
import os
import re
import shlex
import subprocess
from itertools import pairwise
from math import isclose
from pathlib import Path

import rerun as rr
from pytest import mark
from rerun.chunk import RrdReader
from rerun_file import first_texts

from mavdem.cli.commands import main
from mavdem.view.live_content import Channels, live_blueprint

pytestmark = mark.slow

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures.json"
NUMBER = re.compile(r"-?(?:\d+,)*\d+(?:\.\d+)?")
CHANNELS = Channels(
    "live", 0.01, (25,), ("motor 1",), ("roll", "roll rate"), ("µs",), ("rad", "rad/s")
)


def page_words(path):
    """What a page says, without its pictures and what is folded."""
    unseen = r"<(script|style|svg|noscript|details|footer)\b.*?</\1>|<[^>]*>"
    return re.sub(unseen, " ", path.read_text(), flags=re.DOTALL)


def recording_words(path):
    """Returns the names of a recording's views, and the documents in them, as one text."""
    reader = RrdReader(path)
    names = [
        name
        for element in reader.blueprints()
        for name in first_texts(reader.stream(store=element), "ViewBlueprint:display_name")
    ]
    document_texts = first_texts(reader.stream(), "TextDocument:text")
    return " · ".join([*sorted(names), *sorted(document_texts)])


def code(name):
    """A digest of what a file does: without comments, docstrings and layout, the same in every version of Python."""
    tree = ast.parse((ROOT / "mavdem" / name).read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value = ast.Constant("")
    document_texts = [
        f"{type(node).__name__} {[field for _, field in ast.iter_fields(node) if isinstance(field, (str, int, float))]}"
        for node in ast.walk(tree)
    ]
    return hashlib.sha256("\n".join(document_texts).encode()).hexdigest()[:16]


def alike(now, before):
    """Returns whether two texts have the same words, and numbers that differ by rounding only."""
    pairs = zip(NUMBER.findall(now), NUMBER.findall(before), strict=False)
    near = (
        isclose(*(float(element.replace(",", "")) for element in pair), rel_tol=0.1, abs_tol=0.5)
        for pair in pairs
    )
    return NUMBER.sub("#", " ".join(now.split())) == NUMBER.sub(
        "#", " ".join(before.split())
    ) and all(near)


def learned_pictures():
    """What the pictures of a learned flight show."""
    assert main(["fly", "iris_identification_wind", "--out", "flight.tlog"]) == 0
    assert main(["learn", "flight.tlog", "--rrd"]) == 0
    sample_log = ROOT / "logs" / "first_flight_ardupilot.tlog"
    assert main(["review", str(sample_log), "--out", "sample"]) == 0
    assert main(["fly", "wind_legs", "--out", "wind_legs.tlog"]) == 0
    assert main(["wind", "wind_legs.tlog", "--out", "wind"]) == 0
    # The flights of tools/pictures: the first without its propeller that chips.
    description = _described("first_flight_px4")
    sound = description.replace("\nmotor = 3 ", "\nmotor = 0 ")
    Path("sound.toml").write_text(sound, encoding="utf-8")
    assert main(["fly", "sound.toml", "--seed", "204", "--out", "thursday.tlog"]) == 0
    assert main(["fly", "first_flight_px4", "--seed", "205", "--out", "friday.tlog"]) == 0
    assert main(["diff", "thursday.tlog", "friday.tlog", "--out", "compared"]) == 0
    return {
        "dashboard": recording_words("flight/flight.rrd"),
        "browser": page_words(Path("sample/report.html")),
        "wind": page_words(Path("wind/wind.html")),
        "comparison": page_words(Path("compared/diff.html")),
    }


def _described(scenario):
    """A scenario as a .toml file, as ``fly --describe`` prints it."""
    described = io.StringIO()
    with contextlib.redirect_stdout(described):
        assert main(["fly", scenario, "--describe"]) == 0
    return described.getvalue()


def template(name):
    """A digest of a page's template."""
    text = (ROOT / "mavdem" / "report" / name).read_text()
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def test_a_picture_is_as_new_as_what_it_shows(here, request):
    """Words with their figures; of pictures that take minutes or need a screen, the code that draws them.

    A flight is learned from only with ``--in-full``, or where its picture is made.
    """
    assert main(["fly", "hover_blower", "--duration", "30", "--rrd", "blown.rrd"]) == 0
    with rr.RecordingStream("live") as recording:
        recording.save("live.rrd")
        recording.send_blueprint(live_blueprint(CHANNELS))
    words_by_picture = {
        "live_dashboard": recording_words("live.rrd"),
        "simulated_flight": NUMBER.sub("", recording_words("blown.rrd")),
        "loops": code("report/charts/flight_charts.py"),
        "library": template("serve/lines.html"),
        "fleet": template("fleet.html"),
        "live_page": template("live.js"),
    }
    stored_words = json.loads(PICTURES.read_text())
    named_pictures = os.environ.get("PICTURES", "").split()
    of_flights = {"dashboard", "browser", "wind", "comparison"}
    if request.config.getoption("--in-full") or of_flights & {*named_pictures}:
        words_by_picture |= learned_pictures()
    if request.config.getoption("--write-golden"):
        stored_words |= {name: " ".join(words_by_picture[name].split()) for name in named_pictures}
        PICTURES.write_text(json.dumps(stored_words, indent=1, ensure_ascii=False) + "\n")
    assert {path.stem for path in (ROOT / "docs").glob("*.png")} == set(stored_words)
    old = [name for name, words in words_by_picture.items() if not alike(words, stored_words[name])]
    assert not old, f"they show what an earlier version did: run tools/pictures {' '.join(old)}"


class Terminal(io.StringIO):
    """What is printed on a terminal."""

    def isatty(self):
        return True


def shown_after_commands(page):
    """The commands and what they print of each block of a page that is followed by a block of text."""
    text = (ROOT / page).read_text()
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    return [
        (commands, words_by_picture)
        for (_, commands), (kind, words_by_picture) in pairwise(blocks)
        if kind == "text"
    ]


@mark.usefixtures("without_pages", "logs_read_once")
def test_the_tutorial_shows_what_its_commands_print(here, monkeypatch, request):
    """On a terminal of 80 columns: what the commands of the block before print.

    Only the first review, which the README shows, too, is printed in every run: all others take long, and are printed
    with ``--in-full`` or to be written anew. The pages that they write have tests of their own, and are left empty.
    """
    options = request.config.option
    prints_all = options.in_full or options.write_golden
    (here / "logs").symlink_to(ROOT / "logs")
    for name, value in {"COLUMNS": "80", "TERM": "dumb", "NO_COLOR": "1"}.items():
        monkeypatch.setenv(name, value)
    page = ROOT / "docs" / "tutorial.md"
    text = page.read_text()
    blocks = shown_after_commands(page)
    for commands, words_by_picture in blocks if prints_all else blocks[:1]:
        # The same commands follow, of the flight after.
        commands = "".join(re.findall(r"^(?!.*--out before).*\n", commands, re.MULTILINE))
        now = _printed(commands, monkeypatch)
        if options.write_golden:
            text = text.replace(f"```text\n{words_by_picture}", f"```text\n{now}", 1)
            page.write_text(text)
            words_by_picture = now
        assert alike(
            *(re.sub(r"took [0-9.]+ s", "", element) for element in (now, words_by_picture))
        )


def _printed(commands, monkeypatch):
    """What ``commands``, one a line, print that is not sent to a file."""
    terminal = Terminal()
    for line in commands.splitlines():
        if line.startswith("printf"):
            subprocess.run(line, shell=True, check=True)
            continue
        command, _, unseen = line.partition(" > ")
        monkeypatch.setattr("sys.stdout", io.StringIO() if unseen else terminal)
        # A command that refuses something, such as new gains, says so and returns 1.
        assert main(shlex.split(command)[1:]) in (0, 1)
    return terminal.getvalue()


def test_the_readme_shows_the_screen_of_the_tutorial(request):
    """Both review the same log: what the test above prints for the tutorial is what the README shows."""
    tutorial_command, tutorial_screen = shown_after_commands("docs/tutorial.md")[0]
    ((readme_command, readme_screen),) = shown_after_commands("README.md")
    assert tutorial_command == f"{readme_command.rstrip()} --out flight\n"
    # The time that it took is the same, too.
    expected_screen = tutorial_screen.replace("Page: flight/", "Page: first_flight_ardupilot/")
    if request.config.getoption("--write-golden"):
        text = (ROOT / "README.md").read_text()
        (ROOT / "README.md").write_text(text.replace(readme_screen, expected_screen, 1))
        readme_screen = expected_screen
    assert readme_screen == expected_screen
