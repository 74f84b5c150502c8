"""Whether pictures can be drawn off screen here, found out without risk, and what to install if not.

VTK's Linux wheels (9.6 and later) link against no graphics library: they look for one when a window is made.
With a display that is libX11 and libGL; without, libEGL.so.1 and then libOSMesa.so.8, of which one is enough.
Where neither is found, or libEGL.so.1 has no driver behind it, VTK does not raise: the process ends with a
segmentation fault. So the first drawing is tried in a process of its own, and VTK is then told by name which
kind of window worked there.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warp_plate.result.atomic_io import atomic_path

WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
X_WINDOW = "vtkXOpenGLRenderWindow"
EXTRA = "pip install 'warp-plate[viz]'"
SYSTEM = (
    "'apt-get install libegl1 libgl1-mesa-dri' (Debian, Ubuntu) or "
    "'dnf install mesa-libEGL mesa-dri-drivers' (Fedora) brings what is needed"
)
# A probe takes about half a second; reading VTK from a slow disk for the first time can take many.
PATIENCE = 60.0
_ONE_AT_A_TIME = threading.Lock()

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
        return f"curves cannot be plotted without Matplotlib: {EXTRA}"
    return None


def missing_meshes() -> str | None:
    """The same for what is drawn elsewhere, as in a browser, and needs PyVista's meshes but no window."""
    if importlib.util.find_spec("pyvista") is None:
        return f"the plate cannot be drawn without PyVista: {EXTRA}"
    return missing_plots()


def missing_window() -> str | None:
    """None where a window can be shown; otherwise why not, in a few words.

    On Linux it is tried in a process of its own: where something is missing, VTK ends the process.
    """
    for module in ("pyvista", "vtkmodules"):
        if importlib.util.find_spec(module) is None:
            return f"PyVista is not installed: {EXTRA}"
    if not sys.platform.startswith("linux"):
        return None
    display = os.environ.get("DISPLAY")
    if not display:
        return "there is no display: DISPLAY is not set"
    try:
        connected = _connects(display)
    except OSError:
        return "the system library libX11.so.6 is missing"
    # VTK's kind of window for X draws off screen without an X server too, so this alone would not do.
    drawn, _ = _try_window(X_WINDOW) if connected else (False, "")
    return None if drawn else f"the display {display} cannot be {'drawn on' if connected else 'reached'}"


def _connects(display: str) -> bool:
    """Whether an X server answers there. Raises OSError without Xlib."""
    import ctypes

    library = ctypes.CDLL("libX11.so.6")
    library.XOpenDisplay.restype = ctypes.c_void_p
    connection = library.XOpenDisplay(display.encode())
    if not connection:
        return False
    library.XCloseDisplay(ctypes.c_void_p(connection))
    return True


def plot_beside(
    draw: Callable[[Mapping[str, Any], Path], Path], record: Mapping[str, Any], path: Path
) -> tuple[list[Path], str | None]:
    """Draw ``<path without ending>.png`` and ``.svg``; the files written, and None or why some are missing.

    Nothing that is wrong with a library or a file ends the run.
    """
    problem = missing_plots()
    if problem is not None:
        return [], problem
    written = []
    try:
        for ending in (".png", ".svg"):
            with atomic_path(path.with_suffix(ending)) as temporary:
                draw(record, temporary)
            written.append(path.with_suffix(ending))
    except (ValueError, OSError) as error:
        return written, f"no plot: {error}"
    return written, None


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
    from vtkmodules.vtkCommonCore import vtkLogger

    # Warnings tell of libraries that VTK would have liked better; what matters here raises or was tried.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_INFO)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def prepare() -> None:
    """Start the trial drawing and read the drawing libraries beside other work, so that nobody waits for it later."""
    threading.Thread(target=_prepare, name="trial drawing", daemon=True).start()


def _prepare() -> None:
    if probe().problem is None:
        importlib.import_module("pyvista")
    if missing_plots() is None:
        importlib.import_module("matplotlib.figure")


def probe() -> Probe:
    """What the trial drawing found; it is made once in a process."""
    with _ONE_AT_A_TIME:
        return _probe()


@functools.cache
def _probe() -> Probe:
    """Try the kinds of window one after the other, each in a process of its own, until one draws."""
    for module in ("pyvista", "vtkmodules"):
        if importlib.util.find_spec(module) is None:
            return Probe(None, f"the plate cannot be drawn without PyVista: {EXTRA}")
    complaints = ""
    for window in _windows():
        drawn, answer = _try_window(window)
        if drawn:
            # VTK may have fallen back to another kind; asked for by name, that one comes without warnings.
            return Probe(None if window is None else answer, None)
        complaints += f"{answer}\n"
    return Probe(None, _reason(complaints))


def _windows() -> list[str | None]:
    """VTK classes to try, the best first; None is VTK's own choice, the only one outside Linux."""
    chosen = os.environ.get(WINDOW)
    if chosen:
        return [chosen]
    if not sys.platform.startswith("linux"):
        return [None]
    without_display: list[str | None] = ["vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"]
    # With a display the X kind comes first, as for a window on the screen: GLX and EGL in one process clash.
    return [X_WINDOW, *without_display] if os.environ.get("DISPLAY") else without_display


def _try_window(window: str | None) -> tuple[bool, str]:
    """Whether a trial drawing can be seen, and the kind of its window or what its process complained of."""
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
            start_new_session=True,  # a Ctrl-C is meant for the run, not for what it tries out
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer in {PATIENCE:g} s"
    answer = trial.stdout.split()
    if trial.returncode == 0 and answer[-1:] == ["True"]:
        return True, answer[-2]
    return False, trial.stderr.strip()


def _reason(complaints: str) -> str:
    """One sentence on why no trial drawing could be seen."""
    last = complaints.strip().rpartition("\n")[2]
    if last.startswith("ImportError") and ".so" in last:
        library = next(word.rstrip(":") for word in last.split() if ".so" in word)
        return (
            f"the plate cannot be drawn: the system library {library} is missing, which VTK 9.6 and later do "
            "without: pip install --upgrade vtk"
        )
    if last.startswith(("ImportError", "ModuleNotFoundError")):
        return f"the plate cannot be drawn: VTK cannot be imported ({last}); {EXTRA}"
    if not sys.platform.startswith("linux"):
        return "the plate cannot be drawn: VTK opens no off-screen OpenGL window on this machine"
    if "Failed to load EGL" in complaints:
        return f"the plate cannot be drawn: neither libEGL.so.1 nor libOSMesa.so.8 is installed; {SYSTEM}"
    return f"the plate cannot be drawn: no EGL or OSMesa driver works for off-screen drawing; {SYSTEM}"
