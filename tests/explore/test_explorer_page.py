"""The explorer's page as a user meets it: the command in a process of its own, and headless Chromium in front of it."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from warp_plate import viz
from warp_plate.scene.dump import dump_scene
from warp_plate.viz.explorer_page import missing_page

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send to one process"),
]

ROOT = Path(__file__).parents[2]
# Shared machines are slow at times; nothing here waits so long where all is well.
PATIENCE = 60.0
# The command, with a secret that begins as one in 64 does.
COMMAND = """
import secrets, sys
made = secrets.token_urlsafe
secrets.token_urlsafe = lambda: "-" + made()
from warp_plate.cli.main import main
main(sys.argv[1:])
"""


@pytest.fixture
def served(tmp_path, scene):
    """The address at which ``explore --web`` serves a small scene; ends it with Ctrl-C and looks how it went."""
    if (problem := missing_page() or viz.missing()) is not None:
        pytest.skip(problem)
    made = scene(
        damping=120.0,
        window=(0.08, 0.1),
        title="Panel {{ 1 + 1 }} <b>",
        search={"particles": 6, "iterations": 12},
    )
    (tmp_path / "panel.toml").write_text(dump_scene(made), encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND, "explore", "panel.toml", "--web", "--port", "0", "--device", "cpu"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    line = process.stdout.readline()
    address = re.search(r"http://127\.0\.0\.1:\d+/", line)
    try:
        if address:
            yield address.group()
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert address, f"said {line + out!r} and {err!r}, and ended with {process.returncode}"
    assert (process.returncode, out, err) == (0, "", "ended\n")


@pytest.fixture
def page(browser, served):
    """The page, loaded; afterwards no error was seen, and nothing was asked of any other host."""
    made = browser.new_page(viewport={"width": 1300, "height": 900})
    asked, wrong = [], []
    made.on("request", lambda request: asked.append(request.url))
    made.on("websocket", lambda opened: asked.append(opened.url))
    made.on("console", lambda message: wrong.append(message.text) if message.type in ("error", "warning") else None)
    made.on("pageerror", lambda error: wrong.append(str(error)))
    made.set_default_timeout(1000 * PATIENCE)
    made.goto(served)
    made.wait_for_selector("#stage img")
    yield made
    made.close()
    assert not wrong
    host = served.split("/")[2]
    assert len(asked) > 5
    assert not [url for url in asked if not re.match(rf"(http|ws)://{re.escape(host)}/|data:|blob:", url)]


def drag(page, key, pixels):
    """Drag the knob of a slider by so many pixels, as a hand does."""
    box = page.locator(f"#slide-{key} .v-slider-thumb").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 6):
        page.mouse.move(x + pixels * step / 5, y)
        time.sleep(0.02)
    page.mouse.up()


def number(page, selector):
    """The number at the head of an element's text."""
    return float(page.inner_text(selector).split()[0])


def wait(holds):
    """Until it holds."""
    until = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.05)


