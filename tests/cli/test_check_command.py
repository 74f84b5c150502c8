"""``warp-plate check`` and ``--allow-unstable``: a step above the limit is refused with both numbers, or run to its
status."""

import json
import math
import sys

import numpy as np
import pytest

from support.commands import error_of, output_of, start_program
from support.grid_modes import natural_modes
from support.scenes import scene_of
from warp_plate import PlateSolver, load_result, localize
from warp_plate.accuracy.configurations import percent
from warp_plate.analysis.check import check
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.stability_limit import find_limit
from warp_plate.problem.search_cost import PROGRAM


def test_numbers_and_words_of_the_paper(command):
    found = json.loads(output_of(command("check", "paper", "--device", "cpu", "--json")))
    assert (found["time_step"], found["limit"]) == (8e-5, pytest.approx(9.633e-5, rel=1e-3))
    assert (found["steps"], found["stable"], found["growth_a_step"], found["path"]) == (1250, True, 1, "resident")
    assert sum(found["limit_shares"].values()) == pytest.approx(1)
    assert found["steps_a_period"] == pytest.approx(1 / (290 * 8e-5))
    wavelength = 2 * math.pi * math.sqrt(0.15291 / (580 * math.pi))  # 2π√(κ/ω)
    assert found["points_a_wavelength"] == pytest.approx(wavelength / (0.2 / 26), rel=1e-3)
    assert found["condition"] == pytest.approx((found["fastest_frequency"] / found["slowest_frequency"]) ** 2)
    assert len(found["warnings"]) == 2
    assert found["mass"] == pytest.approx(0.2 * 0.2 * 0.5e-3 * 1000)
    run, search = found["run"], found["search"]
    assert (run["plates"], run["node_steps"]) == (1, 25 * 25 * 1250)
    assert (search["candidates"], search["plates"]) == (20 * 80, 20 * 80 + 4 * 9)
    assert search["node_steps"] == search["plates"] * run["node_steps"]
    # Warnings stand together; numbers that pass have a row each, without a sentence.
    text = command("check", "paper", "--device", "cpu")[1]
    words = " ".join(text.split())
    parts = ("9.63346e-05 s", "1250 steps", "0.851 %", "43.1 a period", "26.5 kB a plate", "up to 1600 designs")
    for part in parts:
        assert part in words
    lines = [line.strip() for line in text.splitlines()]
    assert lines[2].split(maxsplit=1) == ["plate", "200 × 200 × 0.5 mm, 20 g; all edges clamped"]
    assert "first natural frequency  21.89 Hz" in lines
    assert "drive                    290 Hz, 4 actuators" in lines
    warned = [index for index, line in enumerate(lines) if line.startswith("!")]
    rows = [index for index, line in enumerate(lines) if "≥" in line or "≤" in line]
    assert (len(warned), max(warned) < min(rows)) == (2, True)
    assert lines[rows[0]].split() == ["wavelength", "/", "thickness", "115", "≥", "10"]
    passed = [number["name"] for number in found["numbers"] if not number["exceeded"] and number["value"] is not None]
    assert [" ".join(lines[row].split()[:-3]) for row in rows] == passed


def test_supports_of_a_heavy_plate(command, write_scene):
    points = [{"point": [0.05, 0.05]}, {"point": [0.15, 0.15]}, {"ring": [0.1, 0.1, 0.02]}]
    write_scene(name="table", supports=points)
    text = output_of(command("check", "table.toml", "--set", "plate.density=5e4", "--device", "cpu"))
    assert "200 × 200 × 0.5 mm, 1 kg; all edges clamped; held at 2 points, 1 ring" in " ".join(text.split())


def test_the_cost_of_searches_that_take_modes_or_are_refused(command, write_scene):
    def search_of(name):
        return json.loads(output_of(command("check", f"{name}.toml", "--device", "cpu", "--json")))["search"]

    write_scene(name="modal", search={"method": "pso", "position": {}})
    write_scene(name="exact")
    assert (search_of("modal")["candidates"], search_of("modal")["plates"]) == (1600, 0)
    assert search_of("exact")["candidates"] == 1
    assert 0 < search_of("exact")["seconds"] < search_of("modal")["seconds"] / 2
    write_scene(name="in air", effects={"air": {}})
    assert search_of("in air")["seconds"] is None
    free = {"frequency": {"range": [200.0, 300.0]}, "magnitude": {}, "phase": {}}
    write_scene(name="frequency", search=free)
    tried = len(localize("frequency.toml", device="cpu", estimate=False).spectrum["frequency"])
    assert tried < search_of("frequency")["candidates"] <= tried + 40
    assert search_of("frequency")["seconds"] > 2 * search_of("exact")["seconds"]
    write_scene(name="refused", search={"method": "pso", "delay": {"range": [0.0, 0.01]}})
    assert "drive.burst" in search_of("refused")["refused"]
    assert "refused: " in command("check", "refused.toml", "--device", "cpu")[1]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems count the memory of a process otherwise")
