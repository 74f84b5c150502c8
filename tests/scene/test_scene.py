"""Scene files: reading, refusals that name the key, and dumping to TOML."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from support.scenes import PAPER, refusal, refused
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.scene.load import parse_toml, preset_names

TESTS = Path(__file__).parents[1]
LAYER = "{ area = [0.0, 0.1, 0.0, 0.1], thickness = 0.05, young_modulus = 1e9, density = 1e3 }"
MORE = "88.3\n[effects]\n"


def edited(table, key, value):
    """Return the paper's scene file with ``key = value`` in ``[table]`` (or the first ``[[table]]``)."""
    head, bracket, body = PAPER.partition(f"[{table}]")
    assert bracket, table
    body = body[1:] if body.startswith("]") else body
    bracket = bracket + "]" if table == "actuators" else bracket
    section, end, rest = body.partition("\n\n")
    section = re.sub(rf"\n{re.escape(key)} = .*", "", section)
    return f"{head}{bracket}{section}\n{key} = {value}{end}{rest}"


@pytest.mark.parametrize(
    ("table", "key", "value", "named", "right"),
    [
        ("plate", "thicknes", "5e-4", "plate.thicknes", "'thickness'?"),
        ("grid", "spacing", "0.01", "grid.spacing", "nodes, order, load, time_step, precision"),
        ("plate", "size", "[200, 200, 200]", "plate.size = [200, 200, 200]: ", "list of 2 numbers"),
        ("plate", "density", "1.0\ncorner_radius = 0.008", "plate.corner_radius: unknown key", "in [plate.outline]"),
        ("plate", "size", "[5e-4, 0.2]", "plate.thickness", "metres"),
        ("plate", "thickness", "0.0401", "plate.thickness", "thin"),
        ("plate", "thickness", "2020-01-01", "plate.thickness = 2020-01-01: ", "must be a number"),
        ("plate", "young_modulus", "999", "plate.young_modulus = 999", "1000"),
        ("plate", "density", "1" + 400 * "0", "plate.density", "number"),
        ("edges", "left", '"held"', 'edges.left = "held"', "'clamped', 'supported', 'free', or a table of springs"),
        ("grid", "nodes", "[27.5, 27]", "grid.nodes[0] = 27.5", "must be a whole number"),
        ("grid", "nodes", "[27, 8194]", "grid.nodes[1]", "8193"),
        ("grid", "load", '"point"', 'grid.load = "point"', "'overlap', 'nodes' or 'moments'"),
        ("grid", "time_step", "1e-31", "grid.time_step = 1e-31", "1e-30 to 1e+30"),
        ("grid", "accuracy", "0.01", "grid.accuracy: 0.01", "delete load, nodes, order, precision, time_step"),
        ("window", "end", "0.05", "window.end", "later than start = 0.05"),
        ("target", "area", "[0.0, 0.1, 0.0]", "target.area = [0.0, 0.1, 0.0]: ", "list of 4 numbers"),
        ("target", "area", "[0.0, 0.3, 0.0, 0.1]", "target.area", "off the plate"),
        ("target", "area", "[0.1, 0.1, 0.0, 0.1]", "target.area", "no inside"),
        ("target", "area", "[0.0, 0.1, 0.0, 1e-8]", "target.area", "wide along y"),
        ("target", "polygon", "[[0.0, 0.0], [0.1, 0.1]]", "target.polygon = [[0.0, 0.0]", "3 or more points [x, y]"),
        ("record", "times", "[0.0464, 0.2]", "record.times[1]", "window.end = 0.1"),
        ("record", "points", "[[0.1, 0.1], [0.1, 0.21]]", "record.points[1]", "off the plate"),
        ("effects.damping", "viscous", "-1", "effects.damping.viscous = -1", "0"),
        ("search", "seed", "1" + 30 * "0", "search.seed", "less than 9223372036854775808"),
        ("search", "frequency", "{ range = [2, 1] }", "search.frequency.range", "smaller number first"),
        ("search", "phase", "{ actuators = 'a' }", 'search.phase.actuators = "a": ', "list of texts"),
        ("search", "objectives", "[]", "search.objectives = []: ", "1 or more tables, [[search.objectives]]"),
        ("search", "objectives", "[{ rest_limit = 1.0 }]", "search.objectives[0].rest_limit", "'velocity'"),
        ("search", "objectives", "[{}, {}]", "search.objectives[1].kind", "weights"),
        ("search", "limits", "{ equal_magnitudes = 'yes' }", 'search.limits.equal_magnitudes = "yes"', "true or false"),
        ("search", "robust", "{ gain = 0.1, quantile = 0.5 }", "search.robust.quantile = 0.5", "measure = 'quantile'"),
        ("actuators", "area", "[0.03, 0.042, 0.03, nan]", "actuators[0].area[3]", "finite"),
        ("actuators", "name", '"upper left"', "actuators[1].name: 'upper left'", "its own"),
        ("drive", "electrostatic", "{ gain = 0.0 }", "drive.electrostatic.gain = 0.0", "not be 0"),
        ("drive", "signal", '{ file = "../a.wav" }', "drive.signal.file: '../a.wav'", "without folders"),
        ("drive", "burst", "{ duration = 1.0, ramp = 0.6 }", "drive.burst.ramp", "0.5 s"),
        ("effects.damping", "viscous", f"{MORE}layers = [{LAYER}]", "effects.layers[0].thickness: 0.05 m", "a fifth"),
        ("effects.damping", "viscous", f"{MORE}variation.density = [1.0]", "effects.variation.density = [1.0]", "[[1"),
    ],
)  # fmt: skip
def test_invalid_values_are_refused_by_key(table, key, value, named, right):
    line = refusal(edited(table, key, value))
    assert line.startswith(named)
    assert right in line


