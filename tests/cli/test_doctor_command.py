"""``warp-plate doctor`` and the line about a GPU that is not used, on machines with every fault."""

import json
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
import warp as wp

from support.commands import error_of, output_of
from warp_plate.cli.doctor import EXTRAS
from warp_plate.solve import devices

TURING = SimpleNamespace(alias="cuda:0", name="RTX 2080", arch=75, is_cuda=True, is_cpu=False)
PASCAL = SimpleNamespace(alias="cuda:1", name="GTX 1080", arch=61, is_cuda=True, is_cpu=False)


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A function that sets what Warp says of CUDA, and the GPUs that the system lists."""
    devices._warn_of_unused_gpu.cache_clear()

    def make(toolkit=(13, 0), found=(), models=()):
        monkeypatch.setattr(wp, "get_cuda_toolkit_version", lambda: toolkit)
        monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: (13, 1))
        monkeypatch.setattr(wp, "get_cuda_devices", lambda: list(found))
        monkeypatch.setattr(wp, "get_cuda_supported_archs", lambda: [75, 90] if toolkit else [])
        monkeypatch.setattr(wp, "is_cuda_available", lambda: bool(found))
        for index, model in enumerate(models):
            place = tmp_path / f"0000:0{index}:00.0"
            place.mkdir()
            (place / "information").write_text(f"Model: \t\t {model}\nIRQ:   \t\t 34\n")
        monkeypatch.setattr(devices, "GPU_LISTINGS", tmp_path)

    yield make
    devices._warn_of_unused_gpu.cache_clear()


def checks(command):
    """The lines of the report by name."""
    status, out, _ = command("doctor", "--json")
    record = json.loads(out)
    assert record["ok"] == (status == 0)
    assert status == int(any(check["state"] == "error" for check in record["checks"]))
    return {check["name"]: check for check in record["checks"]}


def test_this_machine(command):
    found = checks(command)
    assert found["Python"]["text"].startswith(f"{sys.version_info.major}.{sys.version_info.minor}.")
    assert found["Warp"]["text"].startswith(wp.config.version)
    assert {"CPU", "kernels", "results", "pictures", "window", "browser", "extra viz"} <= found.keys()
    for device in wp.get_cuda_devices():
        assert 0 < found[device.alias]["free_memory"] <= device.total_memory
    words = output_of(command("doctor"))
    assert all(name in words for name in found)


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        ({"toolkit": None}, "without CUDA"),
        ({}, "Warp finds no GPU with a driver for CUDA 13 or later"),
        ({"found": [PASCAL]}, "GTX 1080 has compute capability 6.1, and the installed Warp needs 7.5"),
    ],
)
def test_why_cuda_is_not_used(command, machine, state, reason):
    machine(**state)
    line = checks(command)["GPU"]
    assert line["state"] == "missing"
    assert reason in line["text"]


def test_commands_say_once_that_a_gpu_is_not_used(command, machine):
    machine(models=["NVIDIA RTX A2000"])
    status, _, err = command("check", "paper")
    assert status == 0
    assert err.startswith("warp-plate: NVIDIA RTX A2000: not used: Warp finds no GPU with a driver for CUDA 13")
    assert err.count("\n") == 1
    assert command("check", "paper", "--device", "cpu")[2] == ""


def test_a_device_that_warp_cannot_compile_for_is_refused(command, machine, monkeypatch):
    machine(found=[PASCAL])
    monkeypatch.setattr(wp, "get_device", {"cuda:1": PASCAL, "cpu": wp.get_device("cpu")}.get)
    line = error_of(command("check", "paper", "--device", "cuda:1"))
    assert "device = 'cuda:1': GTX 1080 has compute capability 6.1" in line


def test_extras_are_those_of_the_project():
    text = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    assert set(EXTRAS) == set(extras) - {"docs", "test"}
    for extra, module in EXTRAS.items():
        assert any(requirement.startswith(module) for requirement in extras[extra])


def test_what_lacks_has_its_remedy(command, monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "gone"))
    found = checks(command)
    assert "WARP_CACHE_PATH" in found["kernels"]["text"]
    assert found["extra uff"]["text"] == "pyuff not found: pip install 'warp-plate[uff]'"
    assert {name for name, line in found.items() if line["state"] == "error"} == {"kernels"}


def test_a_check_that_fails_is_a_finding(command, monkeypatch):
    monkeypatch.setenv("WARP_PLATE_THREADS", "many")
    line = checks(command)["devices"]
    assert line["state"] == "error"
    assert "WARP_PLATE_THREADS" in line["text"]


def test_what_a_gpu_is(command, machine):
    memory = {"free_memory": 7 * 2**30, "total_memory": 8 * 2**30}
    turing = SimpleNamespace(**vars(TURING), **memory)
    machine(found=[PASCAL, turing])
    assert (devices.missing_cuda(), devices.usable_devices()) == (None, [turing])
    found = checks(command)
    assert "RTX 2080, sm_75, driver for CUDA 13.1, 7 of 8 GiB free" in found["cuda:0"]["text"]
    assert found["cuda:1"]["state"] == "missing"
    assert "GTX 1080 has compute capability 6.1" in found["cuda:1"]["text"]
