"""``warp-plate doctor``: check this installation and suggest remedies."""

import importlib.util
import platform
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from warp_plate._version import __version__
from warp_plate.cli import options, output
from warp_plate.cli.explore import has_desktop

# A module of each extra that commands use.
EXTRAS = {
    "viz": "pyvista",
    "web": "trame",
    "cma": "cma",
    "cluster": "distributed",
    "data": "xarray",
    "uff": "pyuff",
    "cad": "ezdxf",
}


@dataclass(frozen=True)
class Diagnosis:
    """A line of the report."""

    name: str
    state: Literal["ok", "missing", "error"]  # missing: not needed; error: needed and broken
    text: str  # finding, and the remedy if it is not ok
    details: Mapping[str, object] = field(default_factory=dict)


def doctor(*, json: options.Json = False) -> None:
    """Check the GPUs, folders, drawing and extras of this installation, and suggest remedies.

    The exit status is 1 if something that every command needs is broken.
    """
    lines: list[Diagnosis] = []
    for check in (_check_python, _check_devices, _check_drawing, _check_extras):
        try:
            lines += check()
        except Exception as error:
            lines.append(Diagnosis(check.__name__.removeprefix("_check_"), "error", str(error)))
    broken = any(line.state == "error" for line in lines)
    record = [{"name": line.name, "state": line.state, "text": line.text, **line.details} for line in lines]
    rows = ((line.name, line.state, line.text) for line in lines)
    output.report(json, lambda: {"ok": not broken, "checks": record}, lambda console: output.print_lines(console, rows))
    if broken:
        sys.exit(1)


def _check_python() -> Iterator[Diagnosis]:
    yield Diagnosis("Python", "ok", f"{platform.python_version()}, {sys.executable}, {platform.platform()}")
    yield Diagnosis("warp-plate", "ok", f"{__version__}, {Path(__file__).parents[1]}")
    yield _diagnose_folder("results", Path.cwd(), "missing", "--out can name a file elsewhere")


def _check_devices() -> Iterator[Diagnosis]:
    from warp_plate.solve import devices

    cpu = devices.find_device("cpu")
    yield Diagnosis("Warp", "ok", devices.describe_warp())
    if devices.can_compile_for_cpu():
        yield Diagnosis("CPU", "ok", f"{devices.processor_of(cpu)}, {devices.cpu_threads()} threads")
    else:
        yield Diagnosis("CPU", "error", "Warp cannot load its compiler: pip install --force-reinstall warp-lang")
    if reason := devices.missing_cuda():
        gpus = devices.visible_gpus()
        yield Diagnosis("GPU", "missing", f"{'; '.join(gpus) or 'none visible'}: {reason}", {"gpus": gpus})
    for device in devices.cuda_devices():
        yield _diagnose_gpu(device)
    yield _diagnose_folder("kernels", devices.kernel_folder(), "error", "WARP_CACHE_PATH can name another folder")


def _diagnose_gpu(device: Any) -> Diagnosis:
    from warp_plate.solve import devices

    if device not in devices.usable_devices():
        return Diagnosis(device.alias, "missing", devices.too_old(device))
    text = (
        f"{device.name}, sm_{device.arch}, {devices.describe_driver()}, "
        f"{device.free_memory / 2**30:.3g} of {device.total_memory / 2**30:.3g} GiB free"
    )
    return Diagnosis(device.alias, "ok", text, output.attributes(device, "arch", "free_memory", "total_memory"))


def _diagnose_folder(name: str, folder: Path, state: Literal["missing", "error"], remedy: str) -> Diagnosis:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return Diagnosis(name, "ok", f"{folder}, {shutil.disk_usage(folder).free / 2**30:.3g} GiB free")
    except OSError as error:
        return Diagnosis(name, state, f"{folder} cannot be written: {error.strerror}; {remedy}")


def _check_drawing() -> Iterator[Diagnosis]:
    from warp_plate.viz.availability import missing_renderer, missing_window

    remote = None if has_desktop() else "no desktop here; 'explore SCENE --web' prints an address to open elsewhere"
    for name, problem in (("pictures", missing_renderer()), ("window", missing_window()), ("browser", remote)):
        yield Diagnosis(name, "missing" if problem else "ok", problem or "works")


def _check_extras() -> Iterator[Diagnosis]:
    """Check that a package of each extra is there; versions are pip's business."""
    for extra, module in EXTRAS.items():
        if importlib.util.find_spec(module) is None:
            yield Diagnosis(f"extra {extra}", "missing", f"{module} not found: pip install 'warp-plate[{extra}]'")
        else:
            yield Diagnosis(f"extra {extra}", "ok", "installed")
