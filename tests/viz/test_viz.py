"""What is drawn, as data; then the pictures themselves, where this machine can draw."""

import itertools
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from warp_plate import viz
from warp_plate.result import Case, Result
from warp_plate.scene import Scene
from warp_plate.viz import availability
from warp_plate.viz.figures import _evenly
from warp_plate.viz.quantity import Scale, scale_over
from warp_plate.viz.surface import FIELD, caption, plate_meshes

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

TIMES = (0.0464, 0.0696)
SHARES = {"best": 0.6853, "equal": 0.25, "single": 0.6367}


def wave(nodes, across, height=2e-7):
    """A field (ny, nx) [m] of so many half waves along x and y."""
    x, y = (np.linspace(0, np.pi, count) for count in nodes)
    return height * np.outer(np.sin(across[1] * y), np.sin(across[0] * x))


@pytest.fixture
def paper():
    return Scene.load("paper")


@pytest.fixture
def result(paper):
    """As ``localize paper`` leaves it; the amplitudes of the cases differ by ten."""
    cases = {}
    for rank, (name, share) in enumerate(SHARES.items()):
        fields = [10.0**-rank * wave((27, 27), (rank + 2, 3 + step)) for step in range(len(TIMES))]
        energy = {"target": share * 1e-9, "plate": 1e-9}
        cases[name] = Case(np.ones(4, complex), energy, np.stack(fields), np.zeros((0, 3)))
    best = np.maximum.accumulate(0.68 - 0.3 * np.exp(-np.arange(80) / 9) * (1 + np.sin(np.arange(80))) / 2)
    history = {"evaluations": np.arange(20, 1601, 20), "best": best, "mean": best - 0.1}
    return Result(
        command="localize",
        source="paper",
        scene=paper,
        device="cpu",
        seed=0,
        effects=("damping",),
        cases=cases,
        times=np.array(TIMES),
        trace_times=np.arange(3.0),
        seconds={"compile": 0.0, "solve": 1.0},
        node_steps=1,
        bound=0.6867,
        history=history,
    )


@pytest.fixture
def drawing():
    """Skips the test where nothing can be drawn off screen."""
    if (problem := viz.missing()) is not None:
        pytest.skip(problem)


@pytest.fixture
def forgetful():
    """The trial drawing is made anew in this test and in the next."""
    availability._probe.cache_clear()
    yield
    availability._probe.cache_clear()


# Scales -----------------------------------------------------------------------------------------------------


def test_colours_are_symmetric_and_hold_for_all_times(result):
    for case in result.cases.values():
        scale = scale_over([case.displacement], (0.2, 0.2))
        low, high = scale.limits
        largest = np.abs(case.displacement).max()
        assert low == -high
        assert largest <= scale.limit < 1.1 * largest
        assert scale.limit * scale.per_base == pytest.approx(high)


def test_colours_of_several_cases_are_those_of_the_largest(result):
    size = result.scene.plate.size
    shared = scale_over([case.displacement for case in result.cases.values()], size)
    assert shared == scale_over([result.cases["best"].displacement], size)
    assert shared.limit > 50 * scale_over([result.cases["single"].displacement], size).limit


@pytest.mark.parametrize(
    ("largest", "unit", "end"),
    [
        (2.31e-13, "nm", 0.00024),
        (2.27e-7, "nm", 230),
        (9.95e-7, "µm", 1),
        (-3.2e-4, "µm", 320),
        (5e-3, "mm", 5),
        (2e3, "m", 2000),
    ],
)
def test_the_unit_suits_the_size(largest, unit, end):
    scale = scale_over([np.array([[0.0, largest]])], (0.2, 0.2))
    assert scale.unit == unit
    assert scale.limits == pytest.approx((-end, end))


def test_a_field_at_rest_and_one_that_is_not_finite_can_be_drawn(paper):
    assert scale_over([np.zeros((5, 5))], (0.2, 0.2)) == Scale(1e-6, 1.0, "µm", 1e6)
    field = wave((27, 27), (1, 1))
    field[3, 4] = np.inf
    field[5, 6] = np.nan
    scale = scale_over([field], (0.2, 0.2))
    assert scale.limit == pytest.approx(2e-7)
    heights = plate_meshes(paper, field, scale).surface.points[:, 2].reshape(27, 27)
    assert np.isfinite(heights).all()
    assert heights[3, 4] == heights[5, 6] == 0


