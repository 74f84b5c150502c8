"""The drawing of a designed panel, read back by ezdxf: what is on its layers, and contours where the map says."""

import ezdxf
import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate.plate.section import bilinear
from warp_plate.result.designed import DesignedPanel, PanelValues
from warp_plate.viz.plots.cutter import save_drawing

LAYER = {"area": (0.02, 0.12, 0.05, 0.08), "thickness": 1.41e-4, "young_modulus": 2e9, "density": 1800.0}
OSCILLATOR = {"disc": (0.15, 0.1, 0.01), "mass": 2e-3, "stiffness": 3e3}


def drawn(scene, tmp_path):
    values = PanelValues(0.5, 0.5)
    panel = DesignedPanel(scene, scene, values, values, (), (), (), 0)
    save_drawing(panel, tmp_path / "panel.dxf")
    return ezdxf.readfile(tmp_path / "panel.dxf")


def test_parts_and_contours_are_drawn(tmp_path, random):
    factors = 1 + 0.3 * random.random((6, 7))
    effects = {"layers": [LAYER], "oscillators": [OSCILLATOR], "variation": {"thickness": factors.tolist()}}
    scene = scene_of(size=(0.3, 0.2), effects=effects)
    entities = list(drawn(scene, tmp_path).modelspace())
    names = [entity.dxf.layer for entity in entities]
    assert names[:2] == ["outline", "layers[0] 0.141 mm"]
    assert (names.count("attached"), names.count("actuators")) == (1, 3)
    assert {tuple(row) for row in entities[0].get_points("xy")} == {(0, 0), (300, 0), (300, 200), (0, 200)}
    levels, on_level = set(), 0
    for entity in (entity for entity in entities if entity.dxf.layer.startswith("thickness")):
        level = float(entity.dxf.layer.split()[1])
        levels.add(level)
        points = np.array(entity.get_points("xy")) * 1e-3
        inside = points[((points > 1e-9) & (points < np.array([0.3, 0.2]) - 1e-9)).all(axis=1)]
        for x, y in inside / [0.3, 0.2]:
            there = 0.5 * bilinear(factors, np.array([x]), np.array([y]))[0, 0]
            assert there == pytest.approx(level, abs=2e-3)
            on_level += 1
    assert len(levels) >= 3
    assert on_level > 100


def test_holes_of_an_outline_are_drawn(tmp_path):
    outline = {"outline": {"disc": (0.1, 0.1, 0.1)}, "holes": [{"disc": (0.1, 0.15, 0.01)}]}
    scene = scene_of().model_dump()
    plate = {key: value for key, value in scene["plate"].items() if key != "size"} | outline
    kept = {key: scene[key] for key in ("drive", "window", "target", "grid")}
    patches = [{"name": "one", "area": (0.08, 0.1, 0.08, 0.1)}]
    scene = type(scene_of()).from_tables({"plate": plate, "actuators": patches, **kept})
    entities = {entity.dxf.layer: entity for entity in drawn(scene, tmp_path).modelspace()}
    assert entities["outline"].dxf.radius == pytest.approx(100)
    assert entities["holes"].dxf.radius == pytest.approx(10)
