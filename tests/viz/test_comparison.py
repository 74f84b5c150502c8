"""What plates in motion are drawn like, as data: heights, colours and their limits, outlines, texts; then the pages."""

import base64
import json
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from warp_plate import viz
from warp_plate.result.motion import Motion
from warp_plate.scene.model import Edges
from warp_plate.scene.target import NamedTarget
from warp_plate.viz import page
from warp_plate.viz.availability import off_screen
from warp_plate.viz.comparison import Comparison, common_scale, drive_words, heading, layout, ordered, rows_and_columns
from warp_plate.viz.edges import SIDES, kinds_of
from warp_plate.viz.page import PEAK, STILL, page_data, write_page
from warp_plate.viz.pictures import Look, largest_frame, make_plotter, stage
from warp_plate.viz.quantity import QUANTITIES, scale_over
from warp_plate.viz.surface import FIELD, plate_meshes

pyvista = pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

FRAMES = 8


def motion_of(name, size, frames=FRAMES, mode=False):
    """A standing wave of this size [m] on 9 × 11 nodes with a lag of 0 on one side and of 180° on the other."""
    x, y = np.meshgrid(np.linspace(0, 2 * np.pi, 11), np.linspace(0, np.pi, 9))
    shape = size * np.sin(x) * np.sin(y)
    turn = 2 * math.pi * np.arange(frames)[:, None, None] / frames
    times = 0.09 + np.arange(frames) / frames / 200
    field, speed = np.cos(turn) * shape, -400 * math.pi * np.sin(turn) * shape
    share = None if mode else 0.25
    return Motion(name, 200.0, (0.09, 0.095), times, field, speed, np.full((9, 11), 0.5), share)


@pytest.fixture
def drawing():
    """Skips the test where nothing can be drawn off screen."""
    if (problem := viz.missing()) is not None:
        pytest.skip(problem)
    with off_screen():
        yield


@pytest.fixture
def compare(scene, drawing):
    """A comparison of motions in a plotter that is closed at the end, and the plotter."""
    plotters = []

    def make(motions, quantity="displacement"):
        plotters.append(make_plotter((600, 200), off_screen=True, **layout(len(motions), 200, 8)))
        return Comparison(plotters[-1], scene(), motions, quantity, 8), plotters[-1]

    yield make
    for plotter in plotters:
        plotter.close()


# Quantities and scales --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(QUANTITIES))
def test_colours_hold_for_all_plates_and_times(scene, name):
    motions = [motion_of("equal", 1e-7), motion_of("best", 3e-7)]
    quantity = QUANTITIES[name]
    scale = common_scale(scene(), motions, quantity)
    low, high = scale.limits
    if quantity.kind == "cyclic":
        assert (low, high, scale.unit) == (-180.0, 180.0, "°")
        return
    values = np.concatenate([quantity.values(motion) for motion in motions])
    largest = np.nanmax(np.abs(values)) * scale.per_base
    assert low == (-high if quantity.kind == "signed" else 0)
    assert largest <= high < 1.1 * largest
    assert scale.unit.endswith(quantity.unit)
    assert 0.1 <= high < 1000


def test_units_of_energies_and_speeds():
    energy, speed = QUANTITIES["energy"], QUANTITIES["rms-velocity"]
    field = [np.array([1e-7])]
    assert scale_over(field, (1, 1), energy, [np.array([4.2e-11])]).unit == "pJ/m²"
    assert scale_over(field, (1, 1), energy, [np.array([4.2e-8])]).title == "kinetic energy\ndensity\n[nJ/m²]"
    assert scale_over(field, (1, 1), speed, [np.array([3.9e-4])]).limits == (0.0, pytest.approx(390))
    assert scale_over(field, (1, 1), speed, [np.array([5.0])]).unit == "m/s"


def test_the_picture_shows_the_moment_of_most():
    motion = motion_of("best", 1e-7)
    assert largest_frame([motion]) == 0
    assert largest_frame([motion], "velocity") == 2
    assert largest_frame([motion], "energy") == 2
    assert largest_frame([motion], "rms-velocity") == 0


def test_drives_for_several_targets_are_named_after_these(scene):
    one = scene()
    several = one.model_copy(
        update={"targets": tuple(NamedTarget(name=name, area=(0, 0.1, 0, 0.1)) for name in ("a", "b"))}
    )
    names = ("equal", "best", "best b", "mine")
    assert [drive_words(name, several) for name in names] == [
        "equal drive",
        "best drive for a",
        "best drive for b",
        "mine",
    ]
    assert drive_words("best", one) == "best drive found"
    assert heading(motion_of("best b", 1e-7), 0, several).startswith("best drive for b, t = ")


