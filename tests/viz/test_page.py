"""The page of ``render`` as data, and in headless Chromium: it plays, turns, and requests nothing."""

import base64
import io

import numpy as np
import pytest

from support.commands import until
from support.pictures import drag, pixels
from support.results import motion_of
from warp_plate.viz.fields import DEFAULT_COLOURS, ColourOptions, PictureStyle, motion_scales
from warp_plate.viz.page import NAN, PEAK, page_data, shown_nodes, write_page
from warp_plate.viz.scene3d import PlateMeshes

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

FRAMES = 10


def bump(size):
    """A bump that oscillates on 8 × 9 nodes, up at frame 0."""
    x, y = np.meshgrid(np.linspace(0, np.pi, 8), np.linspace(0, np.pi, 9))
    return motion_of("best", size * np.sin(x) * np.sin(y), frames=FRAMES, factor=0.5)


def decoded(text, kind):
    return np.frombuffer(base64.b64decode(text), kind)


def test_frames_meshes_and_scale(scene):
    made, motions = scene(), [bump(1e-7), bump(3e-7)]
    data = page_data(made, motions, PictureStyle("velocity", rate=25.0))
    scale = motion_scales(made, motions, "velocity")[0][0]
    assert (data["grid"], data["frames"], data["rate"]) == ([8, 9], FRAMES, 25.0)
    assert (data["factor"], data["limits"], data["title"]) == (scale.height_factor, [-1.0, 1.0], "velocity\n[µm/s]")
    for motion, plate in zip(motions, data["plates"], strict=True):
        heights = decoded(plate["heights"], "<i2").reshape(FRAMES, 9, 8) / PEAK * data["peak"]
        np.testing.assert_allclose(heights, motion.displacement, atol=data["peak"] / PEAK)
        colours = decoded(plate["colours"], "<i2").reshape(FRAMES, 9, 8) / PEAK * scale.limit
        np.testing.assert_allclose(colours, motion.velocity, atol=scale.limit / PEAK)
        assert "t = 0.0005 s" in plate["headings"][1]
    assert data["names"] == [[actuator.name, actuator.area[0], actuator.area[2]] for actuator in made.actuators]
    meshes = PlateMeshes(made, motions[0].displacement[0], scale)
    triangles = decoded(data["triangles"], "<u4").reshape(-1, 3)
    np.testing.assert_array_equal(triangles, meshes.surface.faces.reshape(-1, 4)[:, 1:])
    weights = [decoded(outline["shares"], "<f4").reshape(-1, 3) for outline in data["outlines"]]
    np.testing.assert_allclose(np.concatenate(weights).sum(axis=1), 1, rtol=1e-6)
    # The segments of the actuators add up to their perimeters.
    last = data["outlines"][-1]
    ends = decoded(last["points"], "<f4").reshape(-1, 2)[decoded(last["pieces"], "<i4").reshape(-1, 2)]
    perimeters = sum(2 * (x1 - x0 + y1 - y0) for x0, x1, y0, y1 in (actuator.area for actuator in made.actuators))
    assert np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum() == pytest.approx(perimeters, rel=1e-5)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "phase"])
def test_fine_grids_are_thinned(scene, quantity):
    """Every second row is shown, and 5 of 8 columns, evenly; limits and heights stay those of all nodes."""
    assert [shown_nodes(nodes, 67_500_000).size for nodes in (28, 102, 513, 4)] == [10, 35, 172, 2]
    assert shown_nodes(102, 7_500_000).tolist() == list(range(102))
    style = PictureStyle(quantity, heights=5.0)
    fine, data = (page_data(scene(), [bump(3e-7)], style, most) for most in (20e6, 1200.0))
    assert (fine["thinned"], data["grid"]) == ("", [5, 5])
    assert data["thinned"] == "5 × 5 of 8 × 9 nodes are shown."
    assert all(data[key] == fine[key] for key in ("peak", "factor", "limits"))
    for part in ("heights", "colours"):
        if fine["plates"][0][part] is not None:
            every, shown = (decoded(made["plates"][0][part], "<i2") for made in (fine, data))
            expected = every.reshape(-1, 9, 8)[:, ::2][..., [0, 2, 4, 5, 7]]
            np.testing.assert_array_equal(shown.reshape(-1, 5, 5), expected)
    assert (data["factor"], decoded(data["triangles"], "<u4").max()) == (5.0, 24)
    if quantity == "phase":  # which nodes at rest lack
        assert (data["colourFrames"], data["cyclic"]) == (1, True)
        np.testing.assert_array_equal(shown.reshape(5, 5), np.pad(np.zeros((3, 3)), 1, constant_values=NAN))


