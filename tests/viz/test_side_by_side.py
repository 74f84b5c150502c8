"""Scales and meshes of plates; plates in motion in a plotter: heights, colours, texts."""

import itertools
import math
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from support.results import motion_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.target import NamedTarget
from warp_plate.viz.annotations import (
    axis_labels,
    caption,
    case_label,
    frame_caption,
    ordered_cases,
    point_text,
    size_text,
)
from warp_plate.viz.fields import FIELDS, ColourOptions, DrawingScale, drawing_scale, motion_scales, short_number
from warp_plate.viz.pictures import largest_frame, make_plotter
from warp_plate.viz.scene3d import SCALARS, PlateMeshes, SideBySide, plate_subplots, rows_and_columns

pyvista = pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")
pytest.importorskip("pytest_pyvista", reason="pytest-pyvista is not installed: pip install 'warp-plate[test]'")

FRAMES = 8
# Regression images: width of a plate, height of the picture, and font size [pixels]. After an intended change:
# pytest tests/viz/test_side_by_side.py -n 0 --reset_image_cache, and look at tests/pictures.
WIDTH, HEIGHT, FONT_SIZE = 200, 180, 8
# Error of pytest-pyvista: below 1 for the same picture on the same machine, about 130 without actuators, 400 with
# another colour map, 700 without texts.
TOLERANCE = 120.0


def standing_wave(name, size):
    """Motion of this amplitude [m] on 9 × 11 nodes with a phase lag of 0 on one half and of 180° on the other."""
    x, y = np.meshgrid(np.linspace(0, 2 * np.pi, 11), np.linspace(0, np.pi, 9))
    return motion_of(name, size * np.sin(x) * np.sin(y), start=0.09)


def travelling_wave(name, size, factor=0.3):
    """A wave along x on 21 × 21 nodes."""
    x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    return motion_of(name, size * 16 * x * (1 - x) * y * (1 - y), lag=3 * np.pi * x, factor=factor)


PAIR = [standing_wave("equal", 1e-7), standing_wave("best", 3e-7)]
WAVES = [travelling_wave("single", 1e-7), travelling_wave("best", 2e-7)]
EDGES = ("clamped", "free", {"translation": 1e6, "rotation": 1.0}, "supported")
CLAMPED = ("clamped",) * 4
PAPER = Scene.load("paper")


def meshes_of(field, scene=PAPER):
    return PlateMeshes(scene, field, drawing_scale([field], scene.plate.size))


def segments(mesh):
    """(segments, 2, 3) ends of the pieces of lines."""
    return mesh.points[mesh.lines.reshape(-1, 3)[:, 1:]].astype(float)


@pytest.mark.parametrize(
    ("name", "largest", "unit", "low", "high"),
    [
        ("displacement", 2.31e-13, "nm", -0.00024, 0.00024),
        ("displacement", -5e-3, "mm", -6, 6),
        ("displacement", 2e3, "m", -2000, 2000),
        ("energy", 4.2e-11, "pJ/m²", 0, 48),
        ("rms-velocity", 3.9e-4, "µm/s", 0, 400),
        ("level", 7.0, "dB", -40, 0),
        ("phase", 1.0, "°", -180, 180),
    ],
)
def test_scales_have_round_limits_in_a_suitable_unit(name, largest, unit, low, high):
    values = [np.array([[0.0, largest / 50]]), np.array([[0.0, largest]])]
    scale = drawing_scale([1e-7 * array / abs(largest) for array in values], (0.2, 0.3), FIELDS[name], values)
    assert scale.unit == unit
    assert scale.clim == pytest.approx((low, high))
    # Heights are drawn up to 12 % of the shorter side.
    assert 0.1 * 0.2 < scale.height_factor * 1e-7 <= 0.12 * 0.2 * 1.05


