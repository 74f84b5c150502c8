"""Plates on workers: the same bits as in one process, whatever happens to the workers or their scheduler."""

import os
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from support.commands import error_of, start_program
from support.inline_pool import InlinePool, KilledWorker
from support.worker_tasks import doubled, end_worker, process_number
from support.workers import PLATES, assert_same_history, assert_same_run, random_phasors, small_search
from warp_plate import CheckpointFile, PlateSolver, SceneError, load_checkpoint, load_result, localize, resume
from warp_plate.cli.localize import _as_json
from warp_plate.cli.options import WorkerOptions
from warp_plate.cluster.evaluator import make_evaluator
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import Task, WorkersGone, run_tasks
from warp_plate.plate.designs import Designs, per_plate_of
from warp_plate.problem.uncertainty import draw_scenarios, simulate_scenarios
from warp_plate.resolve import resolve
from warp_plate.result.model import save_result

distributed = pytest.importorskip("distributed")
dask = pytest.importorskip("dask")
psutil = pytest.importorskip("psutil")  # which Dask needs as well
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
LINES = []  # logged as the pool was opened


@pytest.fixture(scope="module")
def pool():
    """Two workers, started once for all tests here, that get blocks of the fewest plates."""
    with open_pool("cpu,cpu", None, log=LINES.append) as opened:
        opened.block_node_steps = {"cpu": (1.0, 1.0)}
        yield opened


def worker_processes(pool):
    """The numbers of both workers' processes."""
    numbers = set()
    while len(numbers) < 2:
        numbers |= {outcome.value for _, outcome in run_tasks(pool, [Task(process_number, 0.05) for _ in range(4)])}
    return sorted(numbers)


def random_designs(scene, random):
    """Designs that differ in all that the scene's search frees."""
    per_plate, whole = per_plate_of(scene), np.ones((1, 3))
    return Designs(
        random_phasors(random),
        random.uniform(250, 300, (PLATES, 1)) * whole if per_plate.frequency else None,
        random.uniform(0.09, 0.11, (PLATES, 3, 2)) if per_plate.centre else None,
        random.uniform(0, 1e-3, (PLATES, 1)) * whole if per_plate.delay else None,
    )


SCENES = {
    "stretching": {"effects": {"stretching": {}, "damping": {"viscous": 20.0}}},
    "signal": {"damping": 20.0, "drive": {"frequency": 290.0, "signal": {"file": "pulse.csv"}}},
    "designs": {
        "precision": "float32",
        "drive": {"frequency": 290.0, "burst": {"duration": 2e-3, "ramp": 5e-4}},
        "search": {"frequency": {"range": [250.0, 300.0]}, "position": {}, "delay": {"range": [0.0, 1e-3]}},
    },
}


@pytest.mark.parametrize("name", ["stretching", pytest.param("signal", marks=pytest.mark.slow), "designs"])
def test_workers_give_the_bits_of_one_process(name, pool, scene, random, tmp_path):
    """Also of a plate that fails, by its number in the batch, and of a signal in a file that workers cannot read."""
    (tmp_path / "pulse.csv").write_text("time,value\n0,0\n0.002,1\n0.004,0\n", encoding="utf-8")
    panel = scene((9, 9), window=(0.002, 0.004), **SCENES[name]).in_folder(tmp_path)
    options = {"per_plate": per_plate_of(panel), "areas": {"left": (0, 0.1, 0, 0.2)}}
    if name == "signal":
        options["quantity"] = "displacement"
    designs = random_designs(panel, random)
    designs.drives[70] = np.nan
    solver = PlateSolver(panel, "cpu", **options)
    expected, none = solver.run(designs), solver.run(designs[:0])
    evaluator = make_evaluator(panel, "cpu", pool=pool, **options)
    (tmp_path / "pulse.csv").unlink()
    assert expected.faults.keys() == {70}
    assert_same_run(evaluator.run(designs), expected)
    assert_same_run(evaluator.run(designs[:0]), none)
    assert evaluator.node_steps == expected.node_steps
    assert not evaluator.lost
    if designs.frequency is not None:
        designs.frequency[70] = -1.0
        with pytest.raises(SceneError, match=r"designs\.frequency: -1\.0 of actuator .* on plate 70;"):
            evaluator.run(designs)