# Meshes -----------------------------------------------------------------------------------------------------


def test_nodes_stand_at_the_height_factor_times_their_displacement(paper, random):
    field = random.normal(size=(9, 13)) * 1e-7
    scale = scale_over([field], paper.plate.size)
    surface = plate_meshes(paper, field, scale).surface
    x, y = np.meshgrid(np.linspace(0, 0.2, 13), np.linspace(0, 0.2, 9))
    np.testing.assert_allclose(surface.points[:, 0], x.ravel(), atol=1e-7)
    np.testing.assert_allclose(surface.points[:, 1], y.ravel(), atol=1e-7)
    np.testing.assert_allclose(surface.points[:, 2], scale.factor * field.ravel(), atol=1e-7)
    np.testing.assert_allclose(surface.point_data[FIELD], field.ravel() * 1e9, rtol=1e-12)
    assert scale.unit == "nm"
    # Two triangles a cell, which cover the plate once.
    assert surface.n_cells == 2 * 8 * 12
    flat = surface.copy()
    flat.points[:, 2] = 0
    assert flat.area == pytest.approx(0.04)


def test_outlines_lie_on_the_warped_surface(paper, random):
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    field = random.normal(size=(11, 14)) * 1e-7
    meshes = plate_meshes(paper, field, scale_over([field], paper.plate.size))
    points = meshes.surface.points.astype(float)
    triangles = Triangulation(points[:, 0], points[:, 1], meshes.surface.faces.reshape(-1, 4)[:, 1:])
    height = LinearTriInterpolator(triangles, points[:, 2])
    assert np.abs(points[:, 2]).max() > 0.01
    for outline in meshes.outlines:
        lines = outline.mesh
        on_line = np.concatenate([np.linspace(*ends, 7)[1:-1] for ends in segments(lines)])
        # Points on the edge of the plate can be found a rounding error outside of all triangles.
        inside = np.clip(on_line[:, :2], 1e-7, 0.2 - 1e-7)
        np.testing.assert_allclose(on_line[:, 2], height(*inside.T).filled(np.nan), atol=2e-6)


def segments(lines):
    """(segments, 2, 3) ends of all straight pieces of a mesh of polylines."""
    pieces, at = [], 0
    while at < len(lines.lines):
        way = lines.points[lines.lines[at + 1 : at + 1 + lines.lines[at]]].astype(float)
        pieces += itertools.pairwise(way)
        at += 1 + lines.lines[at]
    return np.array(pieces)


def test_outlines_go_round_the_target_and_each_actuator(paper):
    field = wave((27, 27), (2, 3))
    meshes = plate_meshes(paper, field, scale_over([field], paper.plate.size))
    drawn = {"clamped": meshes.sides["clamped"], "target": meshes.target, "actuators": meshes.actuators}
    lengths = {name: flat_length(outline.mesh) for name, outline in drawn.items()}
    assert lengths == pytest.approx({"clamped": 0.8, "target": 0.4, "actuators": 4 * 4 * 0.012}, rel=1e-5)
    for x0, x1, y0, y1 in (actuator.area for actuator in paper.actuators):
        for corner in ((x0, y0), (x0, y1), (x1, y0), (x1, y1)):
            distance = np.hypot(*(meshes.actuators.mesh.points[:, :2] - corner).T)
            assert distance.min() < 1e-7


def flat_length(lines):
    return np.hypot(*np.diff(segments(lines), axis=1)[:, 0, :2].T).sum()


def test_the_caption_holds_drive_time_and_localization_factor():
    assert caption("equal drive", 0.0464, 0.25) == "equal drive, t = 0.0464 s\nlocalization factor 25.00 %"
    assert "not defined" in caption("given drive", 0.0464, float("nan"))


def test_of_many_times_some_are_shown_with_first_and_last():
    assert _evenly(2, 6) == [0, 1]
    assert _evenly(1000, 6) == [0, 200, 400, 599, 799, 999]


# Pictures ---------------------------------------------------------------------------------------------------