def test_plates_come_in_the_papers_order_and_in_rows():
    targets = [SimpleNamespace(name=name) for name in "cab"]
    for names, several, order in (
        (("best", "equal", "mine", "single"), [], ["equal", "single", "best", "mine"]),
        (("best", "best a", "best b", "equal", "mine"), targets, ["equal", "best", "best a", "best b", "mine"]),
    ):
        result = SimpleNamespace(cases=dict.fromkeys(names), scene=SimpleNamespace(targets=several))
        assert list(ordered(result)) == order
    assert [rows_and_columns(count) for count in (1, 3, 4, 7)] == [(1, 1), (1, 3), (2, 3), (3, 3)]


# Sides ------------------------------------------------------------------------------------------------------


def test_sides_are_drawn_by_what_holds_them(scene):
    held = ("clamped", "free", {"translation": 1e6, "rotation": 1.0}, "supported")
    made = scene(edges=held)
    assert kinds_of(made) == {"clamped": ["left"], "supported": ["top"], "springs": ["right"], "free": ["bottom"]}
    field = np.zeros((9, 11))
    sides = plate_meshes(made, field, scale_over([field], made.plate.size)).sides
    for kind, fixed in {"clamped": 0, "supported": 1, "springs": 0, "free": 1}.items():
        points = sides[kind].mesh.points
        at = 0.0 if kind in ("clamped", "free") else 0.2
        np.testing.assert_allclose(points[:, fixed], at, atol=1e-7)
        along = points[:, 1 - fixed]
        assert (along.min(), along.max()) == (pytest.approx(0, abs=1e-7), pytest.approx(0.2, abs=1e-6))
        # Dashes are several lines with gaps between them, and end where the side does.
        drawn = sum(np.ptp(along[cell.point_ids]) for cell in sides[kind].mesh.cell)
        share = 1.0 if SIDES[kind].dashes is None else SIDES[kind].dashes[0] / sum(SIDES[kind].dashes)
        assert drawn / 0.2 == pytest.approx(share, abs=0.03)
    assert len({(look.colour, look.width, look.dashes) for look in SIDES.values()}) == len(SIDES)


def test_one_line_runs_round_a_plate_held_alike(scene):
    assert kinds_of(scene(edges=("supported",) * 4)) == {"supported": list(Edges.model_fields)}


# Plates in a plotter ----------------------------------------------------------------------------------------


def test_plates_move_in_place(compare):
    motions = [motion_of("equal", 1e-7), motion_of("best", 3e-7)]
    comparison, _ = compare(motions)
    surfaces = [plate.meshes.surface for plate in comparison.plates]
    for frame in (0, 3, FRAMES + 1):
        comparison.show(frame)
        for motion, plate, surface in zip(motions, comparison.plates, surfaces, strict=True):
            field = motion.displacement[frame % FRAMES].ravel()
            assert plate.meshes.surface is surface
            heights = comparison.scale.factor * field
            np.testing.assert_allclose(surface.points[:, 2], heights, atol=1e-8)
            np.testing.assert_allclose(surface.point_data[FIELD], 1e9 * field, rtol=1e-6, atol=1e-6)
            for outline in plate.meshes.outlines:
                expected = (heights[outline.nodes] * outline.shares).sum(axis=1)
                np.testing.assert_allclose(outline.mesh.points[:, 2], expected, atol=1e-8)
    assert np.ptp([plate.actor.mapper.scalar_range for plate in comparison.plates], axis=0).tolist() == [0, 0]


def test_every_outline_is_in_the_picture_above_the_surface(compare):
    comparison, plotter = compare([motion_of("best", 3e-7)])
    actors = [actor for actor in plotter.renderers[0].actors.values() if isinstance(actor, pyvista.Actor)]
    drawn = {id(actor.mapper.dataset): actor for actor in actors}
    meshes = comparison.plates[0].meshes
    for outline in meshes.outlines:
        actor = drawn[id(outline.mesh)]
        assert not actor.prop.lighting
        assert actor.mapper.resolve == "polygon_offset"
    colours = [drawn[id(outline.mesh)].prop.color.hex_rgb for outline in (meshes.target, meshes.actuators)]
    assert colours == ["#1b7837", "#1a1a1a"]