def test_searches_give_the_same_on_workers(pool, scene, random):
    objectives = [{"kind": "localization"}, {"kind": "displacement", "weight": 1e3}]
    panel = small_search(scene, iterations=2, objectives=objectives, magnitude={"range": [0.0, 1.0]})
    result = localize(panel, device="cpu", estimate=False, pool=pool)
    assert_same_history(result, localize(panel, device="cpu", estimate=False))
    assert result.device.endswith("plates of the search on up to 2 Dask workers (cpu,cpu)")
    assert LINES[0].startswith("dashboard of the workers: http://127.0.0.1:")
    robust = small_search(scene, robust={"young_modulus": 0.1, "scenarios": 3})
    scenarios, phasors = draw_scenarios(robust, 3, 0), random_phasors(random)
    here, there = (simulate_scenarios(scenarios, resolve(scenarios[0].scene, "cpu"), run_by) for run_by in (None, pool))
    assert there.losses(Designs(phasors)).tobytes() == here.losses(Designs(phasors)).tobytes()


def test_tasks_of_any_function(pool):
    """Whoever leaves early can come again; a task that is refused ends them all."""
    progress = []
    pool.on_progress = lambda done, total: progress.append((done, total))
    values = {task.key: outcome.value for task, outcome in run_tasks(pool, [Task(doubled, at, at) for at in range(9)])}
    pool.on_progress = None
    assert values == {at: 2 * at for at in range(9)}
    assert progress == [(done, 9) for done in range(1, 10)]
    for _ in run_tasks(pool, [Task(doubled, 1) for _ in range(50)]):
        break
    with pytest.raises(SceneError, match="a worker: value = 13: no"):
        list(run_tasks(pool, [Task(doubled, at) for at in range(14)]))
    with pytest.raises(SceneError, match="a worker cannot import absent: install the same warp-plate on every worker"):
        list(run_tasks(pool, [Task(doubled, 14)]))
    outcomes = run_tasks(pool, [Task(doubled, at, at) for at in range(100, 110)])
    assert {task.key: outcome.value for task, outcome in outcomes} == {at: 2 * at for at in range(100, 110)}


@pytest.mark.parametrize(
    ("devices", "cluster", "line"),
    [
        ("cpu,", None, "--devices cpu,: must be devices with commas between"),
        ("cpu,cuda:99", None, "--devices cpu,cuda:99: device = 'cuda:99': not on this machine"),
        ("cpu", "tcp://far:8786", "--devices, --cluster: give one of them"),
        (None, "missing.json", "--cluster missing.json: no such file"),
        (None, "tcp://far:8786", r"--cluster tcp://far:8786: .* pip install 'warp-plate\[cluster\]'"),
        ("cpu,cpu", None, r"--devices cpu,cpu: .* pip install 'warp-plate\[cluster\]'"),
    ],
)
def test_pools_that_cannot_be(devices, cluster, line, monkeypatch):
    if "pip" in line:
        monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SceneError, match=line), open_pool(devices, cluster):
        pass


def test_a_device_beside_devices_is_refused(command):
    line = error_of(command("localize", "paper", "--devices", "cpu,cpu", "--device", "cpu"))
    assert "--device cpu: --devices cpu,cpu already says where plates run" in line
    assert WorkerOptions(devices="cpu, cuda:0").local_device == "cpu"


def test_workers_that_cannot_start_are_one_line(monkeypatch):
    monkeypatch.setenv("DASK_DISTRIBUTED__WORKER__PRELOAD", "absent_module")
    dask.config.refresh()
    try:
        with pytest.raises(SceneError, match="--devices cpu: workers cannot start: "), open_pool("cpu", None):
            pass
    finally:
        monkeypatch.undo()
        dask.config.refresh()


@POSIX
@pytest.mark.parametrize("ends_workers", [False, True])
def test_sigterm_waits_until_workers_have_started(ends_workers, monkeypatch):
    """Dask prints tracebacks if it is interrupted meanwhile; a signal to all processes ends its workers as well."""
    started = []

    def start_cluster(*given, **options):
        os.kill(os.getpid(), signal.SIGTERM)
        started.append(options)
        if ends_workers:
            raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr(distributed, "SpecCluster", start_cluster)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), open_pool("cpu", None):
            pass
    finally:
        signal.signal(signal.SIGTERM, before)
    assert len(started) == 1


TRACKED = """
from warp_plate.cluster.opening import interrupts_blocked

with interrupts_blocked():
    print(flush=True)
input()
"""


