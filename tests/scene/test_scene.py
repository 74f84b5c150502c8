"""Scene files: what is read, what is refused in one line that names the key, and the way back to TOML."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import PAPER, refusal
from hypothesis import assume, given
from hypothesis import strategies as st

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.scene import preset_names
from warp_plate.scene.dump import dump_scene

EXAMPLE = Path(__file__).parents[1] / "data" / "scene.example.toml"


def edited(table, key, value):
    """The paper's file with ``key = value`` in ``[table]`` (or the first ``[[table]]``) instead of its own
    line."""
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
        ("plate", "thicknes", "5e-4", "plate.thicknes", "did you mean 'thickness'?"),
        ("grid", "spacing", "0.01", "grid.spacing", "known here: nodes, order, load, time_step, precision"),
        ("effects.damping", "viscosity", "3", "effects.damping.viscosity", "viscous"),
        ("actuators", "magnitud", "1.0", "actuators[0].magnitud", "did you mean 'magnitude'?"),
        ("plate", "size", "[200, 200, 200]", "plate.size = [200, 200, 200]: ", "must be a list of 2 numbers"),
        ("plate", "size", "[0.2, -0.2]", "plate.size[1] = -0.2", "greater than 0"),
        ("plate", "size", "[5e-4, 0.2]", "plate.thickness", "metres"),
        ("plate", "thickness", "0.5", "plate.thickness", "thin"),
        ("plate", "thickness", "0", "plate.thickness = 0", "greater than 0"),
        ("plate", "young_modulus", "210", "plate.young_modulus = 210", "1000"),
        ("plate", "young_modulus", "2.1e14", "plate.young_modulus = 210000000000000.0", "1e+13 or less"),
        ("plate", "poisson_ratio", "0.5", "plate.poisson_ratio = 0.5", "less than 0.5"),
        ("plate", "density", "7.85e6", "plate.density", "100000"),
        ("plate", "density", "nan", "plate.density", "finite"),
        ("plate", "density", "1" + 400 * "0", "plate.density", "number"),
        ("edges", "left", '"held"', "edges.left = 'held'", "'clamped', 'supported', 'free', or a table of springs"),
        ("edges", "front", '"clamped"', "edges.front", "left, bottom, right, top"),
        ("grid", "nodes", "[27.5, 27]", "grid.nodes[0] = 27.5", "must be a whole number"),
        ("grid", "nodes", "[1e30, 27]", "grid.nodes[0] = 1e+30: ", "nearer to 0"),
        ("grid", "nodes", "[4, 27]", "grid.nodes[0] = 4", "5"),
        ("grid", "nodes", "27", "grid.nodes = 27", "must be a list of 2 whole numbers"),
        ("grid", "nodes", "[27, 99999999]", "grid.nodes[1]", "8193"),
        ("grid", "order", "3", "grid.order = 3", "2"),
        ("grid", "load", '"point"', "grid.load = 'point'", "'overlap', 'nodes' or 'moments'"),
        ("grid", "time_step", "0.0", "grid.time_step = 0.0", "greater than 0"),
        ("grid", "precision", '"float16"', "grid.precision = 'float16'", "'float32' or 'float64'"),
        ("window", "end", "0.05", "window.end", "later than start = 0.05"),
        ("window", "start", "0.2", "window.end", "later than start = 0.2"),
        ("window", "start", "-0.1", "window.start = -0.1", "0"),
        ("window", "end", "inf", "window.end", "finite"),
        ("drive", "frequency", "0", "drive.frequency = 0", "greater than 0"),
        ("target", "area", "[0.0, 0.1, 0.0]", "target.area = [0.0, 0.1, 0.0]: ", "must be a list of 4 numbers"),
        ("target", "area", "[0.0, 0.3, 0.0, 0.1]", "target.area", "off the plate"),
        ("target", "area", "[0.1, 0.1, 0.0, 0.1]", "target.area", "no inside"),
        ("record", "times", "[0.0464, 0.2]", "record.times[1]", "window.end = 0.1"),
        ("record", "points", "[[0.1, 0.1], [0.1, 0.21]]", "record.points[1]", "off the plate"),
        ("record", "points", "[0.1, 0.1]", "record.points[0] = 0.1: ", "must be a list of 2 numbers"),
        ("effects.damping", "viscous", "-1", "effects.damping.viscous = -1", "0"),
        ("effects.damping", "scheme", '"forward"', "effects.damping.scheme = 'forward'", "'backward'"),
        ("search", "particles", "1", "search.particles = 1", "2"),
        ("search", "iterations", "0", "search.iterations = 0", "1"),
        ("search", "seed", "-1", "search.seed = -1", "0"),
        ("search", "seed", "1" + 30 * "0", "search.seed", "less than 9223372036854775808"),
        ("search", "decay", "1.5", "search.decay = 1.5", "1"),
        ("search", "stall", "0", "search.stall = 0", "1"),
        ("search", "velocity_limit", "0", "search.velocity_limit = 0", "0"),
        ("actuators", "area", "[0.19, 0.21, 0.03, 0.04]", "actuators[0].area", "off the plate"),
        ("actuators", "area", "[0.042, 0.03, 0.03, 0.042]", "actuators[0].area", "x0 < x1"),
        ("actuators", "area", "[0.03, 0.042, 0.03, nan]", "actuators[0].area[3]", "finite"),
        ("actuators", "name", '""', "actuators[0].name = '': ", "1 or more characters"),
        ("actuators", "name", '"upper left"', "actuators[1].name: 'upper left'", "its own"),
        ("actuators", "magnitude", '"loud"', "actuators[0].magnitude = 'loud'", "number"),
        ("actuators", "phase", "inf", "actuators[0].phase", "finite"),
        ("drive", "electrostatic", "{ gain = 0.0 }", "drive.electrostatic.gain = 0.0", "must not be 0"),
        ("drive", "signal", '{ file = "a.wav", gain = 0 }', "drive.signal.gain = 0", "must not be 0"),
        ("plate", "thickness", "2020-01-01", "plate.thickness = 2020-01-01: ", "must be a number"),
        ("grid", "rows", "1", "grid.rows", "unknown key; known here: nodes"),
        ("record", "points", "0.1", "record.points = 0.1: ", "must be a list of points [x, y]"),
        ("target", "polygon", "[[0.0, 0.0], [0.1, 0.1]]", "target.polygon = [[0.0, 0.0]", "at least 3 points [x, y]"),
        ("search", "frequency", "{ range = 'a' }", "search.frequency.range = 'a': ", "must be a list of 2 numbers"),
        ("search", "frequency", "true", "search.frequency = true: ", "must be a table, [search.frequency]"),
        ("search", "phase", "{ actuators = 'a' }", "search.phase.actuators = 'a': ", "must be a list of texts"),
        ("search", "objectives", "[]", "search.objectives = []: ", "at least 1 table, [[search.objectives]]"),
        ("search", "objectives", "{ weight = 1 }", "search.objectives = {weight = 1}: ", "a list of tables"),
        ("search", "objectives", "[1]", "search.objectives[0] = 1: ", "must be a table, [[search.objectives]]"),
        ("search", "limits", "{ equal_magnitudes = 'yes' }", "search.limits.equal_magnitudes = 'yes'", "true or false"),
        ("search", "delay", "{ range = [0, 1], own = 1 }", "search.delay.own = 1: ", "must be true or false"),
        ("search", "robust", "{ gain = 0.1, quantile = 0.5 }", "search.robust.quantile = 0.5", "measure = 'quantile'"),
    ],
)  # fmt: skip
def test_refused_by_name(table, key, value, named, right):
    line = refusal(edited(table, key, value))
    assert line.startswith(named)
    assert right in line


def test_a_fault_is_counted_once():
    """pydantic finds fault with what is around it too; a list that is too short is one fault whatever it lacks."""
    objectives = "[[search.objectives]]\nkind = 'contrast'\nweight = -1.0\n"
    line = refusal(PAPER + objectives)
    assert line == "search.objectives[0].weight = -1.0: must be greater than 0"
    assert "(and 1 more)" in refusal(PAPER + objectives + objectives.replace("contrast", "velocity"))
    assert "more)" not in refusal(edited("target", "area", "[0.0]"))


@pytest.mark.parametrize(
    ("limits", "line"),
    [
        ("magnitude = 0.5", "search.limits.magnitude = 0.5: below search.magnitude.range[0] = 1; raise it or lower"),
        ("power = 1.9", "search.limits.power = 1.9: below 2, which the squares of search.magnitude.range[0] = 1 add"),
    ],
)
def test_limits_that_shut_out_all_that_is_free_are_refused(limits, line):
    free = "[search.magnitude]\nrange = [1.0, 2.0]\nactuators = ['upper left', 'lower right']\n"
    assert refusal(f"{PAPER}{free}[search.limits]\n{limits}").startswith(line)
    for enough in ("magnitude = 1.0", "power = 2.0"):
        assert Scene.parse(f"{PAPER}{free}[search.limits]\n{enough}", "").search.limits
    tenth = free.replace("1.0", "0.1").replace("['upper left', 'lower right']", "['upper left']")
    assert Scene.parse(f"{PAPER}{tenth}[search.limits]\npower = 0.01", "").search.limits


def test_a_quantile_that_is_read_or_as_the_default_has_it_is_no_fault():
    for keys in ("measure = 'quantile'\nquantile = 0.5", "quantile = 0.9"):
        scene = Scene.parse(f"{PAPER}[search.robust]\ngain = 0.1\n{keys}", "")
        assert Scene.parse(dump_scene(scene), "") == scene


LAYER = "[{ area = [0.0, 0.1, 0.0, 0.1], thickness = 0.05, young_modulus = 1e9, density = 1e3 }]"


@pytest.mark.parametrize(
    ("line", "named", "right"),
    [
        ("variation.thickness = [1.0, 1.0]", "effects.variation.thickness = [1.0, 1.0]", "such as [[1.0, 1.0]]"),
        ("variation.density = 2.0", "effects.variation.density = 2.0", "such as [[1.0, 1.0]]"),
        ("variation.density = []", "effects.variation.density = []", "such as [[1.0, 1.0]]"),
        (f"layers = {LAYER}", "effects.layers[0].thickness: 0.05 m", "at most a fifth"),
    ],
)
def test_effects_that_the_paper_lacks_are_refused_by_name(line, named, right):
    refused = refusal(PAPER.replace("[effects.damping]", f"[effects]\n{line}\n[effects.damping]"))
    assert refused.startswith(named)
    assert right in refused


def test_edits_are_what_they_seem():
    """The paper's own values, written by ``edited``, are the paper's scene: the cases above differ in one
    key."""
    scene = Scene.parse(PAPER, "")
    assert Scene.parse(edited("plate", "density", "1000.0"), "") == scene
    assert Scene.parse(edited("actuators", "phase", "0.0"), "") == scene
    assert Scene.parse(edited("effects.damping", "viscous", "88.3"), "") == scene


def test_unknown_tables_are_refused_before_missing_ones():
    line = refusal(PAPER.replace("[plate]", "[plates]"))
    assert line.startswith("plates: unknown key; did you mean 'plate'?")
    assert "(and 1 more)" in line
    assert refusal(PAPER + "\n[effects.gravity]\ng = 9.81\n").startswith("effects.gravity: unknown key")


@pytest.mark.parametrize(
    "text", ["", "actuators = []", "plate = 1", "[[plate]]\nsize = 1", "[plate]\nsize = 1979-05-27"]
)
def test_incomplete_files_are_refused(text):
    assert refusal(text).startswith("plate")


@pytest.mark.parametrize("text", ["[plate", "a = ", 'title = "a\nb"', "a = 1\na = 2", "\x00"])
def test_what_is_not_toml_is_refused(text):
    assert refusal(text).startswith("not TOML: ")


@pytest.mark.parametrize("key", [r'"two\nlines"', r'"\r"', r'"\u2028"', '"two words"', '"[0]"'])
def test_odd_keys_stay_on_one_line(key):
    assert "unknown key" in refusal(PAPER.replace("[plate]", f"{key} = 1\n[plate]"))
    assert "unknown key" in refusal(PAPER.replace("[record]", f"[record]\n{key} = 1"))


@given(
    st.dictionaries(st.text(min_size=1), st.integers() | st.text() | st.floats() | st.booleans(), min_size=1)
)
def test_any_unknown_keys_make_one_line(keys):
    lines = "\n".join(f"{quoted(key)} = {quoted(value)}" for key, value in keys.items() if key != "title")
    text = PAPER.replace("[plate]", f"{lines}\n[plate]") if lines else PAPER + "\n[plates]"
    assert refusal(text)


def quoted(value):
    """A TOML literal, written here on its own."""
    if isinstance(value, str):
        return '"' + "".join(f"\\U{ord(character):08x}" for character in value) + '"'
    return str(value).lower()


def test_missing_files_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for source in ("papers", "paper.toml", str(tmp_path), "", "no/such.toml", "a\0b"):
        with pytest.raises(SceneError, match="no such preset or file") as caught:
            Scene.load(source)
        assert "paper-supported" in str(caught.value)
    (tmp_path / "latin.toml").write_bytes('title = "Schalldämmung"'.encode("latin-1"))
    with pytest.raises(SceneError, match=r"^latin\.toml: cannot be read as UTF-8"):
        Scene.load("latin.toml")


def test_a_byte_order_mark_is_no_fault(tmp_path):
    """Some editors on Windows put one at the head of every UTF-8 file."""
    (tmp_path / "panel.toml").write_text(PAPER, encoding="utf-8-sig")
    assert Scene.load(tmp_path / "panel.toml") == Scene.load("paper")


@pytest.mark.parametrize("name", preset_names())
def test_presets_load_and_run(name):
    scene = Scene.load(name)
    assert Scene.parse(dump_scene(scene), name) == scene
    solver = PlateSolver(scene, "cpu")
    assert solver.run([[1] * len(scene.actuators)]).finite.all()


def test_the_paper_s_numbers():
    """Section III of the source paper, as DESIGN.md reads it."""
    assert {"paper", "paper-supported"} <= set(preset_names())
    scene = Scene.load("paper")
    assert (scene.plate.size, scene.plate.thickness, scene.plate.poisson_ratio) == ((0.2, 0.2), 5e-4, 0.33)
    assert (scene.plate.young_modulus, scene.plate.density) == (1e9, 1000)
    assert (scene.grid.nodes, scene.grid.time_step, scene.grid.load) == ((27, 27), 8e-5, "nodes")
    assert (scene.window.start, scene.window.end, scene.drive.frequency) == (0.05, 0.1, 290)
    assert scene.target.area == (0, 0.1, 0, 0.1)
    assert scene.record.times == (0.0464, 0.0696)
    assert scene.effects.damping.scheme == "backward"
    assert (scene.search.particles, scene.search.iterations, scene.search.decay) == (20, 80, 0.99)
    low, high = (0.03, 0.042), (0.158, 0.17)
    assert [actuator.area for actuator in scene.actuators] == [
        (*low, *low), (*low, *high), (*high, *low), (*high, *high),
    ]  # fmt: skip
    supported = Scene.load("paper-supported")
    assert {supported.edges.left, supported.edges.bottom, supported.edges.right, supported.edges.top} == {
        "supported"
    }


def test_the_example_file_is_read_whole():
    """Every key of the format's example file, with its value."""
    scene = Scene.load(EXAMPLE)
    assert scene.title == "Haptic panel, four actuators"
    assert (scene.plate.size, scene.plate.density, scene.edges.top) == ((0.2, 0.2), 1000, "clamped")
    assert (scene.grid.nodes, scene.grid.order, scene.grid.load) == ((27, 27), 2, "overlap")
    assert (scene.grid.time_step, scene.grid.precision) == (8e-5, "float32")
    assert (scene.effects.damping.viscous, scene.effects.damping.scheme) == (88.5, "centred")
    assert (scene.search.inertia, scene.search.cognitive, scene.search.social, scene.search.seed) == (
        0.4,
        2,
        2,
        0,
    )
    assert [actuator.name for actuator in scene.actuators] == [
        "lower left",
        "upper left",
        "lower right",
        "upper right",
    ]
    assert (scene.actuators[3].magnitude, scene.actuators[3].phase) == (1, 0)


