"""The number of resonators or ribs of a design: those that stay, the scene without the others, and the ceiling."""

import json

import numpy as np
import pytest

import warp_plate as wpl
from support.scenes import scene_of
from warp_plate.designing.candidates import Candidates, ceiling, without
from warp_plate.designing.panel import FreePanel

PLACES = [(0.12, 0.03), (0.16, 0.08), (0.05, 0.13), (0.15, 0.15)]
TUNED = [280.0, 300.0, 290.0, 310.0]


def candidate_scene(count=2, **design):
    rows = [
        {"area": (x, x + 0.01, y, y + 0.01), "mass": 5e-4, "stiffness": 5e-4 * (6.283 * tone) ** 2, "damping": 0.02}
        for (x, y), tone in zip(PLACES, TUNED, strict=True)
    ]
    free = {f"effects.oscillators[{index}].mass": [1e-6, 3e-3] for index in range(len(rows))}
    table = {"free": free, "count": {"effects.oscillators": count}, "starts": 1, "iterations": 4, **design}
    effects = {"oscillators": rows, "loss_factor": {"eta": 0.03}}
    return scene_of(modal_density=0.4, effects=effects, design=table)


def test_those_stay_without_which_a_panel_does_worst():
    candidates, gains = Candidates(FreePanel(candidate_scene())), np.array([1.0, 5.0, 2.0, 3.0])
    gone = candidates.left_out(np.full(4, 0.5), lambda numbers: float(gains @ numbers))
    assert gone == ["effects.oscillators[0]", "effects.oscillators[2]"]


def test_scenes_without_tables_are_numbered_anew():
    links = {"alike": {"keys": ["effects.oscillators[1].damping", "effects.oscillators[3].damping"]}}
    places = {"effects.oscillators[3]": (0.1, 0.2, 0.1, 0.2)}
    scene = candidate_scene(places=places).with_tables(links=links)
    shorter = without(scene, ["effects.oscillators[0]", "effects.oscillators[2]"])
    assert [row.area for row in shorter.effects.oscillators] == [
        scene.effects.oscillators[index].area for index in (1, 3)
    ]
    assert list(shorter.design.free) == ["effects.oscillators[0].mass", "effects.oscillators[1].mass"]
    assert list(shorter.design.places) == ["effects.oscillators[1]"]
    assert list(shorter.links["alike"].keys) == ["effects.oscillators[0].damping", "effects.oscillators[1].damping"]
    with pytest.raises(wpl.SceneError, match=r"design.count: effects.oscillators\[1\].damping is named elsewhere"):
        without(scene, ["effects.oscillators[1]"])


@pytest.mark.slow
def test_a_design_keeps_its_count_and_stays_below_the_ceiling(tmp_path):
    file = tmp_path / "starts.json"
    panel = wpl.design(candidate_scene(), unfinished=file, check=False)
    assert panel.before.excess["count of effects.oscillators"] == 1
    assert len(panel.scene.effects.oscillators) == 2 == len(panel.left_out)
    assert panel.after.kept
    assert panel.after.bound == pytest.approx(wpl.design(candidate_scene(), unfinished=file, check=False).after.bound)
    assert panel.after.bound <= panel.ceiling + 1e-9
    record = json.loads(file.read_text())
    record["starts"][0]["left_out"] = []
    file.write_text(json.dumps(record))
    with pytest.raises(wpl.SceneError, match="is no unfinished design of this version"):
        wpl.design(candidate_scene(), unfinished=file)


def test_no_attachment_passes_the_ceiling(random):
    scene = candidate_scene()
    bound = ceiling(scene)
    for _ in range(6):
        rows = [
            {**row.model_dump(), "mass": mass, "stiffness": mass * (6.283 * tone) ** 2, "damping": damping}
            for row, mass, tone, damping in zip(
                scene.effects.oscillators, 10 ** random.uniform(-5, -2, 4), random.uniform(200, 400, 4),
                10 ** random.uniform(-3, 0, 4), strict=True,
            )
        ]  # fmt: skip
        other = scene.replace("effects.oscillators", rows).replace("design", None)
        assert FreePanel(scene).exact(other).bound <= bound + 1e-6
    assert ceiling(candidate_scene(places={"effects.oscillators[0]": (0.1, 0.2, 0.0, 0.2)})) is None


def test_counts_without_candidates_are_refused():
    with pytest.raises(wpl.SceneError, match=r"design.count: effects.layers: no mass or thickness there is free"):
        wpl.design(candidate_scene().replace("design.count", {"effects.layers": 1}))