def test_texts_follow_the_frame(compare):
    comparison, _ = compare([motion_of("best", 3e-7)])
    comparison.show(3)
    text = comparison.plates[0].heading.GetInput()
    assert "best drive found, t = 0.0919 s" in text
    assert "localization factor 25.00 %" in text
    assert f"heights × {comparison.scale.factor:.15g}" in text
    comparison.exaggerate(12345.0)
    assert comparison.plates[0].heading.GetInput().endswith("heights × 12300")
    largest = np.abs(comparison.plates[0].meshes.surface.points[:, 2]).max()
    assert largest == pytest.approx(12300 * np.abs(comparison.motions[0].displacement[3]).max(), rel=1e-5)


@pytest.mark.parametrize("name", [name for name in QUANTITIES if name != "displacement"])
def test_another_quantity_takes_colours_and_bar_but_not_heights(compare, name):
    motions = [motion_of("equal", 1e-7), motion_of("best", 3e-7)]
    comparison, plotter = compare(motions)
    comparison.show(2)
    before = comparison.plates[0].meshes.surface.points[:, 2].copy()
    comparison.colour_by(name)
    plate, quantity = comparison.plates[0], QUANTITIES[name]
    np.testing.assert_array_equal(plate.meshes.surface.points[:, 2], before)
    fields = quantity.values(motions[0])
    expected = fields[2 % len(fields)].ravel() * comparison.scale.per_base
    np.testing.assert_allclose(plate.meshes.surface.point_data[FIELD], expected)
    assert plate.actor.mapper.scalar_range == pytest.approx(comparison.scale.limits)
    assert bool(plate.actor.mapper.interpolate_before_map) is (quantity.kind != "cyclic")
    assert not plate.actor.prop.lighting
    props = plotter.renderers[2].GetViewProps()
    drawn = map(props.GetItemAsObject, range(props.GetNumberOfItems()))
    bars = [prop for prop in drawn if prop.IsA("vtkScalarBarActor")]
    assert [bar.GetTitle() for bar in bars] == [comparison.scale.title]
    assert bars[0].GetLookupTable().GetTableRange() == pytest.approx(comparison.scale.limits)


def test_ends_of_a_circle_of_phases_look_alike(compare):
    """Between 179° and −179° no other colour shows."""
    motion = motion_of("best", 3e-7)
    comparison, _ = compare([motion], "phase")
    table = comparison.plates[0].actor.mapper.lookup_table
    first, last, middle = (np.array(table.map_value(angle)) for angle in (-180.0, 180.0, 0.0))
    assert np.abs(first - last).max() < 0.02
    assert np.abs(first - middle)[:3].max() > 0.5
    assert table.map_value(math.nan)[:3] == pytest.approx(pyvista.Color("#c8c8c8").float_rgb)


def test_modes_have_no_unit_and_no_height_factor(compare):
    comparison, _ = compare([motion_of("mode 1, 20 Hz", 1.0, mode=True)], "energy")
    assert comparison.scale.limits == (-1.0, 1.0)
    assert comparison.scale.title == "displacement\nover its largest"
    assert comparison.plates[0].heading.GetInput() == "mode 1, 20 Hz"