def test_a_plate_in_a_plotter_has_fixed_colours_no_lighting_and_its_text(result, drawing):
    import pyvista

    case = result.cases["single"]
    scale = scale_over([case.displacement], result.scene.plate.size)
    cameras = []
    with availability.off_screen():
        for step in range(2):
            plotter = pyvista.Plotter(off_screen=True, window_size=[300, 200])
            text = caption("single actuator", TIMES[step], case.localization_factor)
            mesh = viz.scene3d.add_plate(plotter, result.scene, case.displacement[step], scale, text).meshes.surface
            surface = next(actor for actor in plotter.actors.values() if actor.mapper.dataset is mesh)
            assert surface.mapper.scalar_range == pytest.approx(scale.limits)
            assert not surface.prop.lighting
            texts = " ".join(prop.GetInput() for prop in view_props(plotter) if hasattr(prop, "GetInput"))
            assert "localization factor 63.67 %" in texts
            assert f"t = {TIMES[step]} s" in texts
            assert f"heights × {scale.factor:.0f}" in texts
            bar = next(prop for prop in view_props(plotter) if prop.IsA("vtkScalarBarActor"))
            assert bar.GetLookupTable().GetTableRange() == pytest.approx(scale.limits)
            assert "[nm]" in bar.GetTitle()
            cameras.append((plotter.camera.position, plotter.camera.parallel_scale))
            plotter.close()
    assert cameras[0] == cameras[1]


def view_props(plotter):
    props = plotter.renderer.GetViewProps()
    return [props.GetItemAsObject(index) for index in range(props.GetNumberOfItems())]


def pixels(path):
    from matplotlib.image import imread

    return np.round(imread(path)[..., :3] * 255).astype(int)


def test_surfaces_are_drawn_for_each_drive_and_time(result, drawing, tmp_path):
    assert viz.draw_surfaces(result, tmp_path / "figure.png") == tmp_path / "figure.png"
    picture = pixels(tmp_path / "figure.png")
    height, width = picture.shape[:2]
    assert width == pytest.approx(1600, abs=50)
    red, blue = (picture[..., one] - picture[..., other] for one, other in ((0, 2), (2, 0)))
    for row in np.split(np.arange(height), 3):
        for left in (0, 710):
            panel = np.ix_(row, np.arange(left, left + 710))
            # Amplitudes differ a hundred times from row to row; with its own limits each shows both colours.
            assert (red[panel] > 100).sum() > 1000
            assert (blue[panel] > 100).sum() > 1000
            title = picture[panel][:70]
            assert (title.max(axis=-1) < 100).sum() > 500
            # Nothing is cut off at the sides.
            assert (picture[panel][70:, :5] > 250).all()
    assert (picture[:3] > 250).all()
    assert (picture[-3:] > 250).all()


def test_the_picture_of_the_same_result_is_the_same(result, drawing, tmp_path):
    small = replace(result, cases={"drive": result.cases["single"]}, times=result.times[:1])
    first, second = (pixels(viz.draw_surfaces(small, tmp_path / f"{name}.png")) for name in "ab")
    assert (first == second).all()


def test_history_is_drawn_with_the_bound_and_the_published_loss(result, tmp_path):
    from matplotlib import rc_context

    with rc_context({"svg.fonttype": "none"}):
        text = viz.draw_history(result, tmp_path / "history.svg").read_text(encoding="utf-8")
        other = replace(result, source="panel.toml", bound=None)
        without = viz.draw_history(other, tmp_path / "other.svg").read_text(encoding="utf-8")
    for label in ("iteration", "best so far", "swarm mean", "bound: 0.3133", "published: 0.28"):
        assert f">{label}<" in text, label
    assert "bound" not in without
    assert "published" not in without
    picture = pixels(viz.draw_history(result, tmp_path / "history.png"))
    assert picture.shape[1] == 1600
    assert (picture.max(axis=-1) < 100).sum() > 1000


def test_history_shows_loss_that_never_rises_and_leaves_gaps(result):
    from matplotlib.figure import Figure

    history = {"best": np.array([0.3, 0.5, 0.4]), "mean": np.array([0.1, -np.inf, 0.2])}
    axes = Figure().add_subplot()
    viz.figures._plot_history(axes, replace(result, history=history))
    lines = {line.get_label(): line.get_ydata() for line in axes.get_lines()}
    np.testing.assert_allclose(lines["best so far"], [0.7, 0.5, 0.5])
    np.testing.assert_allclose(lines["swarm mean"], [0.9, np.nan, 0.8])
    assert lines["bound: 0.3133"][0] == pytest.approx(1 - 0.6867)


