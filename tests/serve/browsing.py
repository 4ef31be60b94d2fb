"""Chromium without a screen, driven over its DevTools protocol: what a person does, a page's policy notwithstanding.

Tests take it from the fixture ``browser``: its start takes as long as most of them, so that one serves all tests of a
process. So do its tabs, since a new one takes longer than a page: each has a profile of its own, which is emptied after
every test. What a test sets for its tab ends with the connection to it.
"""

import asyncio
import itertools
import json
import shutil
import subprocess
import time
from contextlib import contextmanager

from patience import PATIENCE, until
from pytest import skip

HURRY = """(factor => {
  const { now } = Date, wait = setTimeout, start = now();
  Date.now = () => start + factor * (now() - start);
  window.setTimeout = (action, milliseconds, ...given) => wait(action, milliseconds / factor, ...given);
})(%g)"""

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
MOUSE = (
    ("primaryHoverType", 2),
    ("availableHoverTypes", 2),
    ("primaryPointerType", 4),
    ("availablePointerTypes", 4),
)
"""Settings by which media queries see a pointer that is fine and can hover (blink's ``HoverType``, ``PointerType``)."""

FITS = "document.documentElement.scrollWidth <= innerWidth"
HOSTILE = "<script>document.title='owned'</script>\"'&--><b>"


class Connection:
    """A connection to the browser, or to a tab: ``said`` has what a tab's console complains of."""

    def __init__(self, loop, line):
        self._loop = loop
        self._line = line
        self._numbers = itertools.count(1)
        self.said = []

    def close(self):
        self._loop.run_until_complete(self._line.close())

    def command(self, method, **given):
        return self._loop.run_until_complete(self._command(method, given))

    async def _command(self, method, given):
        """Sends a command of the DevTools protocol, and returns its result.

        Dialogs are accepted, and errors of the page are collected meanwhile.
        """
        number = next(self._numbers)
        await self._line.send_json({"id": number, "method": method, "params": given})
        while True:
            answer = json.loads((await self._line.receive(PATIENCE)).data)
            if answer.get("method") == "Page.javascriptDialogOpening":
                accepted = {"id": next(self._numbers), "method": "Page.handleJavaScriptDialog"}
                await self._line.send_json(accepted | {"params": {"accept": True}})
            if answer.get("method") in ("Log.entryAdded", "Runtime.exceptionThrown"):
                entry = answer["params"].get("entry", answer["params"])
                if entry.get("source") not in (
                    "network",
                    "recommendation",
                ):  # A refusal is no fault.
                    self.said.append(entry)
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return answer["result"]


class Page(Connection):
    """A tab."""

    def __init__(self, loop, line):
        super().__init__(loop, line)
        for part in ("Page", "Runtime", "Log"):
            self.command(f"{part}.enable")

    def run(self, script):
        """What an expression is, once it is that."""
        result = self.command(
            "Runtime.evaluate",
            userGesture=True,
            expression=script,
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def until(self, script):
        """Waits until an expression holds, also on a page that comes meanwhile."""
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends:
            try:
                if self.run(f"!!({script})"):
                    return
            except AssertionError:  # The page was closed.
                pass
            time.sleep(0.02)
        raise AssertionError(script, self.run("document.body.innerText"))

    def hurry(self, factor=4.0):
        """Lets the clock of the page that is open run faster from now on, and the waits that it begins end sooner."""
        self.run(HURRY % factor)

    def open(self, address):
        self.command("Page.navigate", url=address)
        self.until(f"location.href === {json.dumps(address)} && document.readyState === 'complete'")

    def forget(self):
        """Closes the page, after what it has stored was deleted."""
        self.run(
            "try { localStorage.clear(); sessionStorage.clear(); } catch { /* An empty page stores nothing. */ }"
        )
        self.command("Network.clearBrowserCookies")
        self.open("about:blank")

    def size(self, width, dark=False):
        self.command(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=1000,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.command("Emulation.setEmulatedMedia", features=[scheme])

    def press(self, key, code=0):
        for kind in ("keyDown", "keyUp"):
            text = {"text": "\r"} if key == "Enter" and kind == "keyDown" else {}
            self.command(
                "Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **text
            )


class Browser:
    """A process of Chromium, whose files are in a ``folder``."""

    def __init__(self, folder):
        """Starts a headless Chromium with a profile in ``folder`` and connects to it, or skips the test without one."""
        if CHROMIUM is None:
            skip("there is no Chromium")
        options = ("--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0")
        # What Chromium does besides at its start takes as long as the start.
        options += ("--disable-extensions", "--disable-background-networking", "--no-first-run")
        options += ("--disable-component-update", "--disable-sync", "--disable-default-apps")
        # Pages of one site share a process, and none is started in advance: otherwise each page starts two of them.
        options += ("--process-per-site", "--renderer-process-limit=1")
        options += ("--disable-features=SpareRendererForSitePerProcess",)
        # A machine without a mouse would get the pages for touch screens, which are laid out differently.
        options += ("--blink-settings=" + ",".join(f"{name}={value}" for name, value in MOUSE),)
        arguments = [CHROMIUM, *options, f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(
            arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._loop = asyncio.new_event_loop()
        self._session = None
        self._free_tabs = []
        try:
            port_file = folder / "DevToolsActivePort"
            until(lambda: port_file.is_file() and port_file.read_text().count("\n"))
            port, path = port_file.read_text().splitlines()
            self._address = f"ws://127.0.0.1:{port}"
            self._session = self._loop.run_until_complete(_session())
            self._connection = Connection(self._loop, self._line(path))
        except BaseException:
            self.close()
            raise

    def close(self):
        if self._session is not None:
            self._loop.run_until_complete(self._session.close())
        self._process.kill()
        self._process.wait()
        self._loop.close()

    def _line(self, path):
        """A line to the browser or to a tab, by its path."""
        return self._loop.run_until_complete(_line(self._session, f"{self._address}{path}"))

    def _new_tab(self):
        """Opens a tab of a new profile, in a window of its own, and returns the path of its line."""
        context = self._connection.command("Target.createBrowserContext")
        target = self._connection.command("Target.createTarget", url="about:blank", **context)
        return f"/devtools/page/{target['targetId']}"

    @contextmanager
    def tab(self):
        """A tab of a profile of its own, in which nothing is stored."""
        path = self._free_tabs.pop() if self._free_tabs else self._new_tab()
        tab = Page(self._loop, self._line(path))
        try:
            yield tab
            tab.forget()
            self._free_tabs.append(path)
        finally:
            tab.close()

    def shown(self, page, script, folder, width=1600, dark=False):
        """The title of a page and what an expression is on it; the browser may not complain of anything."""
        path = folder / "page.html"
        path.write_text(page)
        with self.tab() as tab:
            tab.size(width, dark)
            tab.open(path.as_uri())
            result = tab.run(script)
            assert tab.said == []
            return tab.run("document.title"), result


async def _session():
    # Most tests of the modules that import this one open no page.
    import aiohttp

    return aiohttp.ClientSession()


async def _line(session, address):
    return await session.ws_connect(address, max_msg_size=0)
