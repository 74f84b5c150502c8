"""Fixtures for all tests: small scenes, the devices and paths of this machine, seeded random numbers, the discrete
operator.

``pytest --seed N`` draws other random inputs than the default seed 0, here and in Hypothesis."""

import math
import os
import shutil
import subprocess
import sys
import time
import unicodedata
import zlib
from functools import lru_cache
from pathlib import Path

# One pytest worker runs on each core, so threaded linear algebra would only make the workers wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Programs that tests start import this checkout, wherever they run.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH")]))

# They and the workers of pytest compile each of its files once, not at every start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import hypothesis
import numpy as np
import pytest
import warp as wp

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.cli.main import main
from warp_plate.plate.operator import LARGEST
from warp_plate.plate.scheme import make_scheme
from warp_plate.result.model import Result
from warp_plate.result.motion import Motion
from warp_plate.scene.load import preset_text
from warp_plate.solve.devices import find_device
from warp_plate.solve.engine import paths_of

# Warp's warnings, as of what its next version drops, are errors of the tests like all others.
wp.config.log_level = wp.LOG_WARNING

# Shared machines are slow at times, so examples have no deadline.
hypothesis.settings.register_profile("fixed", deadline=None, derandomize=True)
hypothesis.settings.register_profile("seeded", deadline=None)

# True if attacks take an hour, by ``-m hour``, instead of a minute.
HOUR = False

# The plate of the source paper.
MATERIAL = {"thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1000.0}
PAPER = preset_text("paper")
SIDES = ("left", "bottom", "right", "top")
# Three actuators without any symmetry; x0, x1, y0, y1 as fractions of the sides of the plate.
THREE_PATCHES = ((0.15, 0.3, 0.2, 0.35), (0.6, 0.85, 0.15, 0.4), (0.25, 0.65, 0.55, 0.8))
# A covering array: every pair of sides (left, bottom, right, top) has every pair of kinds in one of the five.
EDGE_MIXES = [("clamped",) * 4] + [
    tuple("clamped" if side == only else "supported" for side in range(4)) for only in range(4)
]
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")


def scene_of(
    nodes=(13, 13),
    size=(0.2, 0.2),
    edges=("clamped",) * 4,
    damping=None,
    scheme="centred",
    precision="float64",
    window=(0.004, 0.012),
    actuators=None,
    load="overlap",
    time_step=None,
    frequency=290.0,
    order=2,
    **tables,
):
    """Return a small scene of the paper's material; edges: left, bottom, right, top; actuators: their areas [m]."""
    if actuators is None:
        actuators = [tuple(np.array(shares) * np.repeat(size, 2)) for shares in THREE_PATCHES]
    grid = {"nodes": nodes, "order": order, "load": load, "precision": precision, "time_step": time_step}
    return Scene.model_validate(
        {
            "plate": {"size": size, **MATERIAL},
            "edges": dict(zip(SIDES, edges, strict=True)),
            "grid": grid,
            "window": {"start": window[0], "end": window[1]},
            "drive": {"frequency": frequency},
            "target": {"area": (0.0, size[0] / 2, 0.0, size[1] / 2)},
            "effects": {} if damping is None else {"damping": {"viscous": damping, "scheme": scheme}},
            "actuators": [{"name": str(index), "area": area} for index, area in enumerate(actuators)],
            **tables,
        }
    )


def areas_of(scene):
    """Return the ends (actuators, axis, 2) of a scene's patches [m]."""
    return np.array([actuator.area for actuator in scene.actuators]).reshape(-1, 2, 2)


def result_of(scene, cases, **changes):
    """Return a result of ``localize`` without a history."""
    plain = {"command": "localize", "source": "panel.toml", "device": "cpu", "seed": 0, "effects": (), "seconds": {}}
    motionless = {"node_steps": 1, "times": np.zeros(0), "trace_times": np.zeros(0)}
    return Result(scene=scene, cases=cases, **{**plain, **motionless, **changes})


def motion_of(name, amplitude, lag=0.0, frames=8, start=0.0, factor=0.25):
    """Return a motion at 200 Hz with these (ny, nx) amplitudes [m] and phase lags [rad]."""
    turn = 2 * math.pi * np.arange(frames)[:, None, None] / frames - lag
    times, mass = start + np.arange(frames) / frames / 200, np.full(amplitude.shape, 0.5)
    field, velocity = np.cos(turn) * amplitude, -400 * math.pi * np.sin(turn) * amplitude
    return Motion(name, 200.0, (start, start + 0.005), times, field, velocity, mass, factor)


def refusal(text):
    """Return the one-line error message of a scene text, without the name of the file."""
    with pytest.raises(SceneError) as caught:
        Scene.parse(text, "panel.toml")
    line = str(caught.value)
    assert line.startswith("panel.toml: ")
    assert len(line.splitlines()) == 1
    return line.removeprefix("panel.toml: ")


def is_printable(text):
    """Return whether a text has no characters but printable ones and spaces, such as those that do not break."""
    return all(c.isprintable() or unicodedata.category(c) == "Zs" for c in text)


def edges_id(edges):
    """Return CSCC for clamped, supported, clamped, clamped."""
    return "".join(edge[0].upper() for edge in edges)


@lru_cache(maxsize=1)
def device_paths():
    """Return all (device, path) pairs of this machine, with those of its first CUDA device if there is one."""
    find_device("cpu")
    devices = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
    return [(device, path) for device in devices for path in paths_of(wp.get_device(device))]


def pytest_addoption(parser):
    parser.addoption("--seed", type=int, help="seed of the tests' random inputs (default: 0)")


def examples(count):
    """Return the settings of an attack of ``count`` examples, or of sixty times as many with ``-m hour``."""
    return hypothesis.settings(
        max_examples=count * (60 if HOUR else 1), suppress_health_check=[hypothesis.HealthCheck.function_scoped_fixture]
    )


def pytest_collection_modifyitems(items):
    for item in items if HOUR else ():
        item.add_marker(pytest.mark.timeout(7200))


def pytest_configure(config):
    global HOUR
    HOUR = "hour" in config.getoption("markexpr")
    seed = config.getoption("seed")
    hypothesis.settings.load_profile("fixed" if seed is None else "seeded")
    hypothesis.core.global_force_seed = seed


def pytest_generate_tests(metafunc):
    """Run tests that take ``device`` and ``path`` on every pair, and tests that take ``edges`` on ``EDGE_MIXES``."""
    if {"device", "path"} <= set(metafunc.fixturenames):
        metafunc.parametrize(("device", "path"), device_paths(), ids=["-".join(pair) for pair in device_paths()])
    if "edges" in metafunc.fixturenames:
        metafunc.parametrize("edges", EDGE_MIXES, ids=edges_id)


@pytest.fixture(scope="session")
def display():
    """The name of a virtual X display, for tests that press keys and drag the mouse by xdotool."""
    lacking = [program for program in ("Xvfb", "xdotool") if shutil.which(program) is None]
    if lacking:
        pytest.skip(f"{' and '.join(lacking)} not installed: apt-get install xvfb xdotool")
    reading, writing = os.pipe()
    # Without -noreset the server restarts when its last window closes, and refuses connections meanwhile.
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1600x1000x24", "-noreset", "-nolisten", "tcp"],
        pass_fds=[writing],
        stderr=subprocess.DEVNULL,
    )
    os.close(writing)
    with os.fdopen(reading) as answer:
        number = answer.readline().strip()
    if not number:
        server.wait()
        pytest.skip("Xvfb does not start here")
    yield f":{number}"
    server.terminate()
    server.wait()


