"""Scenes at random: every one is read, goes on to a right answer, or is refused in one line that can be shown."""

import copy
import math
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate import memory
from warp_plate.plate.moving_load import moving_weights
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.signals import make_signals
from warp_plate.plate.weights import patches, region_weights
from warp_plate.problem.objectives import make_objectives
from warp_plate.reference.numpy_moment_form import run_general
from warp_plate.scene import preset_text
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.load import MOST_BYTES

# Every table and key of docs/scene.md and docs/drives.md but the file of a signal, which tests/plate/test_sampled.py
# has, and a robust search, which has one target.
WHOLE = {
    "title": "panel",
    "plate": {"size": [0.2, 0.15], "thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1e3},
    "edges": {
        "left": "clamped", "bottom": "supported", "right": "free", "top": {"translation": 1e5, "rotation": 10.0},
    },
    "grid": {"nodes": [11, 9], "order": 2, "load": "overlap", "precision": "float64"},
    "window": {"start": 0.002, "end": 0.004},
    "drive": {
        "frequency": 290.0,
        "burst": {"start": 0.0, "duration": 0.003, "ramp": 0.001, "period": 0.0035},
        "chirp": {"end_frequency": 400.0, "duration": 0.003, "law": "linear"},
        "electrostatic": {"bias": 1.0, "gain": 2.0},
    },
    "targets": [
        {"name": "polygon", "polygon": [[0.0, 0.0], [0.1, 0.01], [0.08, 0.05], [0.1, 0.1], [0.0, 0.1]]},
        {"name": "disc", "disc": [0.13, 0.08, 0.05]},
        {"name": "area", "area": [0.0, 0.1, 0.0, 0.1]},
    ],
    "record": {"times": [0.001, 0.004], "points": [[0.1, 0.1], [0.0, 0.15]]},
    "effects": {
        "damping": {"viscous": 88.0, "scheme": "centred"},
        "material_damping": {"time": 1e-6},
        "tension": {"x": 10.0, "y": -1.0},
        "foundation": {"stiffness": 1e4, "damping": 1.0},
        "orthotropic": {"Dx": 0.012, "Dy": 0.01, "D1": 0.003, "Dxy": 0.004},
        "layers": [
            {"area": [0.03, 0.06, 0.03, 0.06], "thickness": 1e-4, "young_modulus": 2e9, "density": 1800.0, "both": True}
        ],
        "variation": {"thickness": [[1.0, 1.2], [0.9, 1.0]], "young_modulus": [[1.0]], "density": [[1.0, 2.0]]},
        "oscillators": [{"area": [0.1, 0.12, 0.1, 0.12], "mass": 1e-3, "stiffness": 100.0, "damping": 0.1}],
        "stretching": {},
        "moving_load": {
            "force": 1.0, "start": [0.0, 0.1], "velocity": [10.0, 0.0], "size": 0.01, "from_time": 0.0,
            "to_time": 0.003, "frequency": 100.0,
        },
    },
    "search": {
        "particles": 4, "iterations": 3, "inertia": 0.4, "decay": 0.99, "cognitive": 2.0, "social": 2.0,
        "velocity_limit": 3.0, "stall": 2, "seed": 1,
        "magnitude": {"range": [0.0, 2.0], "actuators": ["a"]}, "phase": {"actuators": ["a"]},
        "frequency": {"range": [200.0, 400.0], "own": True}, "position": {"area": [0.0, 0.2, 0.0, 0.1]},
        "delay": {"range": [0.0, 0.001], "own": False},
        "limits": {"magnitude": 2.0, "power": 3.0, "equal_magnitudes": False},
        "objectives": [{"kind": "velocity", "weight": 10.0, "rest_limit": 0.1}, {"kind": "uniformity"}],
    },
    "actuators": [
        {"name": "a", "area": [0.03, 0.06, 0.03, 0.06], "magnitude": 1.0, "phase": 0.5, "frequency": 300.0},
        {"name": "b", "area": [0.1, 0.16, 0.05, 0.1], "magnitude": 2.0, "phase": 0.0},
    ],
}  # fmt: skip
OPTIONAL = [("edges",), ("record",), *(("drive", name) for name in ("burst", "chirp", "electrostatic"))]
OPTIONAL += [("effects", name) for name in WHOLE["effects"]]
NUMBERS = [0, -1, 4, 0.0, -0.0, 5e-324, 1e-300, 1e-30, 1e-9, 1e9, 1e30, 1e300, -1e300, math.inf, -math.inf, math.nan]
KINDS = ["", "x", "[red]", "\x1b[31m", True, [], {}, [1.0], [[1.0]], {"a": 1.0}, [0.0] * 5, 2**63, 10**400]
# What TOML and its users have other words for.
PYTHON_S = re.compile(r"\b(tuple|dict\w*|instance|validation|valid|[Ii]nput|string|integer|bool\w*|unable|True|None)\b")
LARGEST_GRID, LONGEST_RUN = 40_000, 20_000


def toml(value):
    """A value as TOML; tables are written in one line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return '"' + "".join(f"\\U{ord(letter):08x}" for letter in value) + '"'
    return repr(value)


def text_of(tables):
    return "\n".join(f"{key} = {toml(value)}" for key, value in tables.items())


def leaves(value, at=()):
    """The way to every number, text and truth value."""
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*at, key))
    else:
        yield at


def item(tables, way):
    for key in way:
        tables = tables[key]
    return tables


def changed(way, value, without=()):
    """WHOLE with another value somewhere, and without some of its tables."""
    tables = copy.deepcopy(WHOLE)
    for table in without:
        del item(tables, table[:-1])[table[-1]]
    try:
        item(tables, way[:-1])[way[-1]] = copy.deepcopy(value)
    except (KeyError, IndexError, TypeError):  # it stood in one of these, or in what another change replaced
        return tables
    return tables


def read(tables):
    """The scene of the tables, or None where they are refused, in one line that a terminal shows as it is."""
    try:
        scene = Scene.parse(text_of(tables), "scene.toml")
    except SceneError as error:
        shown(error)
        return None
    assert Scene.parse(dump_scene(scene), "") == scene
    return scene


def shown(error):
    assert str(error).isprintable()
    assert "not TOML" in str(error) or not PYTHON_S.search(str(error))
    assert len(str(error)) < 600


def goes_on(scene):
    """All that is made of a scene before plates are stepped consists of numbers, or is refused in one line."""
    if scene is None or math.prod(scene.grid.nodes) > LARGEST_GRID:
        return
    try:
        scheme = make_scheme(scene)
        fields = [patches(scene), region_weights(scene, {one.name: one for one in scene.targets[1:]})]
        judge = make_objectives(scene)
        fields += [judge.areas, judge.masses, judge.cells]
        if scheme.steps <= LONGEST_RUN:
            signals = make_signals(scene, scheme.time_step, scheme.steps)
            fields += [signals.wave, signals.mixing]
            if scene.effects.moving_load is not None:
                fields += moving_weights(scene, scheme.time_step, scheme.steps)
    except SceneError as error:
        shown(error)
        return
    positive = [scheme.time_step, scheme.limit, scheme.load_scale, scheme.surface_density, scheme.kappa]
    assert np.isfinite(positive).all()
    assert min(positive) > 0
    assert scheme.time_step <= scheme.limit * (1 + 1e-9)
    if scheme.bending is not None:
        fields += [getattr(scheme.bending, name) for name in ("bend_xx", "bend_xy", "bend_yy", "twist", "spring")]
    assert all(np.isfinite(field).all() for field in fields)


@pytest.mark.slow
def test_every_number_at_its_ends():
    """Each number of each table in turn, with all other tables there and with none of the optional ones."""
    for way in leaves(WHOLE):
        if isinstance(item(WHOLE, way), (bool, str)):
            continue
        for value in NUMBERS:
            for without in (OPTIONAL, [table for table in OPTIONAL if table != way[: len(table)]]):
                goes_on(read(changed(way, value, without)))


def test_every_value_of_another_kind():
    """Each value, list and table in turn replaced by things of every other kind, and left out, with none of the other
    optional tables."""
    ways = {way[:length] for way in leaves(WHOLE) for length in range(1, len(way) + 1)}
    for way in sorted(ways, key=str):
        without = [table for table in OPTIONAL if table != way[: len(table)]]
        for value in KINDS:
            read(changed(way, value, without))
        tables = changed(way, 0.0, without)
        del item(tables, way[:-1])[way[-1]]
        read(tables)


def factors():
    return st.integers(-12, 12).map(lambda power: 10.0**power) | st.floats(1e-40, 1e40)


@st.composite
def scenes(draw):
    """WHOLE without some tables, with up to four values changed: scaled, or replaced by anything."""
    tables = changed(("title",), draw(st.text(max_size=5)), draw(st.sets(st.sampled_from(OPTIONAL))))
    for _ in range(draw(st.integers(1, 4))):
        way = draw(st.sampled_from(list(leaves(tables))))
        parent, value = item(tables, way[:-1]), item(tables, way)
        if isinstance(value, float) and draw(st.booleans()):
            parent[way[-1]] = value * draw(factors())
        else:
            anything = st.sampled_from(NUMBERS + KINDS) | st.floats() | st.integers() | st.text(max_size=5)
            parent[way[-1]] = copy.deepcopy(draw(anything))
    return tables


@settings(max_examples=150)
@given(scenes())
def test_any_scene_goes_on_or_is_refused(tables):
    goes_on(read(tables))


@pytest.mark.slow
@settings(max_examples=300, suppress_health_check=[HealthCheck.too_slow])
@given(scenes())
def test_very_many_scenes_go_on_or_are_refused(tables):
    goes_on(read(tables))


def runs_right(tables):
    """What a scene's plate does is what the reference in NumPy says, to round-off; or the scene is refused."""
    scene = read(tables)
    if scene is None:
        return
    drives = np.array([[1, 0.5j], [0.2, -1.0]])
    try:
        step, steps = make_scheme(scene).time_step, make_scheme(scene).steps
        if steps > 2000:
            return
        run = PlateSolver(scene, "cpu").run(drives, (scene.window.end,))
    except SceneError as error:
        shown(error)
        return
    # A bed without stiffness changes nothing, and has the reference for plates with effects.
    effects = {"foundation": {"stiffness": 0.0}, **scene.effects.model_dump(exclude_none=True)}
    same = scene.with_tables(grid={**scene.grid.model_dump(), "time_step": step}, effects=effects)
    tolerance = 1e-7 if scene.grid.precision == "float64" else 5e-3
    assert run.finite.all()
    np.testing.assert_allclose(run.energy, run_general(same, drives).energy, rtol=tolerance)


@st.composite
def scaled(draw, effects):
    """A scene that can be run, some of its numbers many orders larger or smaller."""
    tables = changed(("grid", "precision"), draw(st.sampled_from(["float32", "float64"])), OPTIONAL[2:5])
    tables["effects"] = {name: tables["effects"][name] for name in effects}
    del tables["actuators"][0]["frequency"]
    if effects == ["damping"]:
        tables["edges"] = {"left": "clamped", "top": "supported", "right": "supported"}
    ways = [way for way in leaves(tables) if isinstance(item(tables, way), float)]
    for way in draw(st.lists(st.sampled_from(ways), min_size=1, max_size=3)):
        item(tables, way[:-1])[way[-1]] *= 10.0 ** draw(st.integers(-28, 28) | st.floats(-3, 3))
    return tables


@settings(max_examples=40)
@given(scaled(["damping"]))
def test_any_plain_scene_runs_right_or_is_refused(tables):
    runs_right(tables)


@pytest.mark.slow
@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow])
@given(scaled(["damping", "material_damping", "tension", "foundation", "layers", "oscillators", "orthotropic"]))
def test_any_scene_with_effects_runs_right_or_is_refused(tables):
    runs_right(tables)


