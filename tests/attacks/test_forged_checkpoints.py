"""Checkpoints that someone has changed and sealed again: refused by name, or a result of finite numbers."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.attacks import examples
from support.forged import ARRAYS, VALUES, forge, forge_place, set_attribute, set_dataset
from support.scenes import scene_of
from warp_plate import CheckpointFile, SceneError, load_checkpoint, localize, resume

SEARCHES = {
    "pso": {"particles": 4, "iterations": 3},
    "gradient": {"method": "gradient", "particles": 4, "iterations": 3},
    "exact": {"method": "exact"},
}


@pytest.fixture(scope="module", params=SEARCHES)
def saved_search(request, tmp_path_factory):
    """The path of a checkpoint at the end of a search, with its content beside it."""
    path = tmp_path_factory.mktemp("saved") / "a.checkpoint.h5"
    scene = scene_of((9, 9), damping=88.5, search=SEARCHES[request.param])
    evaluator = "direct" if request.param == "pso" else "modal"
    options = {"estimate": False, "spectrum": False, "checkpoints": CheckpointFile(path, 0)}
    localize(scene, source="panel", device="cpu", evaluator=evaluator, **options)
    path.with_suffix(".right").write_bytes(path.read_bytes())
    return path


def resume_or_refuse(path):
    """Resume a search: it is refused, or its result has numbers."""
    try:
        result = resume(load_checkpoint(path), estimate=False, spectrum=False)
    except SceneError:
        return
    for case in result.cases.values():
        if case.status == "ok":
            assert np.isfinite([*case.magnitude, *case.phase]).all()
            assert 0 <= case.localization_factor <= 1


@pytest.mark.hour
@examples(5)
@given(place=st.integers(0, 10**6), value=st.sampled_from(VALUES), way=st.sampled_from(list(ARRAYS)))
def test_any_value_in_any_place(place, value, way, saved_search):
    forge_place(saved_search, place, value, way)
    resume_or_refuse(saved_search)


@pytest.mark.hour
@examples(5)
@given(data=st.data())
def test_any_value_in_the_numbers_of_a_state(data, saved_search):

    def change(file):
        numbers = json.loads(file["swarm"].attrs["numbers"])
        inner = numbers
        while isinstance(inner[key := data.draw(st.sampled_from(sorted(inner)))], dict):
            inner = inner[key]
        inner[key] = data.draw(st.sampled_from(VALUES))
        file["swarm"].attrs["numbers"] = json.dumps(numbers)

    forge(saved_search, change)
    resume_or_refuse(saved_search)


@pytest.mark.parametrize("way", ["nan", "one nan", "inf", "huge"])
@pytest.mark.parametrize("name", ["positions", "best_position"])
def test_positions_that_are_no_numbers(name, way, saved_search):

    def change(file):
        set_dataset(file, f"swarm/{name}", ARRAYS[way](file[f"swarm/{name}"][()]))

    forge(saved_search, change)
    with pytest.raises(SceneError, match=rf"^checkpoint: search state: {name}: must"):
        resume(load_checkpoint(saved_search))


@pytest.mark.parametrize("way", ["inf", "huge"])
def test_evaluations_that_nobody_can_count(way, saved_search):
    forge(saved_search, lambda file: set_dataset(file, "swarm/history", ARRAYS[way](file["swarm/history"][()])))
    with pytest.raises(SceneError, match=r"^checkpoint: search state: history: .* numbers of evaluations"):
        resume(load_checkpoint(saved_search))


def test_an_actuator_that_is_not_there(saved_search):
    forge(saved_search, lambda file: set_attribute(file, "single", 3))
    with pytest.raises(SceneError, match="single = 3: must be the index of one of 3 actuators"):
        load_checkpoint(saved_search)


@pytest.mark.parametrize("saved_search", ["gradient"], indirect=True)
def test_matrices_that_are_no_numbers(saved_search):
    forge(saved_search, lambda file: set_dataset(file, "matrices", ARRAYS["one nan"](file["matrices"][()])))
    with pytest.raises(SceneError, match="matrices must be finite"):
        load_checkpoint(saved_search)
