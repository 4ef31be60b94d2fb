"""The page: one file that fetches nothing, runs nothing, escapes everything, and fits a narrow and a wide window."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from mavdem.page.inline_svg import inline_svg

from mavdem.page import Chapter, Drawing, render_page
from mavdem.report.blocks import Sentence, Table

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
HOSTILE = "<script>document.title='owned'</script>\"'&--><b>.tlog"
VOID = {"meta", "path", "use", "rect", "br"}


class Balanced(HTMLParser):
    """Raises ``AssertionError`` for tags that do not close in order, and collects them."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.ids: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert tag in VOID or self.open.pop() == tag


def drawn(label: str = "measured", samples: int = 20_000) -> Figure:
    figure = Figure(figsize=(6, 3))
    axes = figure.subplots()
    time = np.linspace(0, 60, samples)
    values = np.sin(time) + 0.1 * np.random.default_rng(1).normal(size=samples)
    values[samples // 2] = 5.0
    axes.plot(time, values, color="#12ab56", label=label)
    axes.fill_between(time, values - 0.3, values + 0.3, color="#345678", alpha=0.3)
    axes.legend()
    return figure


def page(name: str = "flight.tlog") -> str:
    drawings = [Drawing(name, inline_svg(drawn(name), f"figure-{i}", name, {"#12ab56": "ink"}), name) for i in range(3)]
    blocks = [
        Sentence("", lead=f"Good: {name}"),
        Sentence(f"`mavdem learn {name}`", "Caution:"),
        Table(["motor", "effect of a motor, °/s² per µs", "status"], [[name, "8.3 ± 0.7", "reported"]] * 4),
    ]
    chapters = [Chapter("Pictures", drawings=drawings), Chapter(name, [Table([name], [[name]])], folded=True)]
    return render_page(name, name, blocks, chapters, [(name, "8.3 ± 0.7")] * 7)


@pytest.mark.slow
def test_the_same_result_makes_the_same_bytes():
    assert page() == page()


def test_tags_close_in_order_ids_are_unique_and_nothing_is_fetched_or_run():
    text = page()
    found = Balanced(text)
    assert len(found.ids) == len(set(found.ids)) and {"svg", "table", "details"} <= set(found.seen)
    assert not {"script", "link", "img", "iframe"} & set(found.seen)
    assert "://" not in text and "@import" not in text


def test_what_comes_from_a_log_is_text():
    found = Balanced(page(HOSTILE))
    assert not {"script", "b"} & set(found.seen)


def test_lines_are_thinned_and_keep_their_extremes():
    svg = str(inline_svg(drawn(), "one", "label", {"#12AB56": "measured"}))
    assert len(svg) < 100_000
    assert "var(--measured)" in svg and "#12ab56" not in svg and "#345678" in svg
    (line,) = re.findall(r'<path d="(M[^"]*)" clip-path[^>]*var\(--measured\)', svg)
    heights = [float(pair.split()[1]) for pair in re.split(r"[ML] ", line)[1:]]
    highest, others = min(heights), sorted(heights)[1]
    assert others - highest > 50  # the single sample of 5.0 is still there, far above the others


def test_a_break_in_a_line_stays_a_break():
    time = np.linspace(0, 1, 1000)
    values = np.sin(40 * time)
    values[400:500] = np.nan
    figure = Figure()
    figure.subplots().plot(time, values, color="#12ab56")
    with mpl.rc_context({"path.simplify": False}):
        svg = str(inline_svg(figure, "one", "label", {"#12ab56": "measured"}))
    (line,) = re.findall(r'<path d="(M[^"]*)" clip-path[^>]*var\(--measured\)', svg)
    assert line.count("M") == 2


def in_browser(text: str, folder: Path, width: int) -> tuple[str, str]:
    """The DOM after a script has put the widths of page and window into its title; and the browser's log."""
    if CHROMIUM is None:
        pytest.skip("there is no Chromium")
    path = folder / "page.html"
    script = "document.title = [document.documentElement.scrollWidth, innerWidth, document.title].join(' ')"
    path.write_text(f"{text}<script>{script}</script>")
    ran = subprocess.run(
        [
            *(CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--hide-scrollbars"),
            *(f"--user-data-dir={folder / 'profile'}", f"--window-size={width},1000", "--dump-dom", path.as_uri()),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    return ran.stdout, ran.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("name", "width"), [("flight.tlog", 1600), (HOSTILE + "x" * 200, 500)])
def test_a_browser_shows_it_without_a_complaint_and_without_scrolling_sideways(name, width, tmp_path):
    dom, log = in_browser(page(name), tmp_path, width)
    found = re.search(r"<title>(\d+) (\d+) (.*?)</title>", dom)
    assert found is not None and int(found[1]) <= int(found[2]) == width
    assert "owned" not in found[3].split("&lt;")[0]
    assert "CONSOLE" not in log