PAPER = preset_text("paper")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (PAPER.replace("density = 1000.0", "density = " + "9" * 5000), "not TOML"),
        (PAPER.replace("density = 1000.0", "density = 0x" + "f" * 8000), "plate.density = what is too large"),
        (PAPER.replace("density = 1000.0", "density = 1" + "_0" * 100_000), "not TOML"),
        ("a = " + "[" * 100_000, "nested too deeply"),
        ("a = " + "{a=" * 2000, "nested too deeply"),
        (".".join(["a"] * 100_000) + " = 1", "ten parts"),
        ("[" + " . ".join(["a"] * 100_000) + "]", "ten parts"),
        ("a = {" + ".".join(["a"] * 100_000) + " = 1}", "ten parts"),
        (PAPER.replace("[plate]", "[plate]\n" + "thickness" * 10_000 + " = 1"), "plate.thicknessthick"),
        (PAPER + "\n".join(f"[[actuators]]\nname = '{n}'\narea = []" for n in range(5000)), "more)"),
        ("a = " + '"' * 100_000, "not TOML"),
        ("#" * 1_000_000, "plate: is missing"),
    ],
    ids=range(12),
)
def test_bombs_are_refused(text, why):
    with pytest.raises(SceneError) as caught:
        Scene.parse(text, "bomb.toml")
    shown(caught.value)
    assert why in str(caught.value)