@pytest.fixture
def opened(browser, scene, tmp_path):
    """A function that opens a page, paused at frame 0; at the end there was no error and no request."""
    requests, errors, page = [], [], browser.new_page(viewport={"width": 1100, "height": 600}, offline=True)
    page.on("request", lambda request: requests.append(request.url))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))

    def open_page(quantity="displacement", colours=DEFAULT_COLOURS):
        motions = [bump(1e-7), bump(2e-7)]
        style = PictureStyle(quantity, colours=colours, rate=20)
        write_page(scene(title="</script><b>"), motions, tmp_path / "page.html", style)
        page.goto((tmp_path / "page.html").as_uri())
        holds(page, "player.frame > 0.5")
        page.keyboard.press("Space")
        page.evaluate("go(0)")
        return page

    yield open_page
    page.close()
    assert errors == []
    assert set(requests) == {(tmp_path / "page.html").as_uri()}


def holds(page, condition):
    """Wait for it; Playwright's own way would need a looser security policy than the page has."""
    until(lambda: page.evaluate(condition))


def canvas(page, plate=1):
    """The pixels of a plate's canvas, when all that was asked for is drawn and shown."""
    page.evaluate("new Promise((shown) => requestAnimationFrame(() => requestAnimationFrame(shown)))")
    shown = page.locator("#plates canvas").nth(plate)
    # On a busy machine the first frame can reach the window later than it is drawn: until then all is white.
    until(lambda: pixels(io.BytesIO(shown.screenshot())).min() < 200)
    return pixels(io.BytesIO(shown.screenshot()))


def redness(picture):
    """The number of red pixels less that of blue ones."""
    difference = picture[..., 0] - picture[..., 2]
    return int((difference > 60).sum() - (difference < -60).sum())


def top_of_red(picture):
    """The first row with a red pixel."""
    return np.argwhere(picture[..., 0] - picture[..., 2] > 100)[:, 0].min()


def test_playing_stepping_turning_and_heights(opened):
    page = opened()
    assert (page.title(), "default-src 'none'" in page.content()) == ("</script><b>", True)
    before = canvas(page)
    assert page.inner_text("#play") == "Play"
    assert redness(before) > 1000
    # Half the displacement is halfway to dark red: its red has more green in it.
    greens = [picture[..., 1][picture[..., 0] - picture[..., 2] > 60].min() for picture in (canvas(page, 0), before)]
    assert greens[0] > 80 > 40 > greens[1]
    assert page.locator("#legend .ticks span").all_inner_texts() == ["200", "100", "0", "−100", "−200"]
    assert page.inner_text("#legend .title") == "displacement\n[nm]"
    assert "clamped" in page.inner_text("#key")

    drag(page, "#plates canvas", 80, 30)
    until(lambda: (canvas(page) != before).any(axis=-1).mean() > 0.05)
    turned = canvas(page)
    page.mouse.wheel(0, 600)
    holds(page, "camera.zoom < 0.9")
    # Zoomed out, less of the picture is not white.
    until(lambda: (canvas(page).min(axis=-1) < 240).sum() < 0.8 * (turned.min(axis=-1) < 240).sum())
    page.locator("#plates canvas").last.dblclick()
    until(lambda: (canvas(page) == before).all())

    factor = page.evaluate("factor()")
    page.locator("#heights").fill("1")
    assert page.evaluate("factor()") == pytest.approx(2 * factor, rel=0.01)
    holds(page, "document.getElementById('factor').textContent === `× ${short(factor())}`")
    # The crest covers more of the plate behind it, and rises towards its back corner.
    until(lambda: top_of_red(canvas(page)) < top_of_red(before) - 5)

    page.keyboard.press("ArrowRight")
    holds(page, "player.frame === 1")
    holds(page, "document.querySelectorAll('.heading')[1].textContent.includes('t = 0.0005 s')")
    page.locator("#time").fill("5")
    until(lambda: redness(canvas(page)) < -1000)
    assert "localization factor 50.00 %" in page.locator(".heading").nth(1).inner_text()
    page.click("#play")
    holds(page, "player.frame !== 5 && document.getElementById('play').textContent === 'Pause'")
    page.keyboard.press("Space")
    holds(page, "!player.playing")


def test_phases_are_grey_at_rest(opened):
    page = opened("phase")
    # A lag of 0 is red, in the middle of the colour map; the clamped edge is grey.
    picture = canvas(page)
    assert (picture[..., 0] - picture[..., 1:].max(axis=-1) > 70).mean() > 0.1
    assert page.locator("#legend .ticks span").all_inner_texts() == ["180", "90", "0", "−90", "−180"]


def test_plates_with_limits_of_their_own_look_alike(opened):
    """Half the displacement is as red and as high as the whole; each plate has its own legend."""
    page = opened(colours=ColourOptions("bwr", "each"))
    weak, strong = (canvas(page, number) for number in (0, 2))  # with a bar between them
    assert redness(strong) == pytest.approx(redness(weak), rel=0.02)
    assert page.locator(".row .ticks").nth(0).inner_text().split() == ["100", "50", "0", "−50", "−100"]
    assert page.locator(".row .ticks").nth(1).inner_text().split() == ["200", "100", "0", "−100", "−200"]
    assert not page.locator("#legend .bar").is_visible()
    assert "heights × 1.2·10⁵" in page.locator(".heading").nth(1).inner_text()
