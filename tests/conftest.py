"""What the tests share: small scenes, the devices and paths of this machine, fresh random numbers, the
operator."""

import itertools
import math
import os
import secrets
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

# As many workers run as there are cores; algebra on several threads each would only make them wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
import warp as wp
from hypothesis import settings

from warp_plate import PlateSolver, Scene, SceneError
from warp_plate.cli.main import main
from warp_plate.plate.scheme import make_scheme
from warp_plate.plate.stability_limit import time_step_limit
from warp_plate.scene import preset_text
from warp_plate.solve.devices import find_device
from warp_plate.solve.paths import paths_of

# Shared machines are slow at times: an example may take as long as it takes.
settings.register_profile("no deadline", deadline=None)
settings.load_profile("no deadline")

# The panel of the source paper.
MATERIAL = {"thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1000.0}
PAPER = preset_text("paper")
SIDES = ("left", "bottom", "right", "top")
# Actuators as shares of the plate's sides, x0, x1, y0, y1, alike in nothing.
THREE_PATCHES = ((0.15, 0.3, 0.2, 0.35), (0.6, 0.85, 0.15, 0.4), (0.25, 0.65, 0.55, 0.8))
# A quarter turn a step: the load is cos(0) = 1 at the first step and cos(π/2) = 6e-17 at the second.
STEPS_A_PERIOD = 4
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
    """A small scene of the paper's material; edges: left, bottom, right, top; actuators: areas on it."""
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


def refusal(text):
    """The one line that a text is refused with, without the file's name."""
    with pytest.raises(SceneError) as caught:
        Scene.parse(text, "panel.toml")
    line = str(caught.value)
    assert line.startswith("panel.toml: ")
    assert len(line.splitlines()) == 1
    return line.removeprefix("panel.toml: ")


def all_edges():
    """The 16 ways to hold the four sides."""
    return list(itertools.product(("clamped", "supported"), repeat=4))


def edges_id(edges):
    """CSCC for clamped, supported, clamped, clamped."""
    return "".join(edge[0].upper() for edge in edges)


@lru_cache(maxsize=1)
def device_paths():
    """All (device, path) pairs of this machine; CUDA ones only where there is a CUDA device."""
    find_device("cpu")
    devices = ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])]
    return [(device, path) for device in devices for path in paths_of(wp.get_device(device))]


def pytest_generate_tests(metafunc):
    """A test that takes ``device`` and ``path`` runs for every pair; one that takes ``edges`` for all 16
    ways."""
    if {"device", "path"} <= set(metafunc.fixturenames):
        metafunc.parametrize(
            ("device", "path"), device_paths(), ids=["-".join(pair) for pair in device_paths()]
        )
    if "edges" in metafunc.fixturenames:
        metafunc.parametrize("edges", all_edges(), ids=edges_id)


@pytest.fixture(scope="session")
def display():
    """The name of an X display of its own, for tests that press keys and drag the mouse by xdotool."""
    lacking = [program for program in ("Xvfb", "xdotool") if shutil.which(program) is None]
    if lacking:
        pytest.skip(f"{' and '.join(lacking)} not installed: apt-get install xvfb xdotool")
    reading, writing = os.pipe()
    # Without -noreset it starts anew whenever its last window closes, and then refuses the next for a moment.
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
def pairs():
    """All (device, path) pairs of this machine."""
    return device_paths()


@pytest.fixture(scope="session")
def panel():
    """A small panel with few modes below the drive, and so with a cheap reference."""
    patches = [(0.03, 0.06, 0.04, 0.07), (0.12, 0.17, 0.03, 0.08), (0.05, 0.13, 0.11, 0.16)]
    return Scene.model_validate(
        {
            "plate": {
                "size": (0.2, 0.2), "thickness": 5e-4, "young_modulus": 1e9, "poisson_ratio": 0.33, "density": 1000.0,
            },
            "edges": dict.fromkeys(("left", "bottom", "right", "top"), "supported"),
            "window": {"start": 0.01, "end": 0.03},
            "drive": {"frequency": 200.0},
            "target": {"area": (0.0, 0.1, 0.0, 0.1)},
            "effects": {"damping": {"viscous": 300.0}},
            "actuators": [{"name": str(index), "area": area} for index, area in enumerate(patches)],
        }
    )  # fmt: skip


@pytest.fixture
def scene():
    """The factory of small scenes, see :func:`scene_of`."""
    return scene_of


@pytest.fixture
def random():
    """Other numbers every time; a failing test prints the seed, and WARP_PLATE_TEST_SEED repeats them."""
    seed = int(os.environ.get("WARP_PLATE_TEST_SEED", secrets.randbits(32)))
    print(f"WARP_PLATE_TEST_SEED={seed}")
    return np.random.default_rng(seed)


@pytest.fixture
def phasors(random):
    """Random complex drives (plates, actuators)."""

    def draw(plates, actuators):
        return random.normal(size=(plates, actuators)) + 1j * random.normal(size=(plates, actuators))

    return draw