def test_plates_at_rest_and_plates_that_are_not_finite_can_be_drawn():
    assert drawing_scale([np.zeros((5, 5))], (0.2, 0.2)) == DrawingScale(1e-6, 1.0, "µm", 1e6)
    field = np.full((27, 27), 1.9e-7)
    field[3, 4], field[5, 6] = np.inf, np.nan
    assert drawing_scale([field], (0.2, 0.2)).limit == pytest.approx(2e-7)
    heights = meshes_of(field).surface.points[:, 2].reshape(27, 27)
    assert np.isfinite(heights).all()
    assert heights[3, 4] == heights[5, 6] == 0


def test_polylines_lie_on_the_warped_surface(random):
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    meshes = meshes_of(random.normal(size=(11, 14)) * 1e-7)
    points = meshes.surface.points.astype(float)
    triangles = Triangulation(points[:, 0], points[:, 1], meshes.surface.faces.reshape(-1, 4)[:, 1:])
    height = LinearTriInterpolator(triangles, points[:, 2])
    assert np.abs(points[:, 2]).max() > 0.01
    assert meshes.surface.n_cells == 2 * 10 * 13
    for lines in meshes.lines.values():
        on_line = np.concatenate([np.linspace(*ends, 7)[1:-1] for ends in segments(lines.mesh)])
        # Rounding may put points on the edge outside of all triangles.
        inside = np.clip(on_line[:, :2], 1e-7, 0.2 - 1e-7)
        np.testing.assert_allclose(on_line[:, 2], height(*inside.T).filled(np.nan), atol=2e-6)


def test_lines_follow_target_actuators_and_edges(scene):
    mixed = scene(edges=EDGES)
    drawn = meshes_of(np.zeros((9, 11)), mixed).lines
    places = {"clamped": (0, 0), "supported": (1, 0.2), "springs": (0, 0.2), "free": (1, 0)}
    for kind, (axis, position) in places.items():
        points = drawn[kind].mesh.points
        np.testing.assert_allclose(points[:, axis], position, atol=1e-7)
        assert np.ptp(points[:, 1 - axis]) == pytest.approx(0.2)
    for name, areas in (("target", [mixed.target.area]), ("actuators", [part.area for part in mixed.actuators])):
        length = np.hypot(*np.diff(segments(drawn[name].mesh), axis=1)[:, 0, :2].T).sum()
        assert length == pytest.approx(sum(2 * (x1 - x0 + y1 - y0) for x0, x1, y0, y1 in areas), rel=1e-5)
        for corner in itertools.chain(*(itertools.product(area[:2], area[2:]) for area in areas)):
            assert np.hypot(*(drawn[name].mesh.points[:, :2] - corner).T).min() < 1e-7


@pytest.fixture
def plates(scene, drawing):
    """PAIR in a plotter."""
    with closing(make_plotter((600, 200), off_screen=True, **plate_subplots(2, 200, 8))) as plotter:
        yield SideBySide(plotter, scene(), PAIR, "displacement", 8)


def test_the_default_picture_is_at_the_largest_value():
    frames = {name: largest_frame(PAIR, name) for name in ("displacement", "velocity", "energy", "rms-velocity")}
    assert frames == {"displacement": 0, "velocity": 2, "energy": 2, "rms-velocity": 0}


def test_cases_are_labelled_and_ordered(scene):
    single = scene()
    several = single.model_copy(
        update={"targets": tuple(NamedTarget(name=name, area=(0, 0.1, 0, 0.1)) for name in ("a", "b"))}
    )
    labels = [case_label(name, several) for name in ("equal", "best", "best b", "mine")]
    assert labels == ["equal drive", "best drive for a", "best drive for b", "mine"]
    alone = replace(standing_wave("single", 1e-7), only_actuator="near the lower left corner")
    assert frame_caption(alone, 0, single).startswith("single actuator, near the lower left c…, t = ")
    cases = dict.fromkeys(("best", "best b", "equal", "mine", "single"))
    assert " ".join(ordered_cases(SimpleNamespace(cases=cases, scene=several))) == "equal single best best b mine"
    assert "not defined" in caption("given drive", 0.0464, math.nan)
    tuned, wave = scene(search={"frequency": {"range": (100.0, 400.0)}}), standing_wave("best", 1e-7)
    assert frame_caption(wave, 0, tuned).endswith(f" % at {wave.frequency:.4g} Hz")
    assert "Hz" not in frame_caption(wave, 0, single)
    assert [rows_and_columns(count) for count in (1, 3, 4, 7)] == [(1, 1), (1, 3), (2, 3), (3, 3)]


