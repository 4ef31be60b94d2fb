"""The server's pages in Chromium: drop, progress, search, compare, share, delete, by keyboard, on a telephone, dark."""

from unittest.mock import Mock

from browsing import FITS, HOSTILE
from pytest import mark
from serving import TOKEN, log, serving

from mavdem.facts.serve import Sharing

pytestmark = mark.slow

DROP = """(() => {
  const data = new DataTransfer();
  for (const [name, content] of %s)
    data.items.add(new File([Uint8Array.from(atob(content), one => one.charCodeAt(0))], name));
  document.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
})()"""
ROWS = "document.querySelectorAll('#flights tbody tr').length"
SHOWN = "document.body.innerText"


def drop(page, *files):
    import base64
    import json

    page.run(DROP % json.dumps([[name, base64.b64encode(data).decode()] for name, data in files]))


def test_logs_are_dropped_followed_found_compared_and_deleted(tmp_path, browser):
    with serving(tmp_path / "served", is_eager=False) as server, browser.tab() as page:
        page.open(f"{server.address}/")
        assert "Drop a flight log here" in page.run(SHOWN)
        uploads = [
            (f"{number}.ulg", log(f"{'Odd' if number % 2 else 'Even'} {number}."))
            for number in range(20)
        ]
        drop(page, *uploads, ("letter.txt", b"text"), (f"{HOSTILE}.ulg", log(HOSTILE)))
        page.until("document.querySelectorAll('#uploads li').length === 22")
        page.until("document.querySelectorAll('#uploads a').length === 21")
        page.until("document.querySelectorAll('#uploads .bad').length === 1")
        server.work.run()
        page.until("!document.querySelector('#uploads progress')")
        page.until("document.getElementById('uploadprogress').hidden")
        counts = "document.getElementById('uploadcount').textContent"
        page.until(f"{counts} === '21 of 22 analysed, 1 not read'")
        # The links at the top count the vehicles that came meanwhile.
        page.until("document.querySelector('.top nav').textContent.includes('Vehicles (')")
        listed = "[...document.querySelectorAll('#uploads li:not(.hidden)')]"
        assert page.run(f"{listed}.map(item => item.firstChild.textContent)") == ["letter.txt"]
        page.run("document.getElementById('showuploads').click()")
        assert page.run(f"{listed}.length") == 22
        # What was not read is listed until somebody removes it.
        page.run("document.querySelector('#uploads .close').click()")
        page.until(f"{counts} === '21 of 21 analysed'")
        assert page.run("document.querySelectorAll('#uploads .close').length") == 0
        assert page.run("document.title") == "Flights"

        page.open(f"{server.address}/")
        assert page.run(ROWS) == 21
        # What the library has already says so, with its link.
        drop(page, ("1.ulg", log("Odd 1.")), ("copy.ulg", log("Even 2.")))
        page.until(f"{counts} === '0 of 2 analysed, 2 already here'")
        assert page.run(f"{listed}[0].textContent").startswith("1.ulg■ Already here: Odd 1.")
        assert page.run(f"{listed}.every(item => item.firstChild.href.includes('/f/'))")
        # One alone leads to its page.
        drop(page, ("alone.ulg", log("Alone.")))
        page.until("location.pathname.startsWith('/f/')")
        server.work.run()
        page.until("document.querySelector('#bar')")
        page.open(f"{server.address}/")
        assert page.run(ROWS) == 22
        # As one types, and back again by the browser's button.
        page.run("document.querySelector('[name=q]').focus()")
        page.command("Input.insertText", text="odd")
        page.until(f"{ROWS} === 10")
        page.run("document.querySelector('#flights a.name').click()")
        page.until("location.pathname.startsWith('/f/')")
        page.until("document.querySelector('#bar')")
        page.run("history.back()")
        page.until(f"{ROWS} === 10 && document.querySelector('[name=q]').value === 'odd'")

        for box in (0, 1):
            page.run(f"document.querySelectorAll('#flights input')[{box}].click()")
        page.run("document.getElementById('compare').click()")
        page.until("document.querySelector('h1')?.textContent.includes(' and ')")
        page.run("history.back()")
        page.until(f"{ROWS} === 10")
        # The browser ticks both boxes again.
        page.until("!document.getElementById('compare').disabled")
        page.run("document.querySelectorAll('#flights input:checked').forEach(one => one.click())")
        page.run("document.querySelector('#flights input').click()")
        page.run("document.getElementById('remove').click()")
        page.until(f"{ROWS} === 9")
        # Enter opens the only flight that is found.
        page.run("document.querySelector('[name=q]').select()")
        page.command("Input.insertText", text="alone")
        page.run("document.getElementById('find').requestSubmit()")
        page.until("location.pathname.startsWith('/f/') && document.getElementById('given_name')")
        # A new name loads the page again, which still says that it is saved.
        page.run("document.getElementById('given_name').value = 'By itself'")
        page.run("document.getElementById('edit').requestSubmit()")
        page.until("document.querySelector('h1')?.textContent.startsWith('By itself')")
        page.until("document.getElementById('saved').textContent === 'Saved.'")
        # Another flight of the vehicle has changed the verdict on this one, which the page shows once it is looked at.
        anomaly = "'$.health', 'fault', '$.health_reason', 'Motor 3 lost thrust.'"
        judged = f"judged = '', brief = json_set(brief, {anomaly})"
        server.library.db.execute(f"update flights set {judged}")
        page.run("document.activeElement.blur()")
        page.run("document.dispatchEvent(new Event('visibilitychange'))")
        page.until("document.querySelector('.headline').textContent === 'Motor 3 lost thrust.'")
        assert server.library.find("1", (), 1)[1] == 21
        # Who names the vehicle of a flight is led to the page of that vehicle.
        server.add("by_id.ulg", "Known by id.")
        server.work.run()
        page.open(f"{server.address}/vehicle?name=ardupilotmega-1")
        page.run("document.querySelector('#flights input').click()")
        page.run("document.getElementById('assigned_name').value = 'Red quad'")
        page.run("document.getElementById('assign').click()")
        page.until("document.getElementById('named')?.textContent === 'Saved.'")
        assert page.run("document.querySelector('h1').textContent") == "Red quad"
        assert page.said == []


