"""Designed panels: maps within their limits, slopes against differences, and searches that never make a panel worse."""

import json
from contextlib import nullcontext
from itertools import pairwise
from unittest.mock import Mock

import numpy as np
import pytest

import warp_plate as wpl
from support.designs import errors_of_slopes
from support.scenes import MATERIAL, scene_of
from warp_plate.designing.design import _digest
from warp_plate.designing.panel import FreePanel
from warp_plate.designing.thickness import ThicknessMap
from warp_plate.modal.solver import ModalSolver

THICKNESS = {"range": [3.5e-4, 7.5e-4], "length_scale": 0.1, "mass": 1.0}
LAYER = {"area": (0.02, 0.12, 0.05, 0.08), "thickness": 1e-4, "young_modulus": 2e9, "density": 1800.0}
OSCILLATOR = {"area": (0.12, 0.14, 0.1, 0.12), "mass": 2e-3, "stiffness": 3e3, "damping": 0.5}
FREE = {
    "effects.layers[0].thickness": [5e-5, 2e-4],
    "effects.oscillators[0].mass": [1e-3, 4e-3],
    "effects.oscillators[0].stiffness": [1e3, 6e3],
    "effects.oscillators[0].damping": [0.1, 1.0],
    "edges.right.translation": [1e4, 1e6],
}
PROPERTIES = {
    "plate.poisson_ratio": [0.2, 0.4],
    "effects.layers[0].density": [1000.0, 3000.0],
    "effects.damping.viscous": [30.0, 90.0],
    "effects.foundation.stiffness": [1e3, 1e6],
    "edges.right.translation": [1e4, 1e6],
    "alike": [1e-3, 4e-3],
}
PLACES = {"effects.oscillators[0]": [0.1, 0.18, 0.02, 0.18], "actuators[1]": [0.1, 0.2, 0.0, 0.1]}


def designed_scene(design, **tables):
    return scene_of(damping=60.0, window=(0.01, 0.03), modal_density=0.5, design=design, **tables)


@pytest.mark.parametrize("symmetry", ["none", "x", "both"])
def test_maps_keep_range_mass_and_symmetry(symmetry, random):
    free = {**THICKNESS, "length_scale": 0.04, "symmetry": symmetry}
    thickness = ThicknessMap(designed_scene({"thickness": free}))
    rows, columns = thickness.shape
    assert (rows, columns) == (11, 11)
    ends = np.ones(rows)
    ends[[0, -1]] = 0.5
    shares = np.outer(ends, ends) / np.outer(ends, ends).sum()  # the trapezoidal rule is exact for the hats
    for _ in range(20):
        factors = thickness.factors(random.random(thickness.count) ** random.choice([0.1, 1, 10]))
        assert 0.7 <= factors.min() < factors.max() <= 1.5
        assert (shares * factors).sum() == pytest.approx(1, abs=1e-9)
        assert symmetry == "none" or factors == pytest.approx(factors[:, ::-1])
        assert symmetry != "both" or factors == pytest.approx(factors[::-1])


def test_the_filter_spreads_a_point_over_its_length():
    thickness = ThicknessMap(designed_scene({"thickness": {"range": [3.5e-4, 7.5e-4], "length_scale": 0.04}}))
    numbers = np.full(thickness.count, 0.5)
    numbers[5 * 11 + 5] = 1.0
    changed = np.abs(thickness.factors(numbers) - 1.1) > 1e-9
    x = np.linspace(0, 0.2, 11) - 0.1
    assert (changed == (np.hypot(*np.meshgrid(x, x)) < 0.04 - 1e-9)).all()


def test_slopes_of_a_map_are_those_of_differences(random):
    thickness = ThicknessMap(designed_scene({"thickness": THICKNESS}))
    numbers, direction = random.random((2, thickness.count))
    weights = random.normal(size=thickness.shape)
    near, far = ((weights * thickness.factors(numbers + sign * 1e-5 * direction)).sum() for sign in (1, -1))
    assert thickness.slopes(numbers, weights) @ direction == pytest.approx((near - far) / 2e-5, rel=1e-6)