def test_texts_may_hold_what_keys_may_not():
    """Dots in a title, in comments and in numbers are no deep keys."""
    title = "a.b.c.d.e.f.g.h.i.j.k.l"
    text = f"# {title}\ntitle = '{title}'\n" + "\n".join(PAPER.partition("[plate]")[1:])
    assert Scene.parse(text, "").title == title


def test_a_scene_file_cut_or_changed_anywhere():
    """At every length, and with every byte changed: a scene that is checked as any other, or one line."""
    content = PAPER.encode()
    texts = [content[:length] for length in range(len(content))]
    for place, byte in enumerate(content):
        texts.append(content[:place] + bytes([byte ^ 1 << place % 7]) + content[place + 1 :])
    for text in texts:
        try:
            scene = Scene.parse(text.decode(errors="replace"), "paper.toml")
        except SceneError as error:
            shown(error)
        else:
            assert Scene.parse(dump_scene(scene), "") == scene


@pytest.mark.parametrize("name", ["my panel.toml", "Größe ü.toml", "[red].toml", "a;b&c.toml", "-x.toml", "a\nb.toml"])
def test_any_file_name_will_do(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(PAPER, encoding="utf-8")
    assert Scene.load(name) == Scene.load("paper")
    (tmp_path / name).write_text("x = 1", encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        Scene.load(name)
    shown(caught.value)


@pytest.mark.parametrize("name", ["x" * 5000, "a\0b", "\ud800", "/dev/null", "/dev/zero", ".", "paper.toml/x", "*"])
def test_what_is_no_file_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paper.toml").write_text(PAPER, encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        Scene.load(name)
    assert str(caught.value).isprintable()


def test_a_file_that_is_no_scene_for_its_size_is_not_read(tmp_path):
    path = tmp_path / "video.toml"
    with path.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(SceneError, match=f"{MOST_BYTES + 1} bytes"):
        Scene.load(path)


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        ({"nodes": (1025, 1025)}, "grid.nodes = [1025, 1025] with 3 actuators: takes about"),
        ({"nodes": (257, 257), "record": {"times": (0.01,) * 5000}}, "and 5000 record.times"),
        ({"window": (0.0, 30.0), "record": {"points": ((0.1, 0.1),) * 50}}, "window.end = 30"),
        ({"nodes": (129, 129), "effects": {"tension": {"x": -1e-3}}}, "grid.nodes = [129, 129]"),
    ],
)
def test_what_memory_does_not_hold_is_refused_before_it_is_taken(tables, what, scene, monkeypatch):
    made = scene(**tables)
    monkeypatch.setattr(memory, "machine_memory", lambda: 2.0**26)
    with pytest.raises(SceneError) as caught:
        PlateSolver(made, "cpu")
    assert what in str(caught.value)
    assert "GiB of memory" in str(caught.value)