def test_all_pictures_of_a_search_and_of_a_simulation(result, drawing, tmp_path):
    written, problem = viz.draw_all(result, tmp_path / "paper")
    assert problem is None
    assert sorted(written) == sorted(tmp_path.iterdir())
    assert {path.name for path in written} == {"paper-surfaces.png", "paper-history.png"}
    simulation = replace(result, cases={"drive": result.cases["equal"]}, history={})
    assert viz.draw_all(simulation, tmp_path / "run") == ([tmp_path / "run-surfaces.png"], None)


def test_what_the_result_does_not_hold_is_not_drawn(result, tmp_path):
    nothing = replace(result, history={}, times=np.zeros(0))
    assert viz.draw_all(nothing, tmp_path / "empty") == ([], None)
    with pytest.raises(ValueError, match="no displacement"):
        viz.draw_surfaces(nothing, tmp_path / "empty.png")
    with pytest.raises(ValueError, match="no history"):
        viz.draw_history(nothing, tmp_path / "empty.png")


def test_a_picture_that_cannot_be_written_becomes_a_sentence(result, drawing, tmp_path):
    written, problem = viz.draw_all(result, tmp_path / "no such folder" / "paper")
    assert written == []
    assert problem.count("cannot be written") == 2


# Availability -----------------------------------------------------------------------------------------------

CRASH = "import os, signal; os.write(2, {!r}); os.kill(os.getpid(), signal.SIGSEGV)"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the packages are named for Linux")
@pytest.mark.parametrize(
    ("complaint", "reason"),
    [(b"WARN| Failed to load EGL!", "neither libEGL.so.1 nor"), (b"", "no EGL or OSMesa driver")],
)
def test_where_vtk_crashes_only_the_surfaces_are_missing(
    result, monkeypatch, forgetful, tmp_path, complaint, reason
):
    monkeypatch.setattr(availability, "PROBE", CRASH.format(complaint))
    written, problem = viz.draw_all(result, tmp_path / "paper")
    assert written == [tmp_path / "paper-history.png"]
    assert reason in problem
    assert "apt-get install libegl1 libgl1-mesa-dri" in problem
    assert "\n" not in problem
    with pytest.raises(viz.DrawingUnavailable, match=reason):
        viz.draw_surfaces(result, tmp_path / "paper.png")


def test_a_missing_system_library_is_named(monkeypatch, forgetful):
    error = "libXrender.so.1: cannot open shared object file: No such file or directory"
    monkeypatch.setattr(availability, "PROBE", f"raise ImportError({error!r})")
    assert "libXrender.so.1 is missing" in viz.missing()


def test_missing_packages_are_named(result, monkeypatch, forgetful, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    written, problem = viz.draw_all(result, tmp_path / "paper")
    assert written == []
    assert "without PyVista" in problem
    assert "without Matplotlib" in problem
    assert problem.count("pip install 'warp-plate[viz]'") == 2


def test_a_trial_drawing_without_an_end_is_given_up(monkeypatch, forgetful):
    monkeypatch.setattr(availability, "PROBE", "import time; time.sleep(600)")
    monkeypatch.setattr(availability, "PATIENCE", 0.2)
    assert viz.missing() is not None


def test_drawing_leaves_the_environment_as_it_was(drawing):
    before = dict(os.environ)
    with availability.off_screen():
        if sys.platform.startswith("linux"):
            assert os.environ[availability.WINDOW].startswith("vtk")
    assert dict(os.environ) == before


def run_python(code):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)


def test_drawing_writes_nothing_to_standard_error(drawing):
    code = """
import pyvista
from warp_plate.viz.availability import off_screen
with off_screen():
    plotter = pyvista.Plotter(off_screen=True, window_size=[64, 64])
    plotter.add_mesh(pyvista.Sphere())
    assert plotter.screenshot(return_img=True).std() > 0
    plotter.close()
"""
    run = run_python(code)
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


def test_importing_loads_neither_libraries_for_drawing_nor_the_solver():
    heavy = {"pyvista", "vtkmodules", "matplotlib", "PIL", "warp"}
    run = run_python(f"import sys, warp_plate.viz; print(sorted({heavy!r} & set(sys.modules)))")
    assert run.stdout.strip() == "[]", run.stderr