@pytest.mark.parametrize(
    "tables",
    [
        {"search": {"method": "pso", "particles": 20, "iterations": 2}},
        {"search": {"method": "pso", "particles": 100_000, "iterations": 1}},
        {"search": {"method": "pso", "particles": 2000, "iterations": 1, "position": {}}},
        {"search": {"method": "pso", "iterations": 1}, "actuators": 64 * [(0.1, 0.15, 0.1, 0.15)]},
    ],
)
def test_the_memory_of_a_search_is_about_what_check_says(tables, command, write_scene):
    write_scene(**tables)
    said = json.loads(output_of(command("check", "panel.toml", "--device", "cpu", "--json")))["search"]["memory"]
    options = ("--device", "cpu", "--no-pictures", "--out", "a.h5")
    code = "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=2, stderr=2)"
    code += "; print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    program = start_program("-c", code, sys.executable, "-m", "warp_plate", "localize", "panel.toml", *options)
    out, err = program.communicate()
    assert program.returncode == 0, err
    taken = 1024 * int(out)
    assert taken / 2 < PROGRAM + sum(said.values()) < 2 * taken


def test_edges_layers_and_frequencies_in_the_summary(command, write_scene):
    scene = scene_of(edges=("free", {"translation": 1e5}, "clamped", "free"))
    rows = [actuator.model_dump() for actuator in scene.actuators]
    rows[0]["frequency"] = 300.0
    layer = {"area": (0.0, 0.1, 0.0, 0.2), "thickness": 2e-5, "young_modulus": 1e9, "density": 2000.0}
    write_scene(scene.with_tables(effects={"layers": [layer]}, actuators=rows))
    words = " ".join(output_of(command("check", "panel.toml", "--device", "cpu")).split())
    assert "g with layers; left free, bottom on springs, right clamped, top free" in words
    assert "290, 300 Hz, 3 actuators" in words


def test_whole_percent():
    assert [percent(share) for share in (0.99999, 0.00564, 1.234, 0.0)] == ["100 %", "0.56 %", "120 %", "0 %"]


def test_frequencies_and_limit():
    """The highest is that of a small grid with springs and a suspended mass, the lowest that of finer ones."""
    suspended = {"area": (0.05, 0.1, 0.05, 0.1), "mass": 0.01, "stiffness": 500.0}
    scene = scene_of((9, 9), effects={"oscillators": [suspended], "foundation": {"stiffness": 1e4}})
    found, modes = check(scene, "cpu"), natural_modes(scene, 1000).frequencies
    finer = natural_modes(scene.with_tables(grid={"nodes": (33, 33)}), 1).frequencies
    assert found.slowest_frequency == pytest.approx(finer[0], rel=2e-4)
    assert found.fastest_frequency == pytest.approx(modes[-1], rel=1e-3)
    assert check(scene_of(edges=("free",) * 4), "cpu").slowest_frequency > 0
    scene = scene_of(effects={"material_damping": {"time": 1e-5}})
    assert check(scene, "cpu").limit.time_step == find_limit(scene)[0].time_step == make_scheme(scene).limit


def test_the_amplitude_up_to_which_stretching_is_stable(device, path):
    """Well below it a plate stays bounded; far above it grows."""
    scene = scene_of(edges=("supported",) * 4, effects={"stretching": {}}, window=(0.0, 0.02), frequency=37.0)
    solver = PlateSolver(scene, device, path)
    amplitude = check(scene, device).stretching_amplitude * scene.plate.thickness
    drives = np.ones((2, 3))
    reach = np.abs(solver.run(1e-3 * drives, (0.005,)).displacement).max(axis=(1, 2, 3))[0]
    drives *= 1e-3 * 0.2 * amplitude / reach
    drives[1] *= 1e4
    run = solver.run(drives, (0.02,))
    assert list(run.status) == ["ok", "grew without bound"]
    assert 0 < run.faults[1][1] <= 0.02


def test_unstable_steps(command, write_scene):
    """They are refused with both numbers; if they are allowed, the growth and the status are reported."""
    limit, options = make_scheme(scene_of()).limit, ("--no-pictures", "--no-estimate", "--device", "cpu")
    write_scene(name="unstable", time_step=1.05 * limit, window=(200 * limit, 1000 * limit))
    for name, *more in (["simulate"], ["localize", "--evaluator", "direct"], ["check"]):
        err = error_of(command(name, "unstable.toml", *more))
        assert f"unstable.toml: grid.time_step = {1.05 * limit:g}" in err
        assert f"the stability limit of {limit:.6g} s" in err
    found = json.loads(output_of(command("check", "unstable.toml", "--allow-unstable", "--json", "--device", "cpu")))
    # λΔt² = 4·1.05²: the root of z + 1/z = 2 − λΔt² outside the unit circle.
    assert found["growth_a_step"] == pytest.approx(-np.roots([1, 4 * 1.05**2 - 2, 1]).min(), rel=1e-6)
    assert (found["stable"], found["limit"]) == (False, pytest.approx(limit))
    record = json.loads(command("simulate", "unstable.toml", "--allow-unstable", "--json", *options)[1])
    assert record["localization_factor"] is None
    assert record["status"].startswith("grew without bound by t = ")
    assert record["status"] in record["warnings"][0]
    assert load_result("unstable-simulate.h5").cases["drive"].status == record["status"]
    assert float(record["status"].split()[-2]) < 150 * limit  # of 1000 steps
    words = command("simulate", "unstable.toml", "--allow-unstable", *options)[1]
    assert ("grew without bound by t" in words, "nan" in words) == (True, False)
