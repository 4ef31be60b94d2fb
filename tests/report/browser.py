"""A browser without a screen: what a script says of a page."""

import html
import json
import re
import shutil
import subprocess

from pytest import skip

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
FITS = "return document.documentElement.scrollWidth <= innerWidth"
HOSTILE = "<script>document.title='owned'</script>\"'&--><b>"


def shown(page, script, folder, width=1600, *more):
    """The title of a page and what a script in it returns; the browser may not complain of anything."""
    if CHROMIUM is None:
        skip("there is no Chromium")
    path = folder / "page.html"
    said = (
        "<script>(async () => { const title = document.title, found = await (async () => { %s })();"
    )
    said = said % script + "document.title = JSON.stringify([title, found]) })()</script>"
    path.write_text(page + said)
    options = (
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-logging=stderr",
        "--hide-scrollbars",
    )
    place = (
        f"--user-data-dir={folder / 'profile'}",
        f"--window-size={width},1000",
        "--dump-dom",
        *more,
        path.as_uri(),
    )
    ran = subprocess.run([CHROMIUM, *options, *place], capture_output=True, text=True, check=True)
    assert "CONSOLE" not in ran.stderr
    found = re.search(r"<title>(.*?)</title>", ran.stdout, re.DOTALL)
    return tuple(json.loads(html.unescape(found[1])))
