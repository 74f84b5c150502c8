"""The explorer's page as a user meets it: the command in a process of its own, and headless Chromium."""

import re
import signal
import socket
import sys
import time

import pytest

from support.commands import start_program, until
from support.pictures import drag
from warp_plate import viz
from warp_plate.viz.explorer_page import missing_page

no_interrupt = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send to one process")
pytestmark = [pytest.mark.slow, no_interrupt]

# Longest wait on a busy machine [s].
PATIENCE = 60.0


@pytest.fixture
def page_at(tmp_path, write_scene, monkeypatch):
    """The address at which ``explore`` serves a small scene and which it opens; Ctrl-C ends it quietly."""
    if (problem := missing_page() or viz.missing_renderer()) is not None:
        pytest.skip(problem)
    tables = {"title": "Panel {{ 1 + 1 }} <b>", "search": {"particles": 6, "iterations": 12}}
    write_scene(damping=120.0, window=(0.08, 0.1), **tables)
    opener = tmp_path / "browser"
    opener.write_text('#!/bin/sh\necho "$1" > opened\n', encoding="utf-8")
    opener.chmod(0o755)
    monkeypatch.setenv("BROWSER", str(opener))
    process = start_program("-m", "warp_plate", "explore", "panel.toml", "--port", "0", "--device", "cpu")
    line = process.stdout.readline()
    address = re.search(r"http://127\.0\.0\.1:\d+/\?key=\w+", line)
    try:
        assert address, line
        yield address.group()
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out, err) == (0, "", "ended\n")


@no_interrupt
def test_sigterm_ends_the_page_quietly_where_ctrl_c_is_ignored():
    """As under nohup or in a background shell, where asyncio does not handle Ctrl-C itself."""
    if (problem := missing_page() or viz.missing_renderer()) is not None:
        pytest.skip(problem)
    arguments = "-m", "warp_plate", "explore", "paper", "--web", "--port", "0", "--device", "cpu"
    process = start_program(*arguments, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN))
    assert process.stdout.readline().startswith("open http://")
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out, err) == (0, "", "ended\n")


@pytest.fixture
def page(browser, page_at):
    """The loaded page; at the end there was no error, and no request to any other host."""
    made = browser.new_page(viewport={"width": 1300, "height": 900})
    requests, errors = [], []
    made.on("request", lambda request: requests.append(request.url))
    made.on("websocket", lambda opened: requests.append(opened.url))
    made.on("console", lambda message: message.type in ("error", "warning") and errors.append(message.text))
    made.on("pageerror", lambda error: errors.append(str(error)))
    made.set_default_timeout(1000 * PATIENCE)
    made.goto(page_at)
    made.wait_for_selector("#stage img")
    yield made
    made.close()
    assert not errors
    allowed = rf"(http|ws)://{re.escape(page_at.split('/')[2])}/|data:|blob:"
    assert len(requests) > 5
    assert not [url for url in requests if not re.match(allowed, url)]


def number(page, selector):
    """The first number in an element's text."""
    return float(page.inner_text(selector).split()[0])


def picture_at_rest(stage):
    until(lambda: stage.screenshot() == stage.screenshot())
    return stage.screenshot()


def test_sliders_and_buttons_change_picture_and_numbers(page):
    thumb = "#slide-{} .v-slider-thumb".format
    bound = number(page, "#bound")
    assert 0 < number(page, "#factor") < bound
    assert float(page.get_attribute("#meter", "value")) == pytest.approx(number(page, "#sound"), abs=0.06)
    assert "Panel {{ 1 + 1 }} <b>" in page.inner_text("body")

    # The plate moves unless it is paused.
    stage = page.locator("#stage")
    before = stage.screenshot()
    until(lambda: stage.screenshot() != before)
    page.click("#pause")
    until(lambda: page.inner_text("#pause") == "play")
    resting = picture_at_rest(stage)

    # Dragging rotates it, paused or not.
    drag(page, "#stage", 60, -20)
    until(lambda: stage.screenshot() != resting)
    resting = picture_at_rest(stage)

    # Drives change the picture and the factor, not the bound.
    factor = number(page, "#factor")
    drag(page, thumb("magnitude_1"), -50)
    until(lambda: number(page, "#factor") != factor)
    assert number(page, "#value-magnitude_1") < 1
    until(lambda: stage.screenshot() != resting)
    drag(page, thumb("phase_2"), 60)
    until(lambda: 0.5 < number(page, "#value-phase_2") < 6)
    assert number(page, "#bound") == bound

    # Frequency and damping change the bound as well.
    for key, distance in (("frequency", -30), ("number_0", 40)):
        bound = number(page, "#bound")
        drag(page, thumb(key), distance)
        until(lambda bound=bound: number(page, "#bound") != bound)
    assert number(page, "#value-frequency") < 290

    # The exact best drive reaches the bound, and the sliders follow.
    page.click("#choose-exact")
    until(lambda: page.inner_text("#factor") == page.inner_text("#bound"))
    shares = [number(page, f"#{y}_{x}") for y in ("lower", "upper") for x in ("left", "right")]
    assert sum(shares) == pytest.approx(100, abs=0.3)
    page.click("#choose-equal")
    until(lambda: page.inner_text("#value-magnitude_1") == "1.000")

    # The swarm is shown, and its best stays below the bound.
    resting = stage.screenshot()
    page.click("#choose-found")
    until(lambda: stage.screenshot() != resting)
    until(lambda: number(page, "#factor") > 0.5 * number(page, "#bound"))
    assert number(page, "#factor") <= number(page, "#bound")

    # The picture fits the browser's window.
    page.set_viewport_size({"width": 900, "height": 600})
    until(lambda: page.evaluate("document.querySelector('#stage img').naturalWidth") == 900 - 390)


def test_connections(browser, page_at, tmp_path):
    """There is one server per port, at one address.

    Browsers may disconnect, and one that is still connected does not delay Ctrl-C; see the fixture.
    """
    until((tmp_path / "opened").exists)
    until(lambda: (tmp_path / "opened").read_text("utf-8").strip() == page_at)
    for _ in range(2):
        tab = browser.new_page()
        tab.set_default_timeout(1000 * PATIENCE)
        tab.goto(page_at)
        # The second finds the plate paused, and is sent a picture nevertheless.
        tab.wait_for_function("document.querySelector('#stage img')?.naturalWidth > 300")
        tab.click("#pause")
        time.sleep(0.3)
    browser.contexts[0].pages[0].close()
    time.sleep(0.3)

    page = page_at.partition("?")[0]
    port = page.rstrip("/").rpartition(":")[2]
    second = start_program("-m", "warp_plate", "explore", "panel.toml", "--web", "--port", port, "--device", "cpu")
    out, err = second.communicate(timeout=PATIENCE)
    assert (second.returncode, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"warp-plate: --host 127.0.0.1 --port {port}: cannot be listened on: ")
    with pytest.raises(OSError, match=r"refused|assign"):  # systems other than Linux lack that address
        socket.create_connection(("127.0.0.2", int(port)), PATIENCE)

    with socket.create_server(("127.0.0.1", 0)) as elsewhere:
        tab = browser.new_page()
        with tab.expect_console_message(lambda message: "Content Security Policy" in message.text):
            tab.goto(f"{page}?sessionURL=ws://127.0.0.1:{elsewhere.getsockname()[1]}/ws")