@pytest.fixture
def fitting_solver():
    """PlateSolver(scene, device, path), skipping the test where this path has no room for so large a
    plate."""

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
    """Headless Chromium: one of the system's, else Playwright's own; skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install playwright")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    with playwright.sync_playwright() as started:
        if found is None and not Path(started.chromium.executable_path).exists():
            pytest.skip("there is no Chromium: apt-get install chromium-headless-shell, or playwright install chromium")
        # Containers often forbid Chromium its sandbox; it only meets pages from here.
        made = started.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture
def point_scene():
    """A scene with an actuator on every inner node, row by row, so that any field can be a load."""
    return point_scene_of


def point_scene_of(nodes, size=(0.2, 0.2), edges=("clamped",) * 4, precision="float64", order=2, **changes):
    """Undamped unless ``changes`` say so, and two steps long unless they give a window and a frequency."""
    x, y = (np.linspace(0, length, count)[1:-1] for length, count in zip(size, nodes, strict=True))
    half_x, half_y = (length / (count - 1) / 4 for length, count in zip(size, nodes, strict=True))
    areas = [(i - half_x, i + half_x, j - half_y, j + half_y) for j in y for i in x]
    rigidity = (
        MATERIAL["young_modulus"] * MATERIAL["thickness"] ** 3 / 12 / (1 - MATERIAL["poisson_ratio"] ** 2)
    )
    kappa = math.sqrt(rigidity / (MATERIAL["density"] * MATERIAL["thickness"]))
    step = 0.95 * time_step_limit(kappa, (4 * half_x, 4 * half_y), order=order)
    two_steps = {"time_step": step, "window": (0.0, 2 * step), "frequency": 1 / (STEPS_A_PERIOD * step)}
    return scene_of(
        nodes, size, edges, precision=precision, order=order, load="nodes", actuators=areas,
        **{**two_steps, **changes},
    )  # fmt: skip


@pytest.fixture
def apply_biharmonic():
    """∇⁴u as a path computes it, through nothing but ``run``."""
    return biharmonic_by_running


def biharmonic_by_running(solver, fields):
    """u and ∇⁴u, both (plates, ny, nx) and (plates, ny − 2, nx − 2) [u/m⁴], of loads shaped like ``fields``.

    For a two-step ``point_scene``. The plate rests at t = 0, so u(Δt) has the shape of the load, and no load
    acts at the second step: u(2Δt) − u(Δt) = u(Δt) − (κΔt)²∇⁴u(Δt), which is solved for ∇⁴u.
    """
    scheme = make_scheme(solver.scene)
    drives = fields[:, 1:-1, 1:-1].reshape(len(fields), -1)
    run = solver.run(drives, times=(scheme.time_step, 2 * scheme.time_step))
    first, second = run.displacement[:, 0], run.displacement[:, 1]
    return first, ((2 * first - second) / (scheme.kappa * scheme.time_step) ** 2)[:, 1:-1, 1:-1]


@pytest.fixture
def discrete_operator():
    """The matrix of ∇⁴ on the inner nodes, row by row, as the default path of ``device`` computes it."""
    return operator_by_running


def operator_by_running(scene, device="cpu"):
    """(inner nodes, inner nodes) sparse matrix [1/m⁴] of a two-step ``point_scene``.

    The stencil reaches as many nodes far as its order, two or four, so unit loads five or nine nodes apart do not
    meet: 25 or 81 plates hold all columns.
    """
    from scipy.sparse import coo_array

    (nx, ny), reach = scene.grid.nodes, scene.grid.order
    apart = 2 * reach + 1
    row, column = np.mgrid[:ny, :nx]
    offsets = list(itertools.product(range(apart), repeat=2))
    inside = (row > 0) & (row < ny - 1) & (column > 0) & (column < nx - 1)
    fields = np.array([inside & (row % apart == j) & (column % apart == i) for j, i in offsets], dtype=float)
    unit, response = biharmonic_by_running(PlateSolver(scene, device), fields)
    number = np.where(inside, np.cumsum(inside).reshape(ny, nx) - 1, -1)
    entries = []
    for (j, i), field, answer in zip(offsets, unit, response, strict=True):
        # The node of this colour within reach of each node, if it is an inner one.
        source_row = row + (j - row + reach) % apart - reach
        source_column = column + (i - column + reach) % apart - reach
        known = (
            inside & (source_row > 0) & (source_row < ny - 1) & (source_column > 0) & (source_column < nx - 1)
        )
        source = (source_row[known], source_column[known])
        value = answer[known[1:-1, 1:-1]] / field[source]
        entries.append((value, number[known], number[source]))
    value, to, source = (np.concatenate(part) for part in zip(*entries, strict=True))
    return coo_array((value, (to, source)), shape=(inside.sum(), inside.sum())).tocsr()


@pytest.fixture
def command(capsys):
    """Run a command in this process: (status, standard output, standard error)."""

    def run(*words):
        try:
            main([str(word) for word in words])
            status = 0
        except SystemExit as left:
            status = left.code or 0
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run