def test_plates_move_in_place_with_captions_and_heights(plates):
    surfaces = [plate.meshes.surface for plate in plates.plates]
    for frame in (0, 3, FRAMES + 1):
        plates.show(frame)
        for motion, plate, surface in zip(PAIR, plates.plates, surfaces, strict=True):
            field = motion.displacement[frame % FRAMES].ravel()
            assert plate.meshes.surface is surface
            np.testing.assert_allclose(surface.points[:, 2], plates.scales[0].height_factor * field, atol=1e-8)
            np.testing.assert_allclose(surface.point_data[SCALARS], 1e9 * field, rtol=1e-6, atol=1e-6)
    plates.show(3)
    plate = plates.plates[1]
    assert plates.scales[0].height_factor == 84000
    heights = "heights × 8.4·10⁴"
    assert plate.caption.GetInput() == f"best drive found, t = 0.0919 s\nlocalization factor 25.00 %, {heights}"
    plates.exaggerate(12345.0)
    assert plate.caption.GetInput().endswith("heights × 1.23·10⁴")
    largest = np.abs(plate.meshes.surface.points[:, 2]).max()
    assert largest == pytest.approx(12300 * np.abs(plates.motions[1].displacement[3]).max(), rel=1e-5)


def test_plates_may_have_limits_of_their_own(scene, drawing):
    """Each has a legend and heights of its own; a given limit holds for the first field only."""
    columns = plate_subplots(2, 200, 8, separate=True)
    with closing(make_plotter((sum(columns["col_weights"]), 200), off_screen=True, **columns)) as plotter:
        plates = SideBySide(plotter, scene(), PAIR, "displacement", 8, ColourOptions("PuOr", "each"))
        assert [scale.clim[1] for scale in plates.scales] == [100, 320]
        ratio = plates.scales[0].height_factor / plates.scales[1].height_factor
        plates.exaggerate(2 * plates.scales[0].height_factor)
        assert plates.scales[0].height_factor / plates.scales[1].height_factor == pytest.approx(ratio, rel=1e-2)
        for plate, scale in zip(plates.plates, plates.scales, strict=True):
            assert plate.surface.mapper.scalar_range == pytest.approx(scale.clim)
            assert plate.surface.mapper.lookup_table.map_value(-1e9)[0] == pytest.approx(0x7F / 255, abs=0.01)
    with closing(make_plotter((600, 200), off_screen=True, **plate_subplots(2, 200, 8))) as plotter:
        plates = SideBySide(plotter, scene(), PAIR, "displacement", 8, ColourOptions(limits=5e-8))
        assert [scale.clim for scale in plates.scales] == [pytest.approx((-50, 50))] * 2
        plates.colour_by("phase")
        assert plates.scales[0].clim == pytest.approx((-180, 180))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"colormap": "viridi"}, "colormap = 'viridi': must be a colour map of Matplotlib, such as viridis"),
        ({"limits": "own"}, "limits = 'own': must be common, each, or a number above 0"),
        ({"limits": -1.0}, "limits = -1: must be"),
        ({"limits": math.nan}, "limits = nan: must be"),
    ],
)
def test_colours_that_there_are_not_are_named(options, words):
    with pytest.raises(SceneError, match=words):
        ColourOptions(**options)
    with pytest.raises(SceneError, match="limits = 1: phase lag has limits of its own"):
        motion_scales(PAPER, PAIR, "phase", ColourOptions(limits=1.0))


def test_large_numbers_have_powers_of_ten():
    numbers = (0.5, 730.0, 9990.0, 12345.0, 7.3e4, 2.4e7)
    assert [short_number(value) for value in numbers] == ["0.5", "730", "9990", "1.23·10⁴", "7.3·10⁴", "2.4·10⁷"]