@POSIX
def test_a_closed_terminal_leaves_pythons_tracker_of_semaphores():
    """If that ends before the command, it prints tracebacks."""
    program = start_program("-c", TRACKED, stdin=subprocess.PIPE)
    program.stdout.readline()
    (tracker,) = psutil.Process(program.pid).children()
    tracker.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    assert tracker.status() != psutil.STATUS_ZOMBIE
    assert program.communicate("\n", timeout=60) == ("", "")


def test_a_low_limit_of_open_files_is_refused(monkeypatch):
    limits = pytest.importorskip("resource")
    monkeypatch.setattr(limits, "getrlimit", lambda kind: (20, 20))
    line = "--devices cpu,cpu: needs up to 52 open files, but ulimit -n allows 20"
    with pytest.raises(SceneError, match=line), open_pool("cpu,cpu", None):
        pass


def listening(pool):
    """The addresses at which this process and the workers' listen."""
    processes = [psutil.Process(number) for number in (os.getpid(), *worker_processes(pool))]
    return [
        connection.laddr
        for process in processes
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells who listens where")
def test_nobody_else_can_use_the_workers(pool):
    """Scheduler, workers, nannies and dashboards listen only to this machine; whoever lacks the certificate is refused.

    The dashboards, which run nothing, speak HTTP.
    """
    addresses = listening(pool)
    assert {address.ip for address in addresses} == {"127.0.0.1"}
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    refused = 0
    for address in addresses:
        with socket.create_connection(address, 60) as plain:
            plain.sendall(b"GET / HTTP/1.0\r\n\r\n")
            with suppress(ConnectionError):
                if plain.recv(4) == b"HTTP":
                    continue
        opened = context.wrap_socket(socket.create_connection(address, 60))
        with opened, pytest.raises(ssl.SSLError, match="CERTIFICATE_REQUIRED"):
            opened.recv(1)
        refused += 1
    assert refused >= 3  # scheduler and workers


@POSIX
def test_ctrl_c_is_for_the_command_alone(pool):
    """A terminal sends it to the workers too, which finish their tasks."""
    workers = worker_processes(pool)
    for number in workers:
        os.kill(number, signal.SIGINT)
    assert worker_processes(pool) == workers


@POSIX
def test_workers_killed_at_random_moments_change_nothing(pool, scene, random):
    panel, phasors = scene((9, 9), window=(0.002, 0.02), damping=20.0), random_phasors(random, 1000)
    expected = PlateSolver(panel, "cpu").run(phasors)
    evaluator = make_evaluator(panel, "cpu", pool=pool)
    evaluator.run(phasors[:1])
    victim = int(random.choice(worker_processes(pool)))
    killer = threading.Timer(random.uniform(0, 0.3), os.kill, (victim, signal.SIGKILL))
    killer.start()
    assert_same_run(evaluator.run(phasors), expected)
    killer.join()
    assert not evaluator.lost


@pytest.mark.slow
def test_tasks_that_no_worker_survives(pool):
    """Those that wait with them are not to blame; after an error of CUDA a worker starts anew."""
    before = worker_processes(pool)
    queue = [Task(end_worker, 0, "end"), *(Task(doubled, value, value) for value in range(9))]
    outcomes = {task.key: outcome for task, outcome in run_tasks(pool, [*queue, Task(doubled, 17, 17, attempts=2)])}
    given_up = "given up after 3 attempts: "
    assert outcomes.pop("end").failure == given_up + "its worker ended"
    assert outcomes.pop(17).failure == given_up + "RuntimeError: CUDA error 700: an illegal memory access"
    assert {value: outcome.value for value, outcome in outcomes.items()} == {value: 2 * value for value in range(9)}
    assert worker_processes(pool) != before


class Failing(InlinePool):
    """A worker that ends under blocks of one size, has room for few plates, or does so many tasks and no more."""

    def __init__(self, tasks_left=10**9, under=None, room=10**9):
        super().__init__()
        self.tasks_left, self.under, self.room = tasks_left, under, room

    def worker_count(self):
        if self.tasks_left <= 0:
            raise WorkersGone("no worker is left: of a test")
        return 1

    def run(self, function, argument):
        self.tasks_left -= 1
        plates = len(argument[1])
        if plates == self.under:
            raise KilledWorker
        return super().run(too_large if plates > self.room else function, argument)


def too_large(block):
    raise RuntimeError("Failed to allocate 999 bytes on device 'cuda:0'")


def test_plates_for_which_memory_is_short_are_given_up_by_name(scene, random):
    evaluator = make_evaluator(scene((9, 9), damping=20.0), "cpu", pool=Failing(room=0))
    assert evaluator.run(random_phasors(random)).node_steps == 0
    why = "out of memory (Failed to allocate 999 bytes on device 'cuda:0')"
    assert evaluator.lost == {f"block given up after 3 attempts: {why}": PLATES}


def test_lost_plates_are_in_the_result(tmp_path, scene, random):
    """A block that no worker survives is named by its plates; they count as worst, and the file says how many and why,
    also after a checkpoint."""
    panel = small_search(scene, iterations=2)
    evaluator, phasors = make_evaluator(panel, "cpu", pool=Failing(under=22)), random_phasors(random)
    evaluation, expected = evaluator.run(phasors), PlateSolver(panel, "cpu").run(phasors)
    why = "block given up after 3 attempts: its worker ended"
    assert {plate: word for plate, (word, _) in evaluation.faults.items()} == dict.fromkeys(range(128, PLATES), why)
    assert np.isnan(evaluation.energy[128:]).all()
    assert evaluation.energy[:128].tobytes() == expected.energy[:128].tobytes()
    assert evaluation.node_steps == 128 * evaluator.solver.node_steps_per_plate
    file = CheckpointFile(tmp_path / "panel.checkpoint.h5", 0.0)
    result = localize(panel, device="cpu", estimate=False, pool=Failing(under=22), checkpoints=file)
    assert result.lost_plates == {why: 2 * 22}
    assert load_checkpoint(tmp_path / "panel.checkpoint.h5").lost_plates[why] >= 22
    assert _as_json(None, result)["lost"] == result.lost_plates
    assert result.evaluations == 2 * PLATES
    assert result.cases["best"].localization_factor > 0
    assert load_result(save_result(result, tmp_path / "panel.h5")).lost_plates == result.lost_plates
    (line,) = (line for line in result.warnings if "failed on the workers" in line)
    assert "44 plates" in line
    assert why in line


def test_a_search_whose_workers_are_gone_can_go_on(tmp_path, scene):
    panel, path = small_search(scene), tmp_path / "panel.checkpoint.h5"
    expected = localize(panel, device="cpu", estimate=False)
    with pytest.raises(WorkersGone, match="of a test"):
        localize(panel, device="cpu", estimate=False, pool=Failing(10), checkpoints=CheckpointFile(path, np.inf))
    begun = load_checkpoint(path)
    assert 0 < begun.iterations < 4
    assert_same_history(resume(begun, "cpu", estimate=False, pool=InlinePool()), expected)


SLEEPING = """
import sys, time
from support.worker_tasks import process_number
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import Task, run_tasks

if __name__ == "__main__":
    with open_pool("cpu,cpu", None) as pool:
        print(*(outcome.value for _, outcome in run_tasks(pool, [Task(process_number, 1.0)] * 2)), flush=True)
        list(run_tasks(pool, [Task(time.sleep, 1000), Task(time.sleep, 1000)]))
"""


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("end", ["killed", "interrupted while a worker hangs", "interrupted twice meanwhile"])
def test_workers_end_with_the_program(end, tmp_path, monkeypatch):
    (tmp_path / "sleeping.py").write_text(SLEEPING, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    process = start_program("sleeping.py", cwd=tmp_path)
    workers = [psutil.Process(int(number)) for number in process.stdout.readline().split()]
    assert len(set(workers)) == 2
    if end == "killed":
        process.kill()
    else:
        workers[0].suspend()
        process.send_signal(signal.SIGINT)
        time.sleep(0.7)
        if "twice" in end:
            process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert psutil.wait_procs(workers, timeout=10)[1] == []


@pytest.mark.slow
@POSIX
def test_ctrl_c_ends_a_command_with_workers_by_its_best(tmp_path, scene):
    """All processes of the command receive the signal, as from a terminal."""
    file = tmp_path / "panel.toml"
    file.write_text(small_search(scene, iterations=10**6).to_toml(), encoding="utf-8")
    options = ["--devices", "cpu,cpu", "--no-pictures", "--no-estimate", "--checkpoint-every", "0"]
    process = start_program("-m", "warp_plate", "localize", file, *options, cwd=tmp_path, start_new_session=True)
    while not (tmp_path / "panel-localize.checkpoint.h5").exists() and process.poll() is None:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert errors.count("\n") == 2
    dashboard, interrupted = errors.splitlines()
    assert dashboard.startswith("warp-plate: dashboard of the workers: ")
    assert interrupted.startswith("warp-plate: interrupted after ")
    assert load_result(tmp_path / "panel-localize.h5").interrupted


class Described(InlinePool):
    """A worker that gives a description of itself in which some entries are false."""

    false = ()

    def run(self, function, argument):
        evaluation, description = super().run(function, argument)
        return evaluation, {**description, **dict(self.false)}


def test_workers_must_be_alike_and_have_their_device(scene):
    """Their kind and versions must agree; their processors may differ."""
    with pytest.raises(SceneError, match="a worker: device = 'cuda:99': not on this machine"):
        make_evaluator(scene((9, 9)), "cpu", pool=InlinePool("cuda:99")).run([[1, 1, 1]])
    pool = Described()
    evaluator = make_evaluator(scene((9, 9)), "cpu", pool=pool)
    evaluator.run([[1, 1, 1]])
    pool.false = {"processor": "0.0"}
    evaluator.run([[1, 1, 1]])
    pool.false = {"kind": "cuda"}
    with pytest.raises(SceneError, match="workers: kind is cuda on one"):
        evaluator.run([[1, 1, 1]])
    for name in ("warp", "warp_plate"):
        pool.false = {name: "0.0"}
        for other in (evaluator, make_evaluator(scene((9, 9)), "cpu", pool=pool)):
            with pytest.raises(SceneError, match=f"workers: {name} is 0.0 on one"):
                other.run([[1, 1, 1]])


def test_no_scheduler_is_one_line(tmp_path):
    file = tmp_path / "scheduler.json"
    for text in ("x", '{"address": 7}', "[1]", "[" * 10**5):
        file.write_text(text, encoding="utf-8")
        line = r"scheduler.json: (has no address|no scheduler answers there)"
        with pytest.raises(SceneError, match=line), open_pool(None, str(file), answer_seconds=0.5):
            pass
    for where in ("tcp://127.0.0.1:1", "tls://127.0.0.1:1", "ucx://127.0.0.1:1"):  # a reserved port
        line = f"--cluster {where}: no scheduler answers there"
        with pytest.raises(SceneError, match=line), open_pool(None, where, answer_seconds=0.5):
            pass
    assert dask.config.get("scheduler", None) is None  # Dask's other users in this process keep theirs


@pytest.mark.slow
@POSIX
def test_a_silent_server_is_waited_for_until_ctrl_c():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        process = start_program("-m", "warp_plate", "localize", "paper", "--cluster", address)
        silent.settimeout(60)
        with silent.accept()[0]:
            process.send_signal(signal.SIGINT)
            assert process.communicate(timeout=60) == ("", "warp-plate: interrupted\n")
    assert process.returncode == 130


def start(*words):
    """Start a program of Dask's, as ``dask scheduler`` and ``dask worker`` are."""
    return start_program("-m", *words, "--host", "127.0.0.1", stdout=None, stderr=subprocess.DEVNULL)


@pytest.mark.slow
@POSIX
@pytest.mark.parametrize("lost", ["scheduler killed", "scheduler stopped", "worker killed"])
def test_a_scheduler_that_goes_away_leaves_a_checkpoint(lost, tmp_path, scene):
    """A search with the scheduler's file continues in this process, to the same result."""
    panel, file = small_search(scene, iterations=400), tmp_path / "scheduler.json"
    scheduler = start("distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    while not file.exists():
        time.sleep(0.1)
    worker = start("distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--scheduler-file", str(file))
    path = tmp_path / "panel.checkpoint.h5"

    def after(done, total, best):
        if done == 5:
            victim = worker if "worker" in lost else scheduler
            victim.send_signal(signal.SIGSTOP if "stopped" in lost else signal.SIGKILL)

    try:
        checkpoints = CheckpointFile(path, np.inf)
        with open_pool(None, str(file)) as there:
            there.join_seconds = 5.0
            with pytest.raises(WorkersGone, match="the scheduler is gone"):
                localize(panel, device="cpu", estimate=False, pool=there, on_progress=after, checkpoints=checkpoints)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    begun = load_checkpoint(path)
    assert 5 <= begun.iterations < 400
    result = resume(begun, "cpu", estimate=False, pool=InlinePool())
    assert_same_history(result, localize(panel, device="cpu", estimate=False))