@pytest.fixture
def drawing():
    """Set VTK up to draw off screen; skips the test if it cannot."""
    from warp_plate.viz.availability import missing_renderer, set_up_renderer

    if (problem := missing_renderer()) is not None:
        pytest.skip(problem)
    set_up_renderer()


@pytest.fixture
def pairs():
    """All (device, path) pairs, see :func:`device_paths`."""
    return device_paths()


@pytest.fixture(scope="session")
def panel():
    """A supported panel with few modes below the drive frequency, for which a reference solution is cheap."""
    patches = [(0.03, 0.06, 0.04, 0.07), (0.12, 0.17, 0.03, 0.08), (0.05, 0.13, 0.11, 0.16)]
    edges = ("supported",) * 4
    made = scene_of(edges=edges, damping=300.0, window=(0.01, 0.03), actuators=patches, frequency=200.0)
    return made.with_tables(grid={})


@pytest.fixture
def scene():
    """The factory of small scenes, see :func:`scene_of`."""
    return scene_of


@pytest.fixture
def random(request):
    """A random generator, seeded by ``--seed`` and by the name of the test."""
    return np.random.default_rng([request.config.getoption("seed") or 0, zlib.crc32(request.node.name.encode())])


@pytest.fixture
def phasors(random):
    """A factory of random complex phasors of shape (plates, actuators)."""

    def draw(plates, actuators):
        return random.normal(size=(plates, actuators)) + 1j * random.normal(size=(plates, actuators))

    return draw