def test_names_of_actuators_follow_the_plate(plates):
    """Every actuator has a name, as high as a node nearest to its corner."""
    plate = plates.plates[1]
    for frame in (0, 2, 4):
        plates.show(frame)
        names, surface = plate.names.points, plate.meshes.surface.points
        assert len(names) == len(plates.scene.actuators)
        away = np.linalg.norm(surface[:, None, :2] - names[:, :2], axis=2)
        nearest = away < away.min(axis=0) + 1e-6
        assert ((surface[:, None, 2] == names[:, 2]) & nearest).any(axis=0).all()
        assert (np.ptp(names[:, 2]) > 1e-9) == (frame != 2)  # no plate moves at a zero crossing


def test_another_field_changes_colours_but_not_heights(plates):
    plates.show(2)
    plate = plates.plates[0]
    before = plate.meshes.surface.points[:, 2].copy()
    for name in ("velocity", "energy", "rms-velocity", "phase"):
        plates.colour_by(name)
        np.testing.assert_array_equal(plate.meshes.surface.points[:, 2], before)
        values, scale = FIELDS[name].values(PAIR[0]), plates.scales[0]
        expected = values[2 % len(values)].ravel() * scale.unit_factor
        np.testing.assert_allclose(plate.meshes.surface.point_data[SCALARS], expected)
        # The limits hold for all plates and frames.
        largest = np.nanmax([np.abs(FIELDS[name].values(motion)) for motion in PAIR]) * scale.unit_factor
        assert name == "phase" or largest <= scale.clim[1] < 1.35 * largest
        ranges = [plate.surface.mapper.scalar_range for plate in plates.plates]
        assert ranges == [pytest.approx(scale.clim)] * 2
    # Phases are a circle of colours: those of −180° and 180° agree, no other lies between them, and NaN is grey.
    assert not plate.surface.mapper.interpolate_before_map
    table = plate.surface.mapper.lookup_table
    first, last, middle = (np.array(table.map_value(angle)) for angle in (-180.0, 180.0, 0.0))
    assert np.abs(first - last).max() < 0.02
    assert np.abs(first - middle)[:3].max() > 0.5
    # All are equally light, so that dark and light outlines show on each.
    colours = np.array([table.map_value(angle)[:3] for angle in np.linspace(-180, 180, 25)])
    assert np.ptp(colours @ (0.2126, 0.7152, 0.0722)) < 0.2
    assert 0.4 < colours.mean() < 0.8
    assert table.map_value(math.nan)[:3] == pytest.approx(pyvista.Color("#c8c8c8").float_rgb)


@pytest.mark.parametrize(
    ("motions", "quantity", "supports"),
    [
        *((WAVES, quantity, CLAMPED) for quantity in ("displacement", "energy", "rms-velocity", "phase")),
        (WAVES[1:], "displacement", EDGES),
        ([travelling_wave("mode 1, 200 Hz", 1.0, factor=None)], "displacement", CLAMPED),
    ],
    ids=["displacement", "energy", "rms-velocity", "phase", "edges", "mode"],
)
def test_picture(drawing, scene, verify_image_cache, motions, quantity, supports):
    """The fixture compares what is shown with tests/pictures, and fails if they differ."""
    verify_image_cache.error_value = verify_image_cache.warning_value = TOLERANCE
    columns = plate_subplots(len(motions), WIDTH, FONT_SIZE)
    plotter = make_plotter((sum(columns["col_weights"]), HEIGHT), off_screen=True, **columns)
    SideBySide(plotter, scene(edges=supports), motions, quantity, FONT_SIZE).show(1)
    plotter.show()


def test_lengths_are_in_millimetres_below_a_metre():
    assert [text for text, _ in axis_labels((0.21, 0.148))] == ["x: 0 … 210 mm", "y: 0 … 148 mm"]
    assert [text for text, _ in axis_labels((2.5, 0.5))] == ["x: 0 … 2.5 m", "y: 0 … 0.5 m"]
    assert (size_text((0.0001, 0.2)), point_text((0.05, 0.1234), (0.2, 0.2))) == ("0.1 × 200 mm", "50, 123.4")
