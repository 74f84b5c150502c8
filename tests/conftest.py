"""Fixtures for all tests: small scenes, the devices and paths of this machine, seeded random numbers, the discrete
operator.

``pytest --seed N`` draws other random inputs than the default seed 0, here and in Hypothesis."""

import atexit
import gc
import os
import shutil
import signal
import subprocess
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

from support.scenes import EDGE_MIXES, edges_id, scene_of
from warp_plate import PlateSolver, SceneError, localize, save_result
from warp_plate.cli.main import main
from warp_plate.interrupts import END_SIGNALS
from warp_plate.solve.devices import find_device

# Warp's warnings, as of what its next version drops, are errors of the tests like all others.
wp.config.log_level = wp.LOG_WARNING


BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")


@lru_cache(maxsize=1)
def device_paths():
    """Return all (device, path) pairs of this machine, with those of its first CUDA device if there is one."""
    find_device("cpu")
    devices = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
    return [(device, path) for device in devices for path in ("resident", "streaming")]


def pytest_addoption(parser):
    parser.addoption("--seed", type=int, help="seed of the tests' random inputs (default: 0)")


def is_hour(config):
    """Return whether attacks take an hour, by ``-m hour``, instead of a minute."""
    return "hour" in config.getoption("markexpr")


def pytest_configure(config):
    seed, examples = config.getoption("seed"), 6000 if is_hour(config) else 100
    # Shared machines are slow at times, so examples have no deadline.
    hypothesis.settings.register_profile("here", deadline=None, derandomize=seed is None, max_examples=examples)
    hypothesis.settings.load_profile("here")
    hypothesis.core.global_force_seed = seed


def pytest_collection_modifyitems(config, items):
    for item in items if is_hour(config) else ():
        item.add_marker(pytest.mark.timeout(7200))


def pytest_collection_finish():
    """Leave modules and tests out of the search for garbage, also at the end."""
    gc.freeze()
    atexit.register(gc.freeze)


def pytest_generate_tests(metafunc):
    """Run tests that take ``device`` and ``path`` on every pair, and tests that take ``edges`` on ``EDGE_MIXES``."""
    if {"device", "path"} <= set(metafunc.fixturenames):
        metafunc.parametrize(("device", "path"), device_paths(), ids=["-".join(pair) for pair in device_paths()])
    if "edges" in metafunc.fixturenames:
        metafunc.parametrize("edges", EDGE_MIXES, ids=edges_id)


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    """Skip a test on a path that its scene does not have."""
    try:
        return (yield)
    except SceneError as refusal:
        if "path" in pyfuncitem.fixturenames and "no such path for this scene" in str(refusal):
            pytest.skip(str(refusal))
        raise


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


@pytest.fixture(autouse=True)
def signal_handlers():
    """Restore the handlers of signals, which commands that are done ignore, as would programs of later tests."""
    handlers = {number: signal.getsignal(number) for number in END_SIGNALS}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


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
    made = scene_of(edges=edges, damping=300.0, window=(0.01, 0.03), actuators=patches, frequency=100.0)
    return made.with_tables(grid={})


@pytest.fixture(scope="session")
def result_file(tmp_path_factory):
    """The file of a small search with recorded times, run.h5, which tests only read."""
    record = {"times": (0.002, 0.004), "points": ((0.1, 0.1),)}
    made = scene_of(damping=200.0, record=record, search={"particles": 4, "iterations": 3})
    return save_result(localize(made, device="cpu", estimate=False), tmp_path_factory.mktemp("search") / "run.h5")


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


@pytest.fixture
def write_scene(tmp_path, monkeypatch):
    """Enter an empty folder, and return a function that writes a scene there, panel.toml by default."""
    monkeypatch.chdir(tmp_path)

    def write(scene=None, name="panel", **tables):
        made = scene_of(**tables) if scene is None else scene
        Path(f"{name}.toml").write_text(made.to_toml(), encoding="utf-8")
        return made

    return write