def test_each_error_is_counted_once():
    """pydantic also reports what encloses an error; a list that is too short is one error however short it is."""
    objectives = "[[search.objectives]]\nkind = 'contrast'\nweight = -1.0\n"
    assert refusal(PAPER + objectives) == "search.objectives[0].weight = -1.0: must be greater than 0"
    assert "(and 1 more)" in refusal(PAPER + objectives + objectives.replace("contrast", "velocity"))
    assert "more)" not in refusal(edited("target", "area", "[0.0]"))
    unknown = refusal(PAPER.replace("[plate]", "[plates]"))  # reported before the missing table
    assert unknown.startswith("plates: unknown key")
    assert "more)" not in unknown  # the missing table is the misspelt one


@pytest.mark.parametrize(
    ("limits", "enough"), [("magnitude = 0.99", "magnitude = 1.0"), ("power = 1.9", "power = 2.0")]
)
def test_limits_must_allow_a_magnitude(limits, enough):
    free = "[search.magnitude]\nrange = [1.0, 2.0]\nactuators = ['upper left', 'lower right']\n"
    assert refusal(f"{PAPER}{free}[search.limits]\n{limits}").startswith(f"search.limits.{limits}: below")
    assert Scene.parse(f"{PAPER}{free}[search.limits]\n{enough}", "").search.limits


@pytest.mark.parametrize(
    ("text", "named"),
    [(text, "plate") for text in ("", "plate = 1", "[[plate]]\nsize = 1", "[plate]\nsize = 1979-05-27")]
    + [(text, "not TOML: ") for text in ("[plate", 'title = "a\nb"', "a = 1\na = 2", "\x00")],
)
def test_other_texts_are_refused(text, named):
    assert refusal(text).startswith(named)


@given(st.dictionaries(st.text(min_size=1), st.integers() | st.text() | st.floats() | st.booleans()))
def test_any_unknown_keys_are_refused_in_one_line(keys):
    assert ": unknown key" in refused(Scene.from_tables, {**keys, "plates": 1, **parse_toml(PAPER, "")})


def test_missing_files_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneError, match="paper-supported"):
        Scene.load("papers")
    Path("latin.toml").write_bytes('title = "Schalldämmung"'.encode("latin-1"))
    with pytest.raises(SceneError, match=r"^latin\.toml: .*UTF-8"):
        Scene.load("latin.toml")
    Path("windows.toml").write_text(PAPER, encoding="utf-8-sig")  # with a byte order mark
    assert Scene.load("windows.toml") == Scene.load("paper")


@pytest.mark.parametrize("name", preset_names())
def test_presets_load_and_run(name):
    scene = Scene.load(name)
    assert Scene.parse(scene.to_toml(), name) == scene
    if scene.modal_only_key is None:
        assert PlateSolver(scene, "cpu").run([[1] * len(scene.actuators)]).finite.all()


