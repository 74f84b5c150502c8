"""The explorer's page as a user meets it: the command in a process of its own, and headless Chromium."""

import re
import signal
import socket
import sys
import time
import urllib.error
import urllib.request

import pytest
from conftest import drag, start_program

from warp_plate import viz
from warp_plate.viz.explorer_page import missing_page

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send to one process"),
]

# Longest wait on a busy machine [s].
PATIENCE = 60.0
# The command, with a secret that begins with a hyphen, as one in 64 does.
COMMAND = """
import secrets, sys
token = secrets.token_urlsafe
secrets.token_urlsafe = lambda: "-" + token()
from warp_plate.cli.main import main
main(sys.argv[1:])
"""


@pytest.fixture
def served(tmp_path, write_scene, monkeypatch):
    """The address at which ``explore`` serves a small scene and which it opens; Ctrl-C ends it quietly."""
    if (problem := missing_page() or viz.missing_renderer()) is not None:
        pytest.skip(problem)
    search = {"particles": 6, "iterations": 12}
    write_scene(damping=120.0, window=(0.08, 0.1), title="Panel {{ 1 + 1 }} <b>", search=search)
    opener = tmp_path / "browser"
    opener.write_text('#!/bin/sh\necho "$1" > opened\n', encoding="utf-8")
    opener.chmod(0o755)
    monkeypatch.setenv("BROWSER", str(opener))
    process = start_program("-c", COMMAND, "explore", "panel.toml", "--port", "0", "--device", "cpu")
    line = process.stdout.readline()
    address = re.search(r"http://127\.0\.0\.1:\d+/", line)
    try:
        if address:
            yield address.group()
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert address, f"{line + out!r}, {err!r}, status {process.returncode}"
    assert (process.returncode, out, err) == (0, "", "ended\n")


@pytest.fixture
def page(browser, served):
    """The loaded page; at the end there was no error, and no request to any other host."""
    made = browser.new_page(viewport={"width": 1300, "height": 900})
    requests, errors = [], []
    made.on("request", lambda request: requests.append(request.url))
    made.on("websocket", lambda opened: requests.append(opened.url))
    made.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    made.on("pageerror", lambda error: errors.append(str(error)))
    made.set_default_timeout(1000 * PATIENCE)
    made.goto(served)
    made.wait_for_selector("#stage img")
    yield made
    made.close()
    assert not errors
    host = served.split("/")[2]
    assert len(requests) > 5
    assert not [url for url in requests if not re.match(rf"(http|ws)://{re.escape(host)}/|data:|blob:", url)]


def number(page, selector):
    """The first number in an element's text."""
    return float(page.inner_text(selector).split()[0])


def wait(holds):
    """Wait until a condition holds."""
    until = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.05)


def test_sliders_and_buttons_change_picture_and_numbers(page):
    """All controls in one test, as starting the page takes seconds."""
    thumb = "#slide-{} .v-slider-thumb".format
    bound = number(page, "#bound")
    assert 0 < number(page, "#factor") < bound
    assert "Panel {{ 1 + 1 }} <b>" in page.inner_text("body")

    # The plate moves unless it is paused.
    stage = page.locator("#stage")
    before = stage.screenshot()
    wait(lambda: stage.screenshot() != before)
    page.click("#pause")
    page.wait_for_function("document.querySelector('#pause').innerText == 'play'")
    wait(lambda: stage.screenshot() == stage.screenshot())
    resting = stage.screenshot()

    # Dragging rotates it, paused or not.
    drag(page, "#stage", 60, -20)
    wait(lambda: stage.screenshot() != resting)
    wait(lambda: stage.screenshot() == stage.screenshot())
    resting = stage.screenshot()

    # Drives change the picture and the factor, not the bound.
    factor = number(page, "#factor")
    drag(page, thumb("magnitude_1"), -50)
    wait(lambda: number(page, "#factor") != factor)
    assert number(page, "#value-magnitude_1") < 1
    wait(lambda: stage.screenshot() != resting)
    drag(page, thumb("phase_2"), 60)
    wait(lambda: 0.5 < number(page, "#value-phase_2") < 6)
    assert number(page, "#bound") == bound

    # Frequency and damping change the bound as well.
    drag(page, thumb("frequency"), -30)
    wait(lambda: number(page, "#bound") != bound)
    assert number(page, "#value-frequency") < 290
    bound = number(page, "#bound")
    drag(page, thumb("damping"), 40)
    wait(lambda: number(page, "#bound") != bound)

    # The exact best drive reaches the bound, and the sliders follow.
    page.click("#choose-exact")
    wait(lambda: page.inner_text("#factor") == page.inner_text("#bound"))
    shares = [number(page, f"#{y}_{x}") for y in ("lower", "upper") for x in ("left", "right")]
    assert sum(shares) == pytest.approx(100, abs=0.3)
    page.click("#choose-equal")
    page.wait_for_function("document.querySelector('#value-magnitude_1').innerText == '1.000'")

    # The swarm is shown, and its best stays below the bound.
    resting = stage.screenshot()
    page.click("#choose-found")
    wait(lambda: stage.screenshot() != resting)
    wait(lambda: number(page, "#factor") > 0.5 * number(page, "#bound"))
    assert number(page, "#factor") <= number(page, "#bound")


def test_the_picture_fits_the_browser_window(page):
    page.set_viewport_size({"width": 900, "height": 600})
    wait(lambda: page.evaluate("document.querySelector('#stage img').naturalWidth") == 900 - 390)


def test_browsers_may_disconnect(browser, served, tmp_path):
    """Also a browser that is still connected does not delay Ctrl-C; see the fixture."""
    wait((tmp_path / "opened").exists)
    wait(lambda: (tmp_path / "opened").read_text("utf-8").strip() == served)
    for _ in range(2):
        tab = browser.new_page()
        tab.goto(served)
        # The second finds the plate paused, and is sent a picture nevertheless.
        tab.wait_for_selector("#stage img", timeout=1000 * PATIENCE)
        tab.wait_for_function("document.querySelector('#stage img').naturalWidth > 300", timeout=1000 * PATIENCE)
        tab.click("#pause")
        time.sleep(0.3)
    browser.contexts[0].pages[0].close()
    time.sleep(0.3)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no second address of their own by default")
def test_who_can_connect(served):
    """One server a port, at one address; the secret of the connection is given to this page only."""
    port = served.rstrip("/").rpartition(":")[2]
    second = start_program("-m", "warp_plate", "explore", "panel.toml", "--web", "--port", port, "--device", "cpu")
    out, err = second.communicate(timeout=PATIENCE)
    assert (second.returncode, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"warp-plate: --host 127.0.0.1 --port {port}: cannot be listened on: ")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", int(port)), PATIENCE)

    def session(host):
        request = urllib.request.Request(served + "paraview/", data=b"{}", headers={"Host": host})
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            return answer.status, dict(answer.headers)

    status, headers = session(served.split("/")[2])
    assert status == 200
    assert "Access-Control-Allow-Origin" not in headers
    with pytest.raises(urllib.error.HTTPError, match="403"):
        session("elsewhere.example:80")
