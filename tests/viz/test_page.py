"""The page that ``render`` writes, in headless Chromium: it plays, turns, and asks for nothing but itself."""

import io
import math
import time

import numpy as np
import pytest

from warp_plate.result.motion import Motion
from warp_plate.viz.page import write_page

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

FRAMES = 10


def wave(size):
    """A bump that goes up and down on 9 × 9 nodes, up at frame 0."""
    x, y = np.meshgrid(np.linspace(0, np.pi, 9), np.linspace(0, np.pi, 9))
    turn = 2 * math.pi * np.arange(FRAMES)[:, None, None] / FRAMES
    field = np.cos(turn) * size * np.sin(x) * np.sin(y)
    return Motion("best", 200.0, (0.0, 0.005), np.arange(FRAMES) * 5e-4, field, 0 * field, np.ones((9, 9)), 0.5)


@pytest.fixture
def opened(browser, scene, tmp_path):
    """Opens the page of a quantity, paused at frame 0; at the end no error was seen and nothing was asked for."""
    asked, wrong, pages = [], [], []

    def open_page(quantity="displacement"):
        write_page(scene(), [wave(1e-7), wave(2e-7)], tmp_path / "page.html", quantity, rate=20)
        page = browser.new_page(viewport={"width": 1100, "height": 600}, offline=True)
        pages.append(page)
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto((tmp_path / "page.html").as_uri())
        until(page, "player.frame > 0.5")
        page.keyboard.press("Space")
        page.evaluate("go(0)")
        return page

    yield open_page
    for page in pages:
        page.close()
    assert wrong == []
    assert set(asked) == {(tmp_path / "page.html").as_uri()}


def until(page, condition):
    """Wait; Playwright's own way would need a looser security policy than the page has."""
    end = time.monotonic() + 30
    while not page.evaluate(condition):
        assert time.monotonic() < end, condition
        page.wait_for_timeout(20)


def pixels(page, plate=1):
    """What stands on a plate's canvas."""
    from matplotlib.image import imread

    until(page, "!player.asked")
    picture = page.locator("#plates canvas").nth(plate).screenshot()
    return np.round(imread(io.BytesIO(picture))[..., :3] * 255).astype(int)


def redder(picture):
    """How many pixels are clearly red, less those that are clearly blue."""
    difference = picture[..., 0] - picture[..., 2]
    return int((difference > 60).sum() - (difference < -60).sum())


def test_the_page_plays_and_pauses(opened):
    page = opened()
    assert page.inner_text("#play") == "Play"
    still = page.evaluate("player.frame")
    page.click("#play")
    until(page, f"player.frame !== {still}")
    assert page.inner_text("#play") == "Pause"
    page.keyboard.press("Space")
    until(page, "!player.playing")


def test_frames_and_texts_follow_the_keys_and_the_slider(opened):
    page = opened()
    up = pixels(page)
    assert redder(up) > 1000
    page.keyboard.press("ArrowRight")
    assert page.evaluate("player.frame") == 1
    until(page, "document.querySelectorAll('.heading')[1].textContent.includes('t = 0.0005 s')")
    page.locator("#time").fill("5")
    assert redder(pixels(page)) < -1000
    assert "localization factor 50.00 %" in page.locator(".heading").nth(1).inner_text()


def test_limits_are_common_to_the_plates(opened):
    page = opened()
    small, large = (pixels(page, plate) for plate in (0, 1))
    # Half as high, half way to dark red: what is red has more green in it.
    greens = [picture[..., 1][picture[..., 0] - picture[..., 2] > 60].min() for picture in (small, large)]
    assert greens[0] > 80 > 40 > greens[1]
    assert page.locator("#ticks span").all_inner_texts() == ["200", "100", "0", "−100", "−200"]
    assert page.inner_text("#title") == "displacement\n[nm]"
    assert "clamped" in page.inner_text("#key")


def test_dragging_turns_and_the_wheel_zooms(opened):
    page = opened()
    before = pixels(page)
    box = page.locator("#plates canvas").nth(1).bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 80, middle[1] + 30, steps=3)
    page.mouse.up()
    turned = pixels(page)
    assert (turned != before).any(axis=-1).mean() > 0.05
    page.mouse.wheel(0, 600)
    until(page, "camera.zoom < 0.9")
    # Farther away, less of the picture is not white.
    assert (pixels(page).min(axis=-1) < 240).sum() < 0.8 * (turned.min(axis=-1) < 240).sum()
    page.mouse.dblclick(*middle)
    until(page, "camera.zoom === 1")
    assert (pixels(page) == before).all()


def test_heights_grow_with_their_slider(opened):
    page = opened()
    before = pixels(page)
    factor = page.evaluate("factor()")
    page.locator("#heights").fill("1")
    assert page.evaluate("factor()") == pytest.approx(2 * factor, rel=0.01)
    until(page, "document.getElementById('factor').textContent === `× ${factor()}`")
    # The crest covers more of the plate behind it, and rises towards its back corner.
    red = [np.argwhere(picture[..., 0] - picture[..., 2] > 100)[:, 0].min() for picture in (before, pixels(page))]
    assert red[1] < red[0] - 5


def test_phases_are_shown_without_what_does_not_move(opened):
    page = opened("phase")
    picture = pixels(page)
    # Lag 0 all over, dark in the middle of the colour map; the held edge is grey.
    assert (picture.max(axis=-1) < 70).mean() > 0.1
    assert page.locator("#ticks span").all_inner_texts() == ["180", "90", "0", "−90", "−180"]