def test_scenes_without_a_grid_ask_for_one_percent_and_nonlinear_ones_have_16_cells_a_wave():
    """A wave of 290 Hz is as long as 2π√κ/√ω; squares of voltages have twice the frequency."""
    tables = parse_toml(PAPER, "paper")
    del tables["grid"]
    scene = Scene.from_tables(tables)
    assert scene.grid.accuracy == 0.01
    with pytest.raises(SceneError, match=r"^grid\.accuracy = 0\.01: no grid is chosen yet; write grid\.nodes"):
        PlateSolver(scene, "cpu")
    stretched = scene.with_tables(effects={"stretching": {}})
    plate, omega = scene.plate, 2 * math.pi * 290
    wave = 2 * math.pi * (plate.rigidity / (plate.density * plate.thickness)) ** 0.25 / math.sqrt(omega)
    cells = math.ceil(16 * 0.2 / wave)
    assert (stretched.grid.accuracy, stretched.grid.nodes) == (None, (cells + 1, cells + 1))
    slower = stretched.with_values({"drive.frequency": 290 / 4})
    assert slower.grid.nodes == (math.ceil(8 * 0.2 / wave) + 1,) * 2
    assert scene.with_values({"drive.frequency": 100.0}).grid.accuracy == 0.01
    assert Scene.parse(stretched.to_toml(), "dumped").grid == stretched.grid


def test_the_paper_has_its_numbers():
    """Section III of the source paper."""
    scene = Scene.load("paper")
    plate, grid, search = scene.plate, scene.grid, scene.search
    assert (plate.size, plate.thickness, plate.poisson_ratio) == ((0.2, 0.2), 5e-4, 0.33)
    assert (plate.young_modulus, plate.density) == (1e9, 1000)
    assert (grid.nodes, grid.time_step, grid.load) == ((27, 27), 8e-5, "nodes")
    assert (scene.window.start, scene.window.end, scene.drive.frequency) == (0.05, 0.1, 290)
    assert (scene.target.area, scene.record.times) == ((0, 0.1, 0, 0.1), (0.0464, 0.0696))
    assert scene.effects.damping.scheme == "backward"
    assert (search.particles, search.iterations, search.decay) == (20, 80, 0.99)
    low, high = (0.03, 0.042), (0.158, 0.17)
    areas = [(*low, *low), (*low, *high), (*high, *low), (*high, *high)]
    assert [actuator.area for actuator in scene.actuators] == areas
    assert {edge for _, edge in Scene.load("paper-supported").edges} == {"supported"}


def test_every_key_of_a_file_is_read():
    def check(read, written):
        if isinstance(written, dict | list):
            for key in written if isinstance(written, dict) else range(len(written)):
                check(read[key], written[key])
            assert isinstance(written, dict) or len(read) == len(written)
        else:
            assert read == written

    text = (TESTS / "data" / "all_keys.toml").read_text(encoding="utf-8")
    check(Scene.parse(text, "").model_dump(), parse_toml(text, ""))


# TOML holds every character but surrogates, HDF5 every character but NUL.
TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))


@given(
    texts=st.lists(TEXTS.filter(len), min_size=2, max_size=2),
    area=st.lists(st.floats(0, 0.2), min_size=4, max_size=4, unique=True),
    magnitude=st.just(0.0) | st.floats(1e-30, 1e30) | st.floats(-1e30, -1e-30),
    time_step=st.none() | st.floats(1e-30, 1e30),
    stall=st.none() | st.integers(1, 10**30),
)
def test_any_texts_and_numbers_survive_a_dump(texts, area, magnitude, time_step, stall):
    scene = Scene.load("paper")
    x0, x1, y0, y1 = *sorted(area[:2]), *sorted(area[2:])
    assume(min(x1 - x0, y1 - y0) > 1e-6)
    actuator = {"name": texts[1], "area": (x0, x1, y0, y1), "magnitude": magnitude}
    update = {
        "title": texts[0],
        "grid": scene.grid.model_copy(update={"time_step": time_step}),
        "search": scene.search.model_copy(update={"stall": stall}),
        "actuators": (scene.actuators[0].model_copy(update=actuator),),
    }
    changed = scene.model_copy(update=update)
    assert Scene.parse(changed.to_toml(), "") == changed


def test_reading_scenes_imports_neither_warp_nor_graphics():
    modules = ("scene", "plate.scheme", "plate.weights", "optimize.pso")
    code = "import sys\n" + "".join(f"import warp_plate.{module}\n" for module in modules)
    code += "print(sorted({'warp', 'pyvista', 'vtk', 'vtkmodules', 'matplotlib'} & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", code], cwd=TESTS.parent, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
