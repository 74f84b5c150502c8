"""Tables that only the modal engine knows, ``[effects.loss_factor]`` and ``[effects.modal_damping]``."""

import numpy as np
import pytest

from support.scenes import PAPER, refusal, refused, scene_of
from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.analysis.warnings import find_warnings
from warp_plate.effects.effect import per_mode
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.scene.keys import label_of, scalar_keys, unit_of

ETA, ETAS = "[effects.loss_factor]\neta = {}\n", {"eta": [0.1]}
LOAD = {"force": 1.0, "start": [0.1, 0.1]}
BURST = {"frequency": 290.0, "burst": {"duration": 0.01}}
CHIRP = {"frequency": 290.0, "chirp": {"end_frequency": 400.0, "duration": 0.01}}
SIGNAL = {"frequency": 290.0, "signal": {"file": "a.wav"}}
VOLTS = {"frequency": 290.0, "electrostatic": {"gain": 1.0}}


@pytest.mark.parametrize(
    ("table", "line"),
    [
        (ETA.format(1.0), "effects.loss_factor.eta = 1.0: must be less than 1"),
        (ETA.format("[0.1, 1.5]"), "effects.loss_factor.eta[1] = 1.5: must be less than 1"),
        (ETA.format("[]"), "effects.loss_factor.eta = []: must be a list of 1 or more numbers"),
        ("[effects.modal_damping]", "effects.modal_damping.ratio: is missing"),
    ],
)
def test_wrong_values_are_refused_by_key(table, line):
    assert refusal(PAPER + table).startswith(line)


@pytest.mark.parametrize(
    ("effects", "tables", "keys"),
    [
        ({"loss_factor": {"eta": 0.0}}, {"drive": BURST}, ("effects.loss_factor: ", "drive.burst")),
        ({"loss_factor": {"eta": 0.1}}, {"drive": CHIRP}, ("effects.loss_factor: ", "drive.chirp")),
        ({"loss_factor": {"eta": 0.1}}, {"drive": SIGNAL}, ("effects.loss_factor: ", "drive.signal")),
        ({"loss_factor": {"eta": [0.1]}}, {"drive": VOLTS}, ("effects.loss_factor: ", "drive.electrostatic")),
        ({"modal_damping": {"ratio": 0.1}}, {"drive": VOLTS}, ("effects.modal_damping: ", "drive.electrostatic")),
        ({"modal_damping": {"ratio": 0.1}, "stretching": {}}, {}, ("effects.modal_damping: ", "effects.stretching")),
        ({"loss_factor": {"eta": 0.1}, "stretching": {}}, {}, ("effects.loss_factor: ", "effects.stretching")),
        ({"loss_factor": ETAS, "moving_load": LOAD}, {}, ("effects.loss_factor: ", "effects.moving_load")),
        ({"loss_factor": ETAS, "modal_damping": {"ratio": 0.1}}, {}, ("effects.modal_damping: ", "loss_factor.eta")),
    ],
)
def test_what_has_no_such_damping_is_refused_by_both_keys(effects, tables, keys):
    line = refused(Scene.from_tables, {**scene_of().model_dump(), "effects": effects, **tables})
    assert line.startswith(keys[0])
    assert keys[1] in line


def test_transients_and_other_damping_go_with_modal_damping():
    effects = {"damping": {"viscous": 1.0}, "loss_factor": {"eta": 0.1}, "modal_damping": {"ratio": 0.01}}
    assert scene_of(effects=effects).steady
    made = scene_of(effects={"modal_damping": {"ratio": 0.01}}, drive=BURST)
    assert (made.steady, made.linear, made.modal_only_key) == (False, True, "effects.modal_damping")
    assert scene_of(damping=1.0).modal_only_key is None


@pytest.mark.parametrize(("eta", "key"), [(0.1, "eta"), ([0.1, 0.2], "eta[1]")])
def test_numbers_survive_a_dump_and_are_varied(eta, key):
    made, key = scene_of(effects={"loss_factor": {"eta": eta}}), f"effects.loss_factor.{key}"
    assert Scene.parse(made.to_toml(), "") == made.with_tables() == made
    assert scalar_keys(made)[key] is float
    assert (unit_of(made, key), bool(label_of(made, key))) == ("1", True)
    varied = made.with_values({key: 0.5}).effects.loss_factor
    first = np.ravel(eta)[0] if key.endswith("]") else 0.5
    np.testing.assert_array_equal(per_mode(varied.eta, 3), [first, 0.5, 0.5])  # the last holds for all higher modes


@pytest.mark.parametrize("effects", [{"loss_factor": {"eta": 0.1}}, {"modal_damping": {"ratio": [0.1]}}])
def test_time_stepping_refuses_them_by_name(effects):
    made, key = scene_of(effects=effects), f"effects.{next(iter(effects))}"
    assert made.modal_only_key == key
    with pytest.raises(SceneError, match=f'^{key}: .*"modal".*effects.damping'):
        PlateSolver(made, "cpu")


def test_start_up_motion():
    """It decays at ζω, the slowest mode's; a steady response has none."""
    for effects, left in (({"loss_factor": {"eta": 0.1}}, 0.0), ({"modal_damping": {"ratio": [0.2, 0.1]}}, None)):
        made = scene_of(effects=effects)
        found = {number.name: number for number in find_warnings(made, 0.0)}
        decayed = np.exp(-0.1 * 2 * np.pi * 290 * made.window.start) if left is None else left
        assert found["start-up motion left"].value == pytest.approx(decayed)
        assert found["start-up motion left"].exceeded == (decayed > 0.01)
        assert "points a wavelength" not in found  # there is no grid


def test_scenarios_scale_all_damping_of_the_panel():
    effects = {"damping": {"viscous": 80.0}, "loss_factor": {"eta": 0.1}, "modal_damping": {"ratio": [0.1, 0.2]}}
    made = scene_of(effects={**effects, "loss_factor": {"eta": 0.1}}, search={"robust": {"damping": 0.5}})
    for drawn in draw_scenarios(made, 4, 1):
        factor = drawn.scene.effects.damping.viscous / 80
        assert 0.5 <= factor <= 1.5
        assert drawn.scene.effects.loss_factor.eta == pytest.approx(0.1 * factor)
        assert drawn.scene.effects.modal_damping.ratio == pytest.approx((0.1 * factor, 0.2 * factor))
        assert drawn.scene.grid == made.grid
    alone = scene_of(effects={"loss_factor": {"eta": [0.1, 0.2]}}, search={"robust": {"damping": 0.5}})
    (drawn,) = draw_scenarios(alone, 1, 1)
    assert drawn.scene.effects.loss_factor.eta[1] == pytest.approx(2 * drawn.scene.effects.loss_factor.eta[0])