@pytest.fixture
def fitting_solver():
    """PlateSolver(scene, device, path), which skips the test if the plate is too large for the path."""

    def make(scene, device, path, **options):
        try:
            return PlateSolver(scene, device, path, **options)
        except SceneError as error:
            if device.startswith("cuda") and "do not fit" in str(error):
                pytest.skip(str(error))
            raise

    return make


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium of the system, else of Playwright; skips the test if there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install playwright")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    with playwright.sync_playwright() as started:
        if found is None and not Path(started.chromium.executable_path).exists():
            pytest.skip("there is no Chromium: apt-get install chromium-headless-shell, or playwright install chromium")
        # Containers often forbid Chromium its sandbox. It only opens pages of these tests.
        made = started.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield made
        made.close()


def until(condition, patience=60.0):
    """Wait until a condition holds, on a busy machine at most so long [s]."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def pixels(picture):
    """Return the (height, width, 3) colours 0 … 255 of a picture's path or file object."""
    from PIL import Image

    return np.asarray(Image.open(picture).convert("RGB"), dtype=int)


def drag(page, selector, x, y=0):
    """Drag the middle of an element of a page by a distance [pixels]."""
    box = page.locator(selector).last.bounding_box()
    start = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(start[0] + x, start[1] + y, steps=5)
    page.mouse.up()


def point_scene(nodes, size=(0.2, 0.2), edges=("clamped",) * 4, precision="float64", order=2, **changes):
    """Return a scene with an actuator on every inner node, row by row, so that any field can be the load; undamped and
    two steps long by default."""
    x, y = (np.linspace(0, length, count)[1:-1] for length, count in zip(size, nodes, strict=True))
    half_x, half_y = (length / (count - 1) / 4 for length, count in zip(size, nodes, strict=True))
    areas = [(i - half_x, i + half_x, j - half_y, j + half_y) for j in y for i in x]
    rigidity = MATERIAL["young_modulus"] * MATERIAL["thickness"] ** 3 / 12 / (1 - MATERIAL["poisson_ratio"] ** 2)
    kappa = math.sqrt(rigidity / (MATERIAL["density"] * MATERIAL["thickness"]))
    step = 0.95 * 2 / (kappa * LARGEST[order] * (1 / (4 * half_x) ** 2 + 1 / (4 * half_y) ** 2))
    # With four steps a period, the load is cos(0) = 1 at the first step and cos(π/2) = 6e-17 at the second.
    two_steps = {"time_step": step, "window": (0.0, 2 * step), "frequency": 1 / (4 * step)}
    options = {"precision": precision, "order": order, "load": "nodes", "actuators": areas, **two_steps, **changes}
    return scene_of(nodes, size, edges, **options)


def discrete_operator(scene):
    """Return the (inner nodes, inner nodes) matrix of ∇⁴ [1/m⁴], row by row, by kernels that serve any grid.

    The scene is a two-step ``point_scene``, and each plate has one unit load. It is at rest at t = 0, so u(Δt) has the
    shape of the load, and no load acts at the second step: u(2Δt) − u(Δt) = u(Δt) − (κΔt)²∇⁴u(Δt), which gives ∇⁴u.
    """
    scheme, count = make_scheme(scene), len(scene.actuators)
    run = PlateSolver(scene, "cpu", "streaming").run(np.eye(count), times=(scheme.time_step, 2 * scheme.time_step))
    first, second = np.moveaxis(run.displacement[..., 1:-1, 1:-1].reshape(count, 2, count), 1, 0)
    return ((2 * first - second) / (scheme.kappa * scheme.time_step) ** 2 / np.diag(first)[:, None]).T


@pytest.fixture
def command(capsys):
    """Run a command in this process and return (exit status, standard output, standard error)."""

    def run(*words):
        try:
            main([str(word) for word in words])
            status = 0
        except SystemExit as left:
            status = left.code or 0
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


def output_of(answer):
    """Return the standard output of a command that succeeded and wrote nothing on standard error."""
    status, out, err = answer
    assert (status, err) == (0, "")
    return out


def error_of(answer):
    """Return what a command wrote that refused its input: one printable line on standard error, with status 2."""
    status, out, err = answer
    assert (status, out) == (2, "")
    assert err.startswith("warp-plate: ")
    assert err.endswith("\n")
    assert err[:-1].isprintable()
    return err


def start_program(*arguments, **options):
    """Start Python with arguments such as ``-m warp_plate``; its standard output and error are pipes."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *map(str, arguments)], **{**pipes, **options})


@pytest.fixture
def write_scene(tmp_path, monkeypatch):
    """Enter an empty folder, and return a function that writes a scene there, panel.toml by default."""
    monkeypatch.chdir(tmp_path)

    def write(scene=None, name="panel", **tables):
        made = scene_of(**tables) if scene is None else scene
        Path(f"{name}.toml").write_text(made.to_toml(), encoding="utf-8")
        return made

    return write