@pytest.mark.parametrize(
    "design",
    [
        {"thickness": THICKNESS, "tolerance": {"plate.thickness": 0.05}},
        {"thickness": THICKNESS, "objective": "drive"},
        {"thickness": THICKNESS, "objective": "velocity"},
        {"free": {**FREE}, "objective": "displacement", "effort": "drive"},
        {"thickness": THICKNESS, "objective": "velocity", "effort": "sound", "steady": True},
        pytest.param({"free": FREE}, marks=pytest.mark.slow),
        pytest.param({"free": PROPERTIES, "tolerance": {"plate.density": 0.1}}, marks=pytest.mark.slow),
        {"free": {"plate.thickness": [4e-4, 6e-4], "plate.density": [800.0, 1200.0]}},
        pytest.param({"places": PLACES, "frequencies": [270.0, 310.0]}, marks=pytest.mark.slow),
    ],
    ids=["tolerance", "drive", "velocity", "displacement", "sound", "numbers", "properties", "targets", "places"],
)
def test_slopes_of_a_panel_are_those_of_differences(design, random):
    edges = ("clamped", "clamped", {"translation": 1e5}, "supported")
    lattice = {**OSCILLATOR, "area": (0.03, 0.05, 0.12, 0.14), "lattice": (2, 2), "pitch": (0.05, 0.03)}
    oscillators = [OSCILLATOR, lattice] if "alike" in design.get("free", {}) else [OSCILLATOR]
    effects = {"layers": [LAYER], "oscillators": oscillators, "foundation": {"stiffness": 1e5}}
    patched = {"effects": {**effects, "damping": {"viscous": 60.0}}, "edges": edges, "frequency": 120.0}
    if "plate.thickness" in design.get("free", {}):
        patched["effects"] = {"layers": [LAYER], "oscillators": [OSCILLATOR], "damping": {"viscous": 60.0}}
        areas = (0.0, 0.1, 0.0, 0.1), (0.1, 0.2, 0.05, 0.2)
        patched["targets"] = [{"name": str(index), "area": area} for index, area in enumerate(areas)]
    if "alike" in design.get("free", {}):
        keys = ["effects.oscillators[0].mass", "effects.oscillators[1].mass"]
        patched |= {"links": {"alike": {"keys": keys}}, "target": {"disc": (0.13, 0.11, 0.03)}}
    panel = FreePanel(designed_scene(design, **({} if "thickness" in design else patched)))
    numbers = 0.3 + 0.4 * random.random(panel.count)
    slopes = panel.evaluate(numbers).slopes
    direction = random.normal(size=panel.count)
    near, far = (
        (panel.evaluate(numbers + step * direction).smooth - panel.evaluate(numbers - step * direction).smooth)
        / (2 * step)
        for step in (1e-3, 2e-3)
    )
    assert slopes @ direction == pytest.approx((4 * near - far) / 3, abs=1e-5 * abs(slopes).max())


@pytest.mark.slow
def test_a_design_raises_the_bound_and_goes_on_from_its_file(tmp_path):
    scene = designed_scene({"thickness": THICKNESS, "starts": 2, "iterations": 3, "seed": 3})
    file = tmp_path / "starts.json"
    whole = wpl.design(scene, unfinished=file, check=False)
    assert len(json.loads(file.read_text())["starts"]) == 2
    file.unlink()
    assert whole.improved
    assert whole.after.value == whole.after.bound > whole.before.bound + 0.05
    assert whole.after.bound == pytest.approx(ModalSolver(whole.scene, "cpu").response.bound())
    assert all(early <= late for values in whole.history for early, late in pairwise(values))

    def stop(done, total, note):
        if note.startswith("start 2"):
            raise KeyboardInterrupt

    first = wpl.design(scene, stop, file)
    assert first.interrupted
    assert len(json.loads(file.read_text())["starts"]) == 1
    assert first.before.bound <= first.after.bound <= whole.after.bound
    second = wpl.design(scene, unfinished=file, check=False)
    assert second.history == whole.history
    assert (second.thickness == whole.thickness).all()


START = {"numbers": [0.5], "least": 0.4, "history": [0.4], "evaluations": 3}


