"""Random scenes: each is accepted and gives correct results, or is refused with one printable line."""

import copy
import math
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from support.commands import is_printable
from support.numpy_plate import run_moment_form
from support.scenes import PAPER, refused
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.plate import memory
from warp_plate.plate.scheme import discretize, make_scheme
from warp_plate.plate.signals import make_signals
from warp_plate.plate.travelling import moving_weights
from warp_plate.plate.weights import patches, region_weights
from warp_plate.problem.objectives import make_objectives
from warp_plate.scene.load import parse_toml

ALL_KEYS = parse_toml((Path(__file__).parents[1] / "data" / "all_keys.toml").read_text(encoding="utf-8"), "")
OPTIONAL = [("edges",), ("record",), *(("drive", name) for name in ("burst", "chirp", "electrostatic"))]
OPTIONAL += [("effects", name) for name in ALL_KEYS["effects"]]
NUMBERS = [0, -1, 4, 0.0, -0.0, 5e-324, 1e-300, 1e-30, 1e-9, 1e9, 1e30, 1e300, -1e300, math.inf, -math.inf, math.nan]
KINDS = ["", "x", "[red]", "\x1b[31m", True, [], {}, [1.0], [[1.0]], {"a": 1.0}, [0.0] * 5, 2**63, 10**400]
QUOTED = re.compile(r"\"[^\"]*\"|'[^']*'")
# Words of Python and pydantic, which a user of TOML does not know.
PYTHON_WORDS = re.compile(r"\b(tuple|dict\w*|instance|validation|[Ii]nput|string|integer|bool\w*|True|None)\b")
LARGEST_GRID, LONGEST_RUN = 40_000, 20_000


def leaf_paths(value, path=()):
    """Yield the path of keys and indices to every number, text and truth value."""
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaf_paths(item, (*path, key))
    else:
        yield path


def item(tables, path):
    for key in path:
        tables = tables[key]
    return tables


def changed(path, value, without=()):
    """Return ALL_KEYS with another value at a path, and without some of its tables."""
    tables = copy.deepcopy(ALL_KEYS)
    for table in without:
        del item(tables, table[:-1])[table[-1]]
    with suppress(KeyError, IndexError, TypeError):  # the path may lead through a removed table
        item(tables, path[:-1])[path[-1]] = copy.deepcopy(value)
    return tables


def read(tables):
    """Return the scene of the tables, or None if they are refused in one printable line."""
    try:
        scene = Scene.from_tables(tables)
    except SceneError as error:
        check_line(error)
        return None
    assert Scene.parse(scene.to_toml(), "") == scene
    return scene


def check_line(error):
    assert is_printable(str(error))
    own_words = QUOTED.sub("", str(error))  # a scene may say "None" itself
    assert "not TOML" in own_words or not PYTHON_WORDS.search(own_words)
    assert len(str(error)) < 600


def check_arrays(scene):
    """Check that everything derived from a scene before time stepping is finite, or refused in one line."""
    if scene is None or math.prod(scene.grid.nodes) > LARGEST_GRID:
        return
    try:
        scheme = make_scheme(scene)
        objectives = make_objectives(discretize(scene))
        fields = [patches(scene), region_weights(scene, {target.name: target for target in scene.targets[1:]})]
        fields += [objectives.sizes.areas, objectives.sizes.masses, objectives.sizes.cells]
        if scheme.steps <= LONGEST_RUN:
            signals = make_signals(scene, scheme.time_step, scheme.steps)
            fields += [signals.wave, signals.mixing]
            if scene.effects.moving_load is not None:
                fields += moving_weights(scene, scheme.time_step, scheme.steps)
    except SceneError as error:
        check_line(error)
        return
    positive = [scheme.time_step, scheme.limit, scheme.load_scale, scheme.surface_density, scheme.kappa]
    assert np.isfinite(positive).all()
    assert min(positive) > 0
    assert scheme.time_step <= scheme.limit * (1 + 1e-9)
    if scheme.bending is not None:
        fields += [getattr(scheme.bending, name) for name in ("bend_xx", "bend_xy", "bend_yy", "twist", "spring")]
    assert all(np.isfinite(field).all() for field in fields)


