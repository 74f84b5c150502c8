"""``warp-plate doctor``: check this installation and suggest remedies."""

from __future__ import annotations

import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from warp_plate._version import __version__
from warp_plate.cli import options, output
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    import warp as wp
    from rich.console import Console

# Such as: pyvista>=0.46; extra == "viz". Requirements under other conditions are left to pip.
REQUIREMENT = re.compile(r"""([\w.-]+)(?:\[(\w+)\])?(?:>=([\d.]+))?(?: ?; ?extra == ["'](\w+)["'])?""")
OTHER_CACHE = "WARP_CACHE_PATH can name another folder"
CheckState = Literal["ok", "missing", "error"]


@dataclass(frozen=True)
class Diagnosis:
    """A line of the report."""

    name: str
    state: CheckState  # missing: not needed; error: needed and broken
    text: str  # finding, and the remedy if it is not ok
    details: Mapping[str, object] = field(default_factory=dict)


def doctor(*, json: options.Json = False) -> None:
    """Check the GPUs, folders, drawing and extras of this installation, and suggest remedies.

    The exit status is 1 if something that every command needs is broken.
    """
    diagnoses = [diagnosis for name, check in CHECKS.items() for diagnosis in _run(name, check)]
    broken = any(diagnosis.state == "error" for diagnosis in diagnoses)

    def show(console: Console) -> None:
        console.print(output.lines_table((line.name, line.state, line.text) for line in diagnoses))

    lines = [{"name": line.name, "state": line.state, "text": line.text, **line.details} for line in diagnoses]
    output.report(json, lambda: {"ok": not broken, "checks": lines}, show)
    if broken:
        sys.exit(1)


def _run(name: str, check: Callable[[], Iterator[Diagnosis]]) -> Iterator[Diagnosis]:
    """Yield the findings of a check; an exception is a finding too."""
    try:
        yield from check()
    except Exception as error:
        yield Diagnosis(name, "error", f"{type(error).__name__}: {error}")


def _check_python() -> Iterator[Diagnosis]:
    yield Diagnosis("Python", "ok", f"{platform.python_version()}, {sys.executable}, {platform.platform()}")
    yield Diagnosis("warp-plate", "ok", f"{__version__}, {Path(__file__).parents[1]}")


def _check_devices() -> Iterator[Diagnosis]:
    from warp_plate.solve import devices

    try:
        cpu = devices.find_device("cpu")
    except SceneError as error:  # Warp makes the folder when it starts
        yield Diagnosis("kernels", "error", str(error))
        return
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
    yield _diagnose_folder("kernels", devices.kernel_folder(), "error", OTHER_CACHE)


def _diagnose_gpu(device: wp.Device) -> Diagnosis:
    from warp_plate.accuracy import machine
    from warp_plate.scene.model import Scene
    from warp_plate.solve import devices

    if device not in devices.usable_devices():
        return Diagnosis(device.alias, "missing", devices.too_old(device))
    sides, plates = machine.largest_resident_sides(device), machine.plates_in_memory(Scene.load("paper"), device)
    on_chip = ", ".join(f"{side}² ({kind})" for kind, side in sides.items())
    text = (
        f"{device.name}, sm_{device.arch}, {devices.describe_driver()}, "
        f"{device.free_memory / 2**30:.3g} of {device.total_memory / 2**30:.3g} GiB free; on the chip plates of up to "
        f"{on_chip} nodes, in memory {plates} like the paper's"
    )
    memory = output.attributes(device, "arch", "free_memory", "total_memory")
    return Diagnosis(device.alias, "ok", text, {**memory, "resident_sides": sides, "plates": plates})


def _check_results() -> Iterator[Diagnosis]:
    yield _diagnose_folder("results", Path.cwd(), "missing", "--out can name a file elsewhere")


def _diagnose_folder(name: str, folder: Path, state: CheckState, remedy: str) -> Diagnosis:
    try:
        with tempfile.TemporaryFile(dir=folder):
            return Diagnosis(name, "ok", f"{folder}, {shutil.disk_usage(folder).free / 2**30:.3g} GiB free")
    except OSError as error:
        return Diagnosis(name, state, f"{folder} cannot be written: {error.strerror}; {remedy}")


def _check_drawing() -> Iterator[Diagnosis]:
    from warp_plate.cli.explore import has_desktop
    from warp_plate.viz.availability import missing_renderer, missing_window

    remote = None if has_desktop() else "no desktop here; 'explore SCENE --web' prints an address to open elsewhere"
    for name, problem in (("pictures", missing_renderer()), ("window", missing_window()), ("browser", remote)):
        yield Diagnosis(name, "missing" if problem else "ok", problem or "works")


def _check_packages() -> Iterator[Diagnosis]:
    """Check the requirements that pyproject.toml states, and those of each extra."""
    try:
        stated = metadata.metadata("warp-plate")
    except metadata.PackageNotFoundError:
        yield Diagnosis("packages", "missing", "warp-plate is not installed, only found: pip install -e .")
        return
    requirements = [
        match.groups() for text in stated.get_all("Requires-Dist", []) if (match := REQUIREMENT.fullmatch(text))
    ]
    for extra in (None, *stated.get_all("Provides-Extra", [])):
        packages = dict(_packages_of(extra, requirements))
        lacking = [text for package, least in packages.items() if (text := _why_unfit(package, least))]
        name, target = ("packages", "") if extra is None else (f"extra {extra}", f"[{extra}]")
        if lacking:
            remedy = f"pip install --upgrade 'warp-plate{target}'"
            yield Diagnosis(name, "missing" if extra else "error", f"{', '.join(lacking)}: {remedy}")
            continue
        versions = {package: metadata.version(package) for package in packages}
        listed = ", ".join(map(" ".join, versions.items()))
        yield Diagnosis(name, "ok", listed if extra is None else "installed", {"versions": versions})


def _packages_of(extra: str | None, requirements: list[tuple[str | None, ...]]) -> Iterator[tuple[str, str | None]]:
    """Yield the packages of an extra with their lowest versions, those of extras that it includes too."""
    for package, included, least, of in requirements:
        if of == extra and included:
            yield from _packages_of(included, requirements)
        elif of == extra and package:
            yield package, least


def _why_unfit(package: str, least: str | None) -> str | None:
    """Return why an installed package does not meet a requirement, or None if it does."""
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        return f"{package} is not installed"
    installed, wanted = ([int(part) for part in re.findall(r"\d+", text)] for text in (version, least or "0"))
    return f"{package} {version} is older than {least}" if installed < wanted else None


CHECKS: dict[str, Callable[[], Iterator[Diagnosis]]] = {
    "Python": _check_python,
    "Warp": _check_devices,
    "results": _check_results,
    "drawing": _check_drawing,
    "packages": _check_packages,
}