@pytest.mark.parametrize(
    "change",
    [
        {"numbers": [5.0]}, {"numbers": 0.5}, {"least": float("inf")}, {"history": [[]]}, {"evaluations": None},
        {"others": 1},
    ],
)  # fmt: skip
def test_forged_files_of_finished_starts_are_refused(change, tmp_path):
    """Numbers outside the ranges would break the limits of all panels."""
    free = {"effects.layers[0].thickness": FREE["effects.layers[0].thickness"]}
    effects = {"loss_factor": {"eta": 0.02}, "layers": [LAYER]}
    scene = scene_of(modal_density=0.5, effects=effects, design={"free": free, "starts": 1})
    file = tmp_path / "starts.json"
    texts = [json.dumps({"design": _digest(scene), "starts": [{**START, **change}]}), '{"design": ' + "[" * 9999]
    for text in texts:
        file.write_text(text)
        with pytest.raises(wpl.SceneError, match="is no unfinished design of this version; delete it"):
            wpl.design(scene, unfinished=file)


COIL = {
    "kind": "coil", "force_factor": 2.0, "resistance": 4.0, "moving_mass": 1e-3, "suspension_stiffness": 500.0,
    "suspension_damping": 0.1, "magnet": "free", "magnet_mass": 0.02,
}  # fmt: skip
ROUND = {"plate": {**MATERIAL, "outline": {"disc": (0.1, 0.1, 0.1)}}, "edges": {"outline": {"translation": 1e5}}}
DISCS = [{"name": str(index), "disc": (0.07 + 0.05 * index, 0.1, 0.012)} for index in range(2)]
COILS = [{**row, **COIL, source: 1.0} for row, source in zip(DISCS, ("voltage", "current"), strict=True)]
OF_COILS = {
    "actuators[0].force_factor": [1.0, 3.0],
    "actuators[1].moving_mass": [5e-4, 2e-3],
    "actuators[1].magnet_mass": [0.01, 0.05],
    "edges.outline.translation": [1e4, 1e6],
}
HELD = {
    "supports": [{"point": (0.13, 0.12), "stiffness": 1e4}, {"line": ((0.05, 0.05), (0.05, 0.15)), "stiffness": 1e4}]
}
OTHERS = {
    "map of a disc": {**ROUND, "actuators": DISCS, "design": {"thickness": THICKNESS}},
    "coils": {
        **ROUND,
        "actuators": COILS,
        "effects": {"damping": {"viscous": 60.0}, "air": {"sides": "front"}},
        "design": {
            "free": OF_COILS,
            "places": {"actuators[0]": [0.04, 0.1, 0.05, 0.15]},
            "objective": "velocity",
            "effort": "power",
            "limits": {"sound": 40.0, "power": 0.01, "mass": 0.05},
        },
    },
    "supports": {
        **HELD,
        "design": {
            "free": {"supports[0].stiffness": [1e3, 1e5], "supports[1].stiffness": [1e3, 1e5]},
            "thickness": {**THICKNESS, "mass": None},
            "limits": {"mass": 0.019},
        },
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHERS)
def test_slopes_of_other_panels_are_those_of_differences(name, random):
    base = designed_scene(None).model_dump(mode="json", exclude_none=True)
    panel = FreePanel(wpl.Scene.model_validate({**base, **OTHERS[name]}))
    numbers, direction = 0.3 + 0.4 * random.random(panel.count), random.normal(size=panel.count)
    errors, sizes = errors_of_slopes(panel, numbers, direction, 5e-4, "smooth")
    assert (errors <= 2e-6 * sizes).all()


def test_slopes_know_the_stiffest_motions(random):
    """Of a free strip, which narrow patches bend. The stiffest have a part of 1e-9 of the flexibility of the softest,
    and of the slopes a part of some 1e-6."""
    design = {"thickness": {"range": [2e-4, 1.5e-3], "length_scale": 0.05}, "steady": True, "objective": "velocity"}
    effects = {"loss_factor": {"eta": 0.02}, "oscillators": [{**OSCILLATOR, "area": (0.05, 0.09, 0.01, 0.02)}]}
    tables = {"actuators": [(0.05, 0.052, 0.01, 0.012), (0.15, 0.152, 0.02, 0.021)], "effects": effects}
    panel = FreePanel(scene_of(size=(0.3, 0.03), edges=("free",) * 4, design=design, **tables))
    numbers, direction = 0.3 + 0.4 * random.random(panel.count), random.normal(size=panel.count)
    errors, sizes = errors_of_slopes(panel, numbers, direction / np.linalg.norm(direction), 2e-3, "smooth")
    assert (errors <= 2e-8 * sizes).all()


def test_rounding_of_rigid_motions_does_not_refuse_maps_of_narrow_plates(random):
    design = {"thickness": {"range": [2.5e-4, 7.5e-4], "length_scale": 0.4}}
    narrow = designed_scene(design, size=(0.4, 0.01)).model_dump(mode="json", exclude_none=True)
    plate, edges = {**MATERIAL, "outline": {"rectangle": (0.4, 0.01)}}, {"outline": "free"}
    panel = FreePanel(wpl.Scene.model_validate({**narrow, "plate": plate, "edges": edges}))
    bounds = [panel.evaluate(panel.draw(random), sloped=False).least for _ in range(4)]
    assert (np.array(bounds) > 0).all()


LIMITS = {"mass": 0.03, "energy_target": 1e-9, "gap": [200.0, 330.0]}


@pytest.mark.parametrize(
    "free",
    [{"thickness": {**THICKNESS, "mass": None}}, pytest.param({"free": FREE}, marks=pytest.mark.slow)],
    ids=["map", "numbers"],
)
def test_slopes_of_limits_are_those_of_differences(free, random):
    patched = {"layers": [LAYER], "oscillators": [OSCILLATOR], "damping": {"viscous": 60.0}}
    effects = {"effects": patched, "edges": ("clamped", "clamped", {"translation": 1e5}, "supported")}
    effects["frequency"] = 120.0
    design = {**free, "limits": LIMITS, "objective": "energy_target"}
    panel = FreePanel(designed_scene(design, **(effects if "free" in free else {})))
    numbers, direction = 0.3 + 0.4 * random.random(panel.count), random.normal(size=panel.count)
    panel.follow(numbers)
    assert len(panel.evaluate(numbers).excess) == 4
    errors, sizes = errors_of_slopes(panel, numbers, direction, 2e-4, "least")
    assert errors.max() <= 1e-5 * sizes.max()
    assert (errors <= 1e-4 * sizes + 1e-9).all()


def symmetric_panel(frequency, **design):
    """Return a square panel on four equal springs, of which that of the left edge is free."""
    actuators = [(x, x + 0.012, y, y + 0.012) for x in (0.03, 0.158) for y in (0.03, 0.158)]
    free = {"free": {"edges.left.translation": [5e4, 1.5e5]}, **design}
    edges, target = ({"translation": 1e5},) * 4, {"area": (0.05, 0.15, 0.05, 0.15)}
    tables = {"window": (0.01, 0.03), "modal_density": 0.4, "damping": 60.0, "actuators": actuators, "target": target}
    return FreePanel(scene_of(edges=edges, frequency=frequency, design=free, **tables))


def test_slopes_of_a_repeated_bound_lie_between_those_of_both_sides():
    """At 240 Hz drives that are odd along x and odd along y reach the same bound, and one spring parts them."""
    panel, step = symmetric_panel(240.0), 1e-4
    below, here, above = (panel.evaluate(np.array([0.5 + sign * step])) for sign in (-1, 0, 1))
    left, right = (here.least - below.least) / step, (above.least - here.least) / step
    assert right - left > 5e-4
    assert left - 1e-6 <= here.slopes[0] <= right + 1e-6


def test_equal_natural_frequencies_have_slopes_together():
    """The second and the third mode of the square panel are equal; their aggregate is smooth, each of them is not."""
    natural = wpl.modes(symmetric_panel(240.0).scene, 3).frequencies
    assert natural[1] == pytest.approx(natural[2], rel=1e-9)
    panel, numbers, step = symmetric_panel(240.0, limits={"gap": [natural[2], 2 * natural[2]]}), np.array([0.5]), 1e-3
    panel.below = 3
    below, here, above = (panel.evaluate(numbers + sign * step) for sign in (-1, 0, 1))
    assert here.excess_slopes[0] == pytest.approx((above.excess[0] - below.excess[0]) / (2 * step), rel=1e-4)
    one_sided = (here.excess[0] - below.excess[0]) / step, (above.excess[0] - here.excess[0]) / step
    assert one_sided[0] == pytest.approx(one_sided[1], rel=0.1)


@pytest.mark.slow
def test_limits_are_kept(random):
    free = {"thickness": {**THICKNESS, "mass": None}, "starts": 1, "iterations": 12}
    scene = designed_scene({**free, "limits": {"mass": 0.0205, "gap": [44.9, 66.5]}})
    panel = wpl.design(scene)
    mass = 1000.0 * 0.2 * 0.2 * (panel.thickness * shares_of(panel.thickness.shape)).sum()
    assert mass <= 0.0205 * (1 + 1e-6)
    natural = wpl.modes(panel.scene, 12).frequencies
    assert not ((natural > 44.9 * (1 + 1e-6)) & (natural < 66.5 * (1 - 1e-6))).any()
    assert panel.after.kept
    assert panel.check.agrees
    assert panel.check.error < 0.05
    assert panel.before.excess["gap"] > 1e-3
    assert panel.after.value > panel.before.value


def shares_of(shape):
    """Return the shares of the numbers of a map in the mass, those of the trapezoidal rule."""
    ends = [np.full(count, 1.0) for count in shape]
    for along in ends:
        along[[0, -1]] = 0.5
    return np.outer(*ends) / np.outer(*ends).sum()


def test_ctrl_c_after_the_search_keeps_the_starts(monkeypatch, tmp_path):
    scene, file = designed_scene({"thickness": THICKNESS, "starts": 1, "iterations": 1}), tmp_path / "starts.json"
    exact = FreePanel.exact

    def interrupted(*given):
        if file.exists():
            raise KeyboardInterrupt
        return exact(*given)

    with monkeypatch.context() as late:
        late.setattr(FreePanel, "exact", interrupted)
        with pytest.raises(KeyboardInterrupt):
            wpl.design(scene, unfinished=file)
    monkeypatch.setattr("warp_plate.designing.design._climb", None)
    assert len(wpl.design(scene, unfinished=file).history) == 1


def test_starts_of_another_design_are_not_replaced_without_a_word(tmp_path, caplog):
    file = tmp_path / "starts.json"
    file.write_text('{"design": "another", "starts": []}')
    scene = designed_scene({"thickness": THICKNESS, "starts": 1, "iterations": 1})
    assert len(wpl.design(scene, unfinished=file, check=False).history) == 1
    (line,) = caplog.messages
    assert line.startswith(f"{file} holds starts of another search or version")


def test_a_full_disk_does_not_end_a_design(monkeypatch, tmp_path, caplog):
    full = Mock(side_effect=wpl.SceneError("starts.json: cannot be written: No space left on device"))
    monkeypatch.setattr("warp_plate.designing.design.write_atomically", full)
    scene = designed_scene({"thickness": THICKNESS, "starts": 2, "iterations": 1})
    assert len(wpl.design(scene, unfinished=tmp_path / "starts.json").history) == 2
    assert caplog.messages == ["starts.json: cannot be written: No space left on device; continuing without"] * 2


def test_a_scene_without_better_panels_stays(monkeypatch):
    free = {**THICKNESS, "range": [4.999e-4, 5.001e-4]}
    scene = designed_scene({"thickness": free, "starts": 1, "iterations": 1})
    scene_at = FreePanel.scene_at
    monkeypatch.setattr(
        FreePanel, "scene_at", lambda *arguments: scene_at(*arguments).replace("effects.damping.viscous", 10.0)
    )
    panel = wpl.design(scene)
    assert not panel.improved
    assert panel.scene == scene.replace("design", None)
    assert panel.after == panel.before


@pytest.mark.parametrize(
    ("design", "message"),
    [
        (None, "design: is missing"),
        ({"thickness": {**THICKNESS, "mass": 2.0}}, r"design.thickness.mass: 2: the range allows 0.7 to 1.5"),
        ({"thickness": {**THICKNESS, "length_scale": 1e-4}}, "design.thickness.length_scale: 0.0001 m is too fine"),
        ({"places": {"actuators[0]": [0.0, 0.001, 0.0, 0.1]}}, r"design.places.actuators\[0\].*smaller than the patch"),
        ({"places": {"actuators[7]": [0.0, 0.1, 0.0, 0.1]}}, r"design.places: actuators\[7\]: is no patch"),
        ({"free": {"plate.thickness": [5e-4, 4e-4]}}, "free: plate.thickness = .*: the lowest value comes first"),
        ({"free": {"plate.thicknes": [4e-4, 5e-4]}}, "design.free: plate.thicknes: is not a key"),
        ({"free": {"plate.size[0]": [0.1, 0.3]}, "thickness": THICKNESS}, "not free beside a map of thickness"),
        ({"free": {"effects.oscillators[0].mass": [0.0, 0.3]}}, "a mass of 0 is fixed to the ground"),
        ({"free": {"effects.material_damping.time": [0.0, 0.3]}}, "losses of all bending are not known"),
        ({"free": {"actuators[0].magnitude": [0.0, 0.3]}}, "is a number of the drive, not of the panel"),
        ({}, "thickness: nothing is free"),
        (
            {"thickness": THICKNESS, "objective": "sound"},
            "design.objective: sound is that of a steady state",
        ),
        ({"thickness": THICKNESS, "limits": {"power": 0.1}}, "design.limits.power: power is that of a steady state"),
        (
            {"thickness": THICKNESS, "limits": {"gap": [1e-30, 1e30]}},
            r"^design.limits.gap = \[1e-30, 1e\+30\]: must end below \d+(\.\d)? Hz, up to which",
        ),
        ({"thickness": THICKNESS, "limits": {"gap": [300.0, 9e3]}}, "^design.limits.gap = .*: must end below"),
        ({"thickness": THICKNESS, "limits": {"modes": {"999": [9, 10]}}}, "^design.limits.modes: 999: must be at most"),
        ({"thickness": THICKNESS, "frequencies": [290, 1e5]}, "^design.frequencies: 100000 Hz: about .* modes"),
        (
            {"thickness": THICKNESS, "frequencies": [1e3], "tolerance": {"plate.thickness": 0.999}},
            "^design.tolerance: plate.thickness × 0.001: design.frequencies: 1000 Hz: about .* modes",
        ),
        (
            {"thickness": THICKNESS, "tolerance": {"plate.poisson_ratio": 0.99}},
            "^design.tolerance: plate.poisson_ratio × 1.99: plate.poisson_ratio = .*: must be less than 0.5",
        ),
        (
            {"free": {"plate.thickness": [1e-6, 2e-6]}, "starts": 1, "iterations": 1},
            "^design: a range reaches too far: drive.frequency: about .* modes",
        ),
        ({"thickness": THICKNESS, "effort": "drive"}, "effort: is of energy_target, .*, and not of bound; delete it"),
    ],
)
def test_what_cannot_be_designed_is_refused(design, message):
    effects = {"oscillators": [OSCILLATOR], "material_damping": {"time": 1e-6}}
    with pytest.raises((wpl.SceneError, ValueError), match=message):
        wpl.design(designed_scene(design, effects=effects))


@pytest.mark.parametrize("effects", [{}, {"damping": {"viscous": 60.0}}])
def test_power_is_no_effort_where_drives_need_none(effects):
    """Of a plate without damping and three drives: one of them is a coil, which alone takes energy from it."""
    actuators = [COILS[0], DISCS[1], {"name": "2", "disc": (0.1, 0.06, 0.012)}]
    design = {"free": {"plate.thickness": [4e-4, 6e-4]}, "objective": "velocity", "effort": "power", "steady": True}
    base = scene_of(modal_density=0.6, window=(0.03, 0.04)).model_dump(include={"target", "window", "drive", "grid"})
    tables = {**base, **ROUND, "actuators": actuators, "effects": effects, "design": design}
    panel = FreePanel(wpl.Scene.model_validate(tables))
    with nullcontext() if effects else pytest.raises(wpl.SceneError, match='effort = "power": some drives move'):
        assert np.isfinite(panel.evaluate(panel.start()).smooth)


@pytest.mark.parametrize(("frequency", "quiet"), [(300.0, False), (20.0, True)])
def test_sound_is_no_effort_where_drives_make_none(frequency, quiet):
    """Far below resonances four forces move the plate with hardly any sound, and slopes were off by 4 %."""
    places = [(x, x + 0.02, y, y + 0.02) for x in (0.04, 0.13) for y in (0.04, 0.13)]
    design = {"free": {"plate.thickness": [4e-4, 6e-4]}, "objective": "velocity", "effort": "sound", "steady": True}
    made = scene_of(frequency=frequency, damping=60.0, actuators=places, modal_density=0.6)
    panel = FreePanel(made.with_tables(design=design))
    with pytest.raises(wpl.SceneError, match='effort = "sound": some') if quiet else nullcontext():
        assert np.isfinite(panel.evaluate(panel.start()).smooth)