def test_sliders_and_buttons_change_picture_and_numbers(page):
    """Everything of the page once, for starting it takes seconds."""
    bound = number(page, "#bound")
    assert 0 < number(page, "#factor") < bound
    assert "Panel {{ 1 + 1 }} <b>" in page.inner_text("body")

    # The plate moves; paused, it rests.
    stage = page.locator("#stage")
    before = stage.screenshot()
    wait(lambda: stage.screenshot() != before)
    page.click("#pause")
    page.wait_for_function("document.querySelector('#pause').innerText == 'play'")
    wait(lambda: stage.screenshot() == stage.screenshot())
    resting = stage.screenshot()

    # The hand turns it, paused as it is.
    box = stage.bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 250)
    page.mouse.down()
    page.mouse.move(box["x"] + 360, box["y"] + 230, steps=5)
    page.mouse.up()
    wait(lambda: stage.screenshot() != resting)
    wait(lambda: stage.screenshot() == stage.screenshot())
    resting = stage.screenshot()

    # A drive slider: the picture and the factor, not the bound.
    factor = number(page, "#factor")
    drag(page, "magnitude_1", -50)
    wait(lambda: number(page, "#factor") != factor)
    assert number(page, "#value-magnitude_1") < 1
    wait(lambda: stage.screenshot() != resting)
    drag(page, "phase_2", 60)
    wait(lambda: 0.5 < number(page, "#value-phase_2") < 6)
    assert number(page, "#bound") == bound

    # Frequency and damping: the bound as well.
    drag(page, "frequency", -30)
    wait(lambda: number(page, "#bound") != bound)
    assert number(page, "#value-frequency") < 290
    bound = number(page, "#bound")
    drag(page, "damping", 40)
    wait(lambda: number(page, "#bound") != bound)

    # The exact best reaches the bound, and the sliders follow.
    page.click("#choose-exact")
    wait(lambda: page.inner_text("#factor") == page.inner_text("#bound"))
    shares = [number(page, f"#{name}") for name in ("lower_left", "lower_right", "upper_left", "upper_right")]
    assert sum(shares) == pytest.approx(100, abs=0.3)
    page.click("#choose-equal")
    page.wait_for_function("document.querySelector('#value-magnitude_1').innerText == '1.000'")

    # The swarm is watched, and what it finds stays below the bound.
    resting = stage.screenshot()
    page.click("#choose-found")
    wait(lambda: stage.screenshot() != resting)
    wait(lambda: number(page, "#factor") > 0.5 * number(page, "#bound"))
    assert number(page, "#factor") <= number(page, "#bound")


def test_the_stage_fits_the_browser_window(page):
    """A smaller window gets a smaller picture, not a cropped one."""
    page.set_viewport_size({"width": 900, "height": 600})
    wait(lambda: page.evaluate("document.querySelector('#stage img').naturalWidth") == 900 - 390)


def test_a_browser_that_goes_away_is_no_error(browser, served):
    """And one that is still there when Ctrl-C comes does not hold it up: see the fixture."""
    for _ in range(2):
        tab = browser.new_page()
        tab.goto(served)
        # The second finds it paused, and is sent a picture all the same.
        tab.wait_for_selector("#stage img", timeout=1000 * PATIENCE)
        tab.wait_for_function("document.querySelector('#stage img').naturalWidth > 300", timeout=1000 * PATIENCE)
        tab.click("#pause")
        time.sleep(0.3)
    browser.contexts[0].pages[0].close()
    time.sleep(0.3)


def test_a_port_that_is_taken(served, tmp_path):
    port = served.rstrip("/").rpartition(":")[2]
    second = subprocess.run(
        [sys.executable, "-m", "warp_plate", "explore", "panel.toml", "--web", "--port", port, "--device", "cpu"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert (second.returncode, second.stdout) == (2, "")
    assert second.stderr.startswith(f"warp-plate: --host 127.0.0.1 --port {port}: cannot be listened on: ")
    assert second.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no second address of their own by default")
def test_nobody_else_can_reach_it(served):
    """Listening on all addresses, it would answer on this one too."""
    port = int(served.rstrip("/").rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), PATIENCE):
        pass
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), PATIENCE)


def test_no_other_site_is_let_in(browser, served):
    """The address and secret of the connection are told to this page only: not under another name, nor across sites."""
    import urllib.error
    import urllib.request

    def ask(host):
        request = urllib.request.Request(served + "paraview/", data=b"{}", headers={"Host": host})
        with urllib.request.urlopen(request, timeout=PATIENCE) as answer:
            return answer.status, dict(answer.headers)

    status, headers = ask(served.split("/")[2])
    assert status == 200
    assert "Access-Control-Allow-Origin" not in headers
    with pytest.raises(urllib.error.HTTPError, match="403"):
        ask("elsewhere.example:80")