def test_a_picture_is_not_blank_and_frames_differ(scene, drawing):
    look = Look("displacement", width=240)
    with stage(scene(), [motion_of("equal", 1e-7), motion_of("best", 3e-7)], look) as (comparison, picture):
        first = np.asarray(picture()).astype(int)
        comparison.show(FRAMES // 2)
        second = np.asarray(picture()).astype(int)
    assert first.shape[1] == 2 * 240 + layout(2, 240, look.font_size)["col_weights"][-1]
    # Crests become troughs: red turns blue.
    best = np.s_[30:, 240:480]
    red, blue = first[..., 0] - first[..., 2], second[..., 0] - second[..., 2]
    assert (red[best] > 80).sum() > 200
    assert (blue[best] < -80).sum() > 200
    assert (first[:2] > 250).all()


# Pages ------------------------------------------------------------------------------------------------------


def decoded(text, kind):
    return np.frombuffer(base64.b64decode(text), kind)


def test_a_page_holds_the_frames_and_what_they_are_drawn_with(scene):
    made = scene()
    motions = [motion_of("equal", 1e-7), motion_of("best", 3e-7)]
    data = page_data(made, motions, "velocity", 25.0, None)
    scale = common_scale(made, motions, QUANTITIES["velocity"])
    assert (data["grid"], data["frames"], data["rate"]) == ([11, 9], FRAMES, 25.0)
    assert data["factor"] == scale.factor
    assert data["limits"] == [-1.0, 1.0]
    assert data["title"] == "velocity\n[µm/s]"
    for motion, plate in zip(motions, data["plates"], strict=True):
        heights = decoded(plate["heights"], "<i2").reshape(FRAMES, 9, 11) / PEAK * data["peak"]
        np.testing.assert_allclose(heights, motion.displacement, atol=data["peak"] / PEAK)
        colours = decoded(plate["colours"], "<i2").reshape(FRAMES, 9, 11) / PEAK * scale.limit
        np.testing.assert_allclose(colours, motion.velocity, atol=scale.limit / PEAK)
        assert "t = 0.0900 s" in plate["headings"][0]
    meshes = plate_meshes(made, motions[0].displacement[0], scale)
    triangles = decoded(data["triangles"], "<u4").reshape(-1, 3)
    np.testing.assert_array_equal(triangles, meshes.surface.faces.reshape(-1, 4)[:, 1:])
    outlines = [decoded(outline["shares"], "<f4").reshape(-1, 3) for outline in data["outlines"]]
    np.testing.assert_allclose(np.concatenate(outlines).sum(axis=1), 1, rtol=1e-6)
    # The actuators' pieces go once round each.
    last = data["outlines"][-1]
    ends = decoded(last["points"], "<f4").reshape(-1, 2)[decoded(last["pieces"], "<i4").reshape(-1, 2)]
    around = sum(2 * (x1 - x0 + y1 - y0) for x0, x1, y0, y1 in (actuator.area for actuator in made.actuators))
    assert np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum() == pytest.approx(around, rel=1e-5)


def test_a_page_marks_what_is_no_number(scene):
    data = page_data(scene(), [motion_of("best", 3e-7)], "phase", 25.0, 5.0)
    colours = decoded(data["plates"][0]["colours"], "<i2").reshape(9, 11)
    assert data["colourFrames"] == 1
    assert data["factor"] == 5.0
    assert data["cyclic"] is True
    assert (colours[0] == STILL).all()
    assert sorted(set(np.abs(colours[4, [2, 7]]))) == [0, PEAK]


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "phase"])
def test_pages_of_fine_grids_show_some_of_the_nodes(scene, monkeypatch, quantity):
    """Where the file would be too large, every second node; limits and heights stay those of all nodes."""
    made, motion = scene(), motion_of("best", 3e-7)
    every = page_data(made, [motion], quantity, 25.0, None)
    assert every["thinned"] == ""
    monkeypatch.setattr(page, "MOST_BYTES", 1200.0)
    data = page_data(made, [motion], quantity, 25.0, None)
    nx, ny = data["grid"]
    assert (nx, ny) == (6, 5)
    assert data["thinned"] == "Of 11 × 9 nodes 6 × 5 are shown."
    assert (data["peak"], data["factor"], data["limits"]) == (every["peak"], every["factor"], every["limits"])
    for part in ("heights", "colours"):
        if every["plates"][0][part] is None:
            continue
        fine = decoded(every["plates"][0][part], "<i2").reshape(-1, 9, 11)
        np.testing.assert_array_equal(decoded(data["plates"][0][part], "<i2").reshape(-1, 5, 6), fine[:, ::2, ::2])
    assert decoded(data["triangles"], "<u4").max() == 29


def test_between_nodes_a_page_interpolates():
    """Where steps of three to six nodes do not end at the last one; angles take the nearest node's."""
    assert [page.thinned(nodes, 67_500_000) for nodes in (27, 28, 102, 513, 4)] == [10, 10, 35, 129, 2]
    assert page.thinned(102, 7_500_000) == 102
    field = np.arange(12.0).reshape(1, 3, 4) ** 2
    between = page._at_nodes(field, (3, 3), QUANTITIES["energy"])
    np.testing.assert_allclose(between[0, 0], [0, (1 + 4) / 2, 9])
    field[0, 1, 2] = np.nan
    assert np.isnan(page._at_nodes(field, (2, 4), QUANTITIES["energy"])).sum() == 0
    assert page._at_nodes(field, (3, 3), QUANTITIES["phase"])[0, 0].tolist() in ([0, 1, 9], [0, 4, 9])


def test_a_page_is_one_file_that_asks_for_nothing(scene, tmp_path):
    made = scene(title="</script><b>")
    write_page(made, [motion_of("best", 3e-7)], tmp_path / "page.html", rate=20)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert not re.findall(r"""(?:https?:|//cdn|src=|@import|fetch\(|XMLHttp|import\()""", text)
    assert "default-src 'none'" in text
    assert text.count("</script>") == 2
    (data,) = re.findall(r'<script id="data" type="application/json">(.*)</script>', text)
    assert json.loads(data)["name"] == "</script><b>"
