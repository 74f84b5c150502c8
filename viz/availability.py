"""Checks of the drawing libraries: can they draw here, and if not, what to install.

VTK's Linux wheels look for a graphics library when a window is made: libX11 and libGL with a display, otherwise
libEGL.so.1 or libOSMesa.so.8. If there is none, or libEGL.so.1 has no driver, VTK does not raise: the process ends with
a segmentation fault. So a first drawing is tried in a subprocess, and VTK is then told which kind of window worked.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
import subprocess
import sys
import threading
from contextlib import suppress

WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
X_WINDOW = "vtkXOpenGLRenderWindow"
EXTRA = "pip install 'warp-plate[viz]'"
PACKAGES = (
    "'apt-get install libegl1 libgl1-mesa-dri' (Debian, Ubuntu) or "
    "'dnf install mesa-libEGL mesa-dri-drivers' (Fedora) installs it"
)
# A trial takes about half a second, and many if VTK is read from a slow disk for the first time [s].
TIMEOUT = 60.0
_LOCK = threading.Lock()

# Draws an empty white window; prints its class, and whether it is white.
TRIAL = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter
window, renderer, image = vtkRenderWindow(), vtkRenderer(), vtkWindowToImageFilter()
window.SetOffScreenRendering(1)
window.SetSize(32, 32)
window.AddRenderer(renderer)
renderer.SetBackground(1, 1, 1)
window.Render()
image.SetInput(window)
image.Update()
print(window.GetClassName(), image.GetOutput().GetScalarRange()[1] > 100, flush=True)
"""


class DrawingUnavailable(RuntimeError):
    """A library for drawing is missing; the message is one sentence that says what to install."""


def missing_renderer() -> str | None:
    """Return a sentence on why VTK cannot draw off screen and what to install, or None; takes 0.5 s at first."""
    with _LOCK:  # a trial at a time, whose result is cached
        return working_window()[1]


def missing_plots() -> str | None:
    """Return a sentence on what is missing for Matplotlib plots, or None."""
    return None if importlib.util.find_spec("matplotlib") else f"plots need Matplotlib: {EXTRA}"


def missing_meshes() -> str | None:
    """Return a sentence on what is missing for pages, which need meshes but no renderer, or None."""
    return missing_plots() if importlib.util.find_spec("pyvista") else f"drawing the plate needs PyVista: {EXTRA}"


def missing_window() -> str | None:
    """Return a few words on why no window can be shown, or None if one can."""
    problem = missing_meshes()
    if problem is not None or not sys.platform.startswith("linux"):
        return problem
    display = os.environ.get("DISPLAY")
    if not display:
        return "there is no display: DISPLAY is not set"
    return None if _try_window(X_WINDOW) == (True, X_WINDOW) else f"the display {display} cannot be drawn on"


def prepare() -> None:
    """Start the trial drawing and import the drawing libraries in a thread, beside other work."""

    def import_libraries() -> None:
        with suppress(Exception):  # drawing raises it again
            if missing_renderer() is None:
                importlib.import_module("pyvista")
            if missing_plots() is None:
                importlib.import_module("matplotlib.figure")

    threading.Thread(target=import_libraries, name="trial drawing", daemon=True).start()


def set_up_renderer() -> None:
    """Make VTK draw off screen in this process, without warnings, or raise DrawingUnavailable."""
    if (problem := missing_renderer()) is not None:
        raise DrawingUnavailable(problem)
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")
    if (window := working_window()[0]) is not None:
        os.environ[WINDOW_VARIABLE] = window
    from vtkmodules.vtkCommonCore import vtkLogger

    # VTK warns of every library that it would have preferred, as of a missing X server.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)


@functools.cache
def working_window() -> tuple[str | None, str | None]:
    """Return the VTK class of a window that draws off screen (None: VTK's own choice), and None or why none does."""
    if (problem := missing_meshes()) is not None:
        return None, problem
    linux, chosen, answer = sys.platform.startswith("linux"), os.environ.get(WINDOW_VARIABLE), ""
    # With a display X comes first, as for a window on the screen: GLX and EGL clash in one process.
    classes = [*([X_WINDOW] if os.environ.get("DISPLAY") else []), "vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"]
    for window in classes if linux and not chosen else [chosen or None]:
        drawn, answer = _try_window(window)
        if drawn:
            # VTK may have fallen back to another class, which gives no warnings when asked for by name.
            return None if window is None else answer, None
    last = answer.rpartition("\n")[2]
    if last.startswith(("ImportError", "ModuleNotFoundError")):
        reason = f"VTK cannot be imported ({last}): {EXTRA}"
    elif linux:
        reason = f"there is no EGL or OSMesa driver for off-screen drawing; {PACKAGES}"
    else:
        reason = "VTK opens no off-screen OpenGL window on this machine"
    return None, f"the plate cannot be drawn: {reason}"


def _try_window(window: str | None) -> tuple[bool, str]:
    """Return whether a trial drawing can be seen, and the class of its window or the subprocess's error output."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment |= {} if window is None else {WINDOW_VARIABLE: window}
    # In a session of its own, as Ctrl-C is meant for the command, not for its trial.
    options = {"env": environment, "errors": "replace", "timeout": TIMEOUT, "start_new_session": True}
    try:
        trial = subprocess.run([sys.executable, "-c", TRIAL], capture_output=True, text=True, **options)
    except subprocess.TimeoutExpired:
        return False, f"no answer in {TIMEOUT:g} s"
    answer = trial.stdout.split()
    drawn = trial.returncode == 0 and answer[-1:] == ["True"]
    return drawn, answer[-2] if drawn else trial.stderr.strip()