def test_keys_that_are_no_modes_are_named():
    line = refused(Scene.from_tables, changed(("design", "limits"), {"modes": {"0": [1.0, 2.0]}}))
    assert line == 'design.limits.modes.0 = "0": must be the number of a mode, from 1 to 999'


def test_values_of_other_kinds_and_extreme_numbers():
    """Each value, list and table in turn replaced by values of other kinds, and left out, without optional tables."""
    paths = {path[:length] for path in leaf_paths(ALL_KEYS) for length in range(1, len(path) + 1)}
    for index, path in enumerate(sorted(paths, key=str)):
        without = [table for table in OPTIONAL if table != path[: len(table)]]
        # All kinds, not all pairs of path and kind; arrays for every other path.
        read(changed(path, KINDS[index % len(KINDS)], without))
        scene = read(changed(path, NUMBERS[index % len(NUMBERS)], without))
        if index % 2:
            check_arrays(scene)
        tables = changed(path, 0.0, without)
        del item(tables, path[:-1])[path[-1]]
        read(tables)


@st.composite
def scenes(draw):
    """Draw ALL_KEYS without some tables, with up to four values scaled or replaced by anything."""
    tables = changed(("title",), draw(st.text(max_size=5)), draw(st.sets(st.sampled_from(OPTIONAL))))
    for _ in range(draw(st.integers(1, 4))):
        path = draw(st.sampled_from(list(leaf_paths(tables))))
        parent, value = item(tables, path[:-1]), item(tables, path)
        if isinstance(value, float) and draw(st.booleans()):
            parent[path[-1]] = value * draw(
                st.integers(-12, 12).map(lambda power: 10.0**power) | st.floats(1e-40, 1e40)
            )
        else:
            anything = st.sampled_from(NUMBERS + KINDS) | st.floats() | st.integers() | st.text(max_size=5)
            parent[path[-1]] = copy.deepcopy(draw(anything))
    return tables


@settings(max_examples=40)
@given(scenes())
def test_any_scene_gives_finite_arrays_or_is_refused(tables):
    check_arrays(read(tables))


def check_run(tables):
    """Check that a scene is refused, or that its energies equal those of the NumPy reference up to rounding."""
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
        check_line(error)
        return
    # A foundation without stiffness changes nothing but selects the reference for plates with effects.
    effects = {"foundation": {"stiffness": 0.0}, **scene.effects.model_dump(exclude_none=True)}
    same = scene.with_tables(grid={**scene.grid.model_dump(), "time_step": step}, effects=effects)
    tolerance = 1e-7 if scene.grid.precision == "float64" else 5e-3
    assert run.finite.all()
    np.testing.assert_allclose(run.energy, run_moment_form(same, drives).energy, rtol=tolerance)


@st.composite
def scaled(draw, effects):
    """Draw a scene that can be run, with some of its numbers scaled by many orders of magnitude."""
    tables = changed(("grid", "precision"), draw(st.sampled_from(["float32", "float64"])), OPTIONAL[2:5])
    tables["effects"] = {name: tables["effects"][name] for name in effects}
    del tables["actuators"][0]["frequency"]
    if effects == ["damping"]:
        tables["edges"] = {"left": "clamped", "top": "supported", "right": "supported"}
    paths = [path for path in leaf_paths(tables) if isinstance(item(tables, path), float)]
    for path in draw(st.lists(st.sampled_from(paths), min_size=1, max_size=3)):
        item(tables, path[:-1])[path[-1]] *= 10.0 ** draw(st.integers(-28, 28) | st.floats(-3, 3))
    return tables


@settings(max_examples=20)
@given(scaled(["damping"]))
def test_any_plain_scene_runs_correctly_or_is_refused(tables):
    check_run(tables)


