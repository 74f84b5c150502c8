"""Whether pictures can be drawn off screen here, found out without risk, and what to install if not.

VTK's Linux wheels (9.5 and later) link against no graphics library. They look for one when a window is made:
libX11 and libGL, then libEGL.so.1, then libOSMesa.so.8. Where the last one is missing too, or where there is a
libEGL.so.1 but no driver behind it, VTK does not raise: the process ends with a segmentation fault. So the first
drawing is tried in a process of its own, and VTK is then told by name which kind of window worked there.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
EXTRA = "pip install 'warp-plate[viz]'"
SYSTEM = (
    "on Debian or Ubuntu 'apt-get install libegl1 libgl1-mesa-dri' (as root) brings what is needed; on Fedora "
    "'dnf install mesa-libEGL mesa-dri-drivers'"
)
# A probe takes about half a second; reading VTK from a slow disk for the first time can take many.
PATIENCE = 60.0

# Draws a triangle that fills the window; prints the kind of window, and whether the triangle can be seen.
PROBE = """
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except ImportError:
    pass
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkFiltersSources import vtkRegularPolygonSource
from vtkmodules.vtkRenderingCore import (
    vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter)
source, mapper, actor = vtkRegularPolygonSource(), vtkPolyDataMapper(), vtkActor()
source.SetNumberOfSides(3)
mapper.SetInputConnection(source.GetOutputPort())
actor.SetMapper(mapper)
actor.GetProperty().LightingOff()
window, renderer, image = vtkRenderWindow(), vtkRenderer(), vtkWindowToImageFilter()
window.SetOffScreenRendering(1)
window.SetSize(32, 32)
window.AddRenderer(renderer)
renderer.AddActor(actor)
window.Render()
image.SetInput(window)
image.Update()
print(window.GetClassName(), image.GetOutput().GetScalarRange()[1] > 100, flush=True)
"""


class DrawingUnavailable(RuntimeError):
    """A library that drawing needs is not there; one sentence that says what to install."""


@dataclass(frozen=True)
class Probe:
    """What the trial drawing found.

    window: VTK class that worked, or None where VTK chooses by itself.
    problem: why nothing can be drawn, or None.
    """

    window: str | None
    problem: str | None


def missing() -> str | None:
    """None where off-screen drawing works; otherwise one sentence that says what to install.

    The answer is found once in a process and takes about half a second then.
    """
    return probe().problem


def missing_plots() -> str | None:
    """The same for plots of curves, which need Matplotlib only."""
    if importlib.util.find_spec("matplotlib") is None:
        return f"plots need Matplotlib: {EXTRA}"
    return None


@contextmanager
def off_screen() -> Iterator[None]:
    """While this lasts, VTK makes the kind of window that the trial drawing found to work, and is quiet.

    Without it VTK tries X first and warns of a "bad X server connection" on every machine without a display.

    Raises:
        DrawingUnavailable: see :func:`missing`.
    """
    found = probe()
    if found.problem is not None:
        raise DrawingUnavailable(found.problem)
    settings = {"EGL_LOG_LEVEL": os.environ.get("EGL_LOG_LEVEL", "fatal")}
    if found.window is not None:
        settings[WINDOW] = found.window
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@functools.cache
def probe() -> Probe:
    """Try the kinds of window one after the other, each in a process of its own, until one draws."""
    for module in ("pyvista", "vtkmodules"):
        if importlib.util.find_spec(module) is None:
            return Probe(None, f"pictures of the plate need PyVista: {EXTRA}")
    first = None
    for window in _windows():
        trial = _try_window(window)
        if trial.problem is None:
            return trial
        first = first or trial
    assert first is not None
    return first


def _windows() -> list[str | None]:
    """VTK classes to try, the best first; None is VTK's own choice, the only one outside Linux."""
    chosen = os.environ.get(WINDOW)
    if chosen:
        return [chosen]
    if not sys.platform.startswith("linux"):
        return [None]
    # EGL also comes first where there is a display: it needs no connection to it, and draws on the GPU's own.
    windows: list[str | None] = ["vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"]
    return [*windows, "vtkXOpenGLRenderWindow"] if os.environ.get("DISPLAY") else windows


def _try_window(window: str | None) -> Probe:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    if window is not None:
        environment[WINDOW] = window
    try:
        trial = subprocess.run(
            [sys.executable, "-c", PROBE],
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PATIENCE,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return Probe(None, f"pictures of the plate: the trial drawing failed: {' '.join(str(error).split())[-200:]}")
    answer = trial.stdout.split()
    if trial.returncode == 0 and answer[-1:] == ["True"]:
        # VTK may have fallen back to another kind by itself; asked for by name, it comes without warnings.
        return Probe(answer[-2] if window is not None else None, None)
    return Probe(None, _reason(trial.stderr))


def _reason(stderr: str) -> str:
    """One sentence on why the trial drawing failed."""
    last = stderr.strip().rpartition("\n")[2]
    if last.startswith("ImportError") and ".so" in last:
        library = next((word.rstrip(":") for word in last.split() if ".so" in word), last)
        return f"pictures of the plate: the system library {library} is missing; {SYSTEM}"
    if last.startswith(("ImportError", "ModuleNotFoundError")):
        return f"pictures of the plate: VTK cannot be imported ({last}); {EXTRA}"
    if not sys.platform.startswith("linux"):
        return "pictures of the plate: VTK cannot open an off-screen OpenGL window on this machine"
    if "Failed to load EGL" in stderr:
        return f"pictures of the plate: neither libEGL.so.1 nor libOSMesa.so.8 is installed; {SYSTEM}"
    return f"pictures of the plate: no EGL or OSMesa driver works for off-screen drawing; {SYSTEM}"