@mark.in_full
def test_a_link_is_shared_and_opened_in_another_profile(tmp_path, browser):
    """The owner signs in, shares a flight by its link and deletes it.

    The other browser profile sees it only in between.
    """
    with (
        serving(tmp_path / "served", TOKEN, is_eager=False) as server,
        browser.tab() as own_tab,
        browser.tab() as other_tab,
    ):
        id = server.add("a.ulg", "One.", token=TOKEN)
        address = f"{server.address}/f/{id}"
        own_tab.open(f"{server.address}/enter")
        own_tab.run("document.getElementById('token').focus()")
        own_tab.command("Input.insertText", text=TOKEN)
        own_tab.press("Enter", 13)
        own_tab.until(f"{ROWS} === 1")
        other_tab.open(address)
        assert "There is no such flight" in other_tab.run(SHOWN)

        # The page opens by itself when the log has been read.
        own_tab.open(address)
        own_tab.until("document.querySelector('#steps li.is')")
        server.work.run()
        # Its buttons do something when the page has its scripts, too.
        own_tab.until("document.readyState === 'complete' && document.querySelector('#bar')")
        own_tab.run("document.querySelector('#bar summary').click()")
        copied = "document.getElementById('copied').textContent"
        own_tab.run("document.getElementById('copy').click()")
        own_tab.until(f"{copied}.includes('Nobody else can open it')")
        own_tab.run("document.getElementById('sharing').value = 'link'")
        own_tab.run("document.getElementById('note').value = 'Gusty'")
        own_tab.run("document.querySelector('#edit button:not([type])').click()")
        own_tab.until("document.getElementById('saved').textContent === 'Saved.'")
        assert server.library.entry(id).sharing == Sharing.LINK
        own_tab.run("document.getElementById('copy').click()")
        own_tab.until(f"{copied}.startsWith('Copied.') && !{copied}.includes('Nobody')")
        other_tab.open(address)
        assert "One." in other_tab.run(SHOWN) and "Gusty" in other_tab.run(SHOWN)
        assert not other_tab.run(
            "document.getElementById('edit') || document.getElementById('delete')"
        )
        other_tab.open(f"{server.address}/")
        assert other_tab.run(ROWS) == 0

        own_tab.run("document.getElementById('delete').click()")
        own_tab.until("location.pathname === '/'")
        other_tab.open(address)
        assert "There is no such flight" in other_tab.run(SHOWN)
        assert own_tab.said == []