def test_no_effect_without_its_table(scene):
    """A scene that names no effect has none in its kernel."""
    assert PlateSolver(scene(), "cpu").effects == ()
    assert PlateSolver(scene(damping=0.0), "cpu").effects == ("viscous damping (centred)",)
    assert PlateSolver(scene(damping=1.0, scheme="backward"), "cpu").effects == (
        "viscous damping (backward)",
    )


# TOML holds every character but surrogates, HDF5 every one but NUL.
TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))


@given(title=TEXTS, names=st.lists(TEXTS.filter(len), min_size=3, max_size=3, unique=True))
def test_any_title_and_names_survive(title, names):
    scene = Scene.load("paper")
    actuators = tuple(
        actuator.model_copy(update={"name": name})
        for actuator, name in zip(scene.actuators, names, strict=False)
    )
    changed = scene.model_copy(update={"title": title, "actuators": actuators})
    assert Scene.parse(dump_scene(changed), "") == changed


@given(
    area=st.lists(st.floats(0, 0.2), min_size=4, max_size=4, unique=True),
    magnitude=st.just(0.0) | st.floats(1e-30, 1e30) | st.floats(-1e30, -1e-30),
    thickness=st.floats(1e-30, 0.04),
    time_step=st.none() | st.floats(1e-30, 1e30),
    stall=st.none() | st.integers(1, 10**30),
)
def test_any_numbers_survive(area, magnitude, thickness, time_step, stall):
    scene = Scene.load("paper")
    x0, x1, y0, y1 = *sorted(area[:2]), *sorted(area[2:])
    assume(min(x1 - x0, y1 - y0) > 1e-6)
    actuator = scene.actuators[0].model_copy(update={"area": (x0, x1, y0, y1), "magnitude": magnitude})
    changed = scene.model_copy(
        update={
            "plate": scene.plate.model_copy(update={"thickness": thickness}),
            "grid": scene.grid.model_copy(update={"time_step": time_step}),
            "search": scene.search.model_copy(update={"stall": stall}),
            "actuators": (actuator,),
        }
    )
    assert Scene.parse(dump_scene(changed), "") == changed


def test_every_table_survives(scene):
    """Tables that presets leave out: points, a velocity limit, other edges, no effects at all."""
    made = scene(
        (17, 9), (0.2, 0.16), ("clamped", "supported", "supported", "clamped"),
        record={"times": (0.001, 0.01), "points": ((0.1, 0.1), (0.0, 0.16))},
        search={"velocity_limit": 1.5, "stall": 7, "seed": 12},
    )  # fmt: skip
    assert Scene.parse(dump_scene(made), "") == made


def test_reading_scenes_needs_no_warp():
    """Neither Warp nor PyVista is imported by scenes, schemes, references, the swarm or results."""
    modules = (
        "scene",
        "plate.scheme",
        "plate.weights",
        "reference.numpy_plate",
        "reference.series",
        "search.pso",
        "result",
    )
    code = "import sys\n" + "".join(f"import warp_plate.{module}\n" for module in modules)
    code += "print(sorted({'warp', 'pyvista', 'vtk', 'vtkmodules', 'matplotlib'} & set(sys.modules)))"
    root = Path(__file__).parents[2]
    answer = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "[]"
