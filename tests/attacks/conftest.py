"""What several attacks work on: a folder of files, and a page."""

import re
import signal

import pytest

from support.commands import start_program
from support.scenes import scene_of
from warp_plate import focus, localize, save_focus, save_result, save_sweep, sweep, viz
from warp_plate.result.frequency_response import write_hdf5
from warp_plate.studies.frequency_response import frf
from warp_plate.viz.explorer_page import missing_page

TABLES = {"damping": 88.5, "window": (0.001, 0.004), "search": {"particles": 3, "iterations": 2}}
SENSOR = {"actuator": "0", "point": (0.13, 0.15)}
FREE = {"fit": {"free": {"plate.young_modulus": (9e8, 1.1e9)}, "starts": 1}}
PULSE = {"focus": {"points": [(0.06, 0.05)], "highest": 200.0, "time": 0.01, "rate": 2000}}
PIEZO = {"kind": "piezo", "d31": -1.7e-10, "thickness": 2e-4, "young_modulus": 6e10, "capacitance": 1e-8}
RIGHT = ("panel.toml", "fit.toml", "sensor.toml", "focus.toml", "piezo.toml")


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A folder with a file of each kind that commands read."""
    folder = tmp_path_factory.mktemp("filled")
    scene = scene_of((9, 9), **TABLES)
    piezo = [{"name": "p", "area": (0.03, 0.06, 0.04, 0.07), **PIEZO}]
    scenes = scene, *(scene.with_tables(**tables) for tables in (FREE, {**FREE, "measurement": [SENSOR]}, PULSE))
    for name, each in zip(RIGHT, (*scenes, scenes[-1].with_tables(actuators=piezo)), strict=True):
        (folder / name).write_text(each.to_toml(), encoding="utf-8")
    save_result(localize(scene, device="cpu", estimate=False), folder / "run.h5")
    save_focus(focus(scenes[-1]), folder / "focus.h5")
    save_sweep(sweep(scene, ["drive.frequency=280,290"], "simulate", device="cpu"), folder / "sweep.h5")
    write_hdf5(frf(scene, frequency_range=(50, 300)), folder / "frf.h5")
    (folder / "modes.csv").write_text("frequency\n38\n77\n78\n115\n", encoding="utf-8")
    (folder / "responses.csv").write_text("50,1,1\n60,2,1\n70,1,2\n80,1,3\n", encoding="utf-8")
    (folder / "velocities.csv").write_text("x,y,velocity\n.05,.05,1\n.15,.05,1\n.05,.15,2\n.15,.15,1\n")
    (folder / "text.h5").write_text("no HDF5", encoding="utf-8")
    (folder / "folder").mkdir()
    return folder


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Host and port, and query, of ``explore --web``; Ctrl-C ends it quietly whatever its clients have sent."""
    if (problem := missing_page() or viz.missing_renderer()) is not None:
        pytest.skip(problem)
    scene = tmp_path_factory.mktemp("served") / "panel.toml"
    scene.write_text(scene_of(damping=120.0, window=(0.08, 0.1)).to_toml(), encoding="utf-8")
    process = start_program("-m", "warp_plate", "explore", scene, "--web", "--port", 0, "--device", "cpu")
    line = process.stdout.readline()
    try:
        yield re.search(r"http://(127\.0\.0\.1:\d+)/(\?key=\w+) ", line).groups() + (process.pid,)
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "", "ended\n")