@mark.in_full
def test_pages_fit_a_telephone_and_are_used_by_keyboard(tmp_path, browser):
    """Each page is opened on a telephone, and shown at several widths, light and dark.

    No page may be wider than the screen, and Tab and Enter open a flight.
    """
    with serving(tmp_path / "served") as server, browser.tab() as page:
        id = server.add("a_log_with_a_very_long_name_that_does_not_break_" * 3 + ".ulg", "One.")
        failed = server.add("b.ulg", "damaged")
        for path in (
            "/",
            f"/f/{id}",
            f"/f/{failed}",
            "/vehicle?name=quad 7",
            "/vehicles",
            f"/compare?a={id}&b={id}",
            "/f/none",
        ):
            page.size(360, dark=True)
            page.open(f"{server.address}{path.replace(' ', '%20')}")
            for width, dark in ((360, True), (500, True), (500, False), (1280, True)):
                page.size(width, dark)
                assert page.run(FITS), (width, path)
                colour = page.run("getComputedStyle(document.body).backgroundColor")
                assert (colour == "rgb(20, 23, 27)") == dark
        page.size(360, dark=True)
        # What is done with a chosen flight stays in sight on a telephone.
        page.open(f"{server.address}/")
        page.run("document.querySelector('#flights input[name=id]').click()")
        page.run("document.body.style.paddingTop = '3000px'; scrollTo(0, 0)")
        places = page.run(
            "[innerHeight, document.getElementById('remove').getBoundingClientRect().toJSON()]"
        )
        assert 0 < places[1]["top"] < places[1]["bottom"] <= places[0]
        # The first things a keyboard reaches, and a flight opened with it.
        page.open(f"{server.address}/")
        reached = []
        for _ in range(20):
            page.press("Tab", 9)
            reached.append(
                page.run("document.activeElement.id || document.activeElement.className")
            )
        assert {"brand", "filearg", "name"} <= set(reached)
        page.run("document.querySelector('#flights a.name').focus()")
        page.press("Enter", 13)
        page.until("location.pathname.startsWith('/f/')")


COUNT_REQUESTS = """(async () => {
  const wait = milliseconds => new Promise(resolve => setTimeout(resolve, milliseconds)), ask = fetch;
  let requests = 0;
  window.fetch = (...given) => { requests += 1; return ask(...given); };
  for (let event = 0; event < 10; event += 1) { dispatchEvent(new Event("pointerover")); await wait(50); }
  const after_events = requests;
  await wait(1200);
  return requests - after_events;
})()"""
"""The requests in 1.2 s after the pointer moved over a page ten times; the page asks once a second."""


def test_a_page_that_waits_for_the_viewer_asks_once_a_second(tmp_path, browser):
    with (
        serving(
            tmp_path / "served", is_eager=False, viewer=Mock(**{"open.return_value": ""})
        ) as server,
        browser.tab() as page,
    ):
        id = server.add("a.ulg", "With a model.")
        server.work.run()
        page.open(f"{server.address}/f/{id}/viewer")
        page.until("document.getElementById('viewer_status').textContent")
        page.command("Emulation.setFocusEmulationEnabled", enabled=True)
        page.until("document.hasFocus()")
        assert 1 <= page.run(COUNT_REQUESTS) <= 2