@pytest.mark.slow
@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow])
@given(scaled(["damping", "material_damping", "tension", "foundation", "layers", "oscillators", "orthotropic"]))
def test_any_scene_with_effects_runs_correctly_or_is_refused(tables):
    check_run(tables)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (PAPER.replace("density = 1000.0", "density = " + "9" * 5000), "not TOML"),
        (PAPER.replace("density = 1000.0", "density = 0x" + "f" * 8000), "plate.density = "),
        ("a = " + "[" * 100_000, "nested"),
        (".".join(["a"] * 100_000) + " = 1", "ten parts"),
        ("[" + " . ".join(["a"] * 100_000) + "]", "ten parts"),
        (PAPER.replace("[plate]", "[plate]\n" + "thickness" * 10_000 + " = 1"), "plate.thicknessthick"),
        (PAPER + "\n".join(f"[[actuators]]\nname = '{n}'\narea = []" for n in range(1000)), "more)"),
    ],
    ids=range(7),
)
def test_huge_texts_are_refused(text, why):
    line = refused(Scene.parse, text, "bomb.toml")
    check_line(line)
    assert why in line


@pytest.mark.parametrize(("stiff", "soft"), [("Dy", "Dx"), ("Dx", "Dy"), ("Dxy", "Dx")])
def test_a_rigidity_that_hides_another_is_named(stiff, soft):
    """Such a plate with free edges was refused for springs that it has not."""
    rows = {"Dx": 2.0, "Dy": 3.0 if stiff != "Dx" else 2.0, "D1": 0.5, "Dxy": 4.0, stiff: 1e20}
    table = "".join(f"{key} = {value}\n" for key, value in rows.items())
    why = f"effects.orthotropic.{stiff}: 1e+20 N·m hides {soft} = 2 N·m in rounding; write at most 2e+09"
    assert why in refused(Scene.parse, f"{PAPER}\n[effects.orthotropic]\n{table}", "panel.toml")


def test_truncated_and_corrupted_files():
    """Cut at every thirtieth length, and with every fifteenth byte changed: a valid scene, or one line."""
    content = PAPER.encode()
    texts = [content[:length] for length in range(0, len(content), 30)]
    for place in range(0, len(content), 15):
        texts.append(content[:place] + bytes([content[place] ^ 1 << place % 7]) + content[place + 1 :])
    for text in texts:
        try:
            scene = Scene.parse(text.decode(errors="replace"), "paper.toml")
        except SceneError as error:
            check_line(error)
        else:
            assert Scene.parse(scene.to_toml(), "") == scene


def test_any_file_name_is_accepted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("my panel.toml", "Größe ü.toml", "[red].toml", "-x.toml", "a\nb.toml"):
        Path(name).write_text(PAPER, encoding="utf-8")
        assert Scene.load(name) == Scene.load("paper")
        Path(name).write_text("x = 1", encoding="utf-8")
        check_line(refused(Scene.load, name))
    for name in ("x" * 5000, "a\0b", "\ud800", "/dev/zero", "", "no/such.toml", str(tmp_path), "-x.toml/x", "*"):
        assert refused(Scene.load, name).isprintable()


def test_huge_files_are_not_read(tmp_path):
    with (tmp_path / "video.toml").open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(SceneError, match=f"{2**30} bytes"):
        Scene.load(tmp_path / "video.toml")


# Each has a best drive, whose records are kept.
TARGETS = [{"name": str(number), "area": (0.0, 0.1, 0.0, 0.1)} for number in range(32)]


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        ({"nodes": (1025, 1025)}, "grid.nodes = [1025, 1025] with 3 actuators: takes about"),
        ({"nodes": (257, 257), "record": {"times": (0.01,) * 5000}}, "and 5000 record.times"),
        ({"nodes": (65, 65), "record": {"times": (0.01,) * 100}, "targets": TARGETS}, "and 100 record.times"),
        ({"window": (0.0, 30.0), "record": {"points": ((0.1, 0.1),) * 50}}, "window.end = 30"),
        ({"nodes": (129, 129), "effects": {"tension": {"x": -1e-3}}}, "grid.nodes = [129, 129]"),
    ],
)
def test_scenes_beyond_the_memory_are_refused(tables, what, scene, monkeypatch):
    made = scene(**tables)
    monkeypatch.setattr(memory, "machine_memory", lambda: 2.0**26)
    line = refused(PlateSolver, made, "cpu")
    assert what in line
    assert "GiB of memory" in line
