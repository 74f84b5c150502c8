"""Checks of the drawing libraries: can they draw here, and if not, what to install.

Where VTK finds no graphics driver, it does not raise: the process ends with a segmentation fault. So a first drawing is
tried in a subprocess, and VTK is then told which kind of window worked.
"""

import functools
import importlib
import importlib.util
import os
import subprocess
import sys
import threading
from contextlib import suppress

from warp_plate.interrupts import deferred_interrupts

WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
X_WINDOW, OSMESA_WINDOW = "vtkXOpenGLRenderWindow", "vtkOSOpenGLRenderWindow"
EXTRA, LIBRARIES = "pip install 'warp-plate[viz]'", ("matplotlib", "pyvista", "PIL", "imageio_ffmpeg")
NO_DRIVER = (
    "there is no driver for off-screen drawing; 'apt-get install libegl1 libgl1-mesa-dri' (Debian, Ubuntu) or "
    "'dnf install mesa-libEGL mesa-dri-drivers' (Fedora) installs it"
)
# A trial takes about half a second, and many if VTK is read from a slow disk for the first time [s].
TIMEOUT = 60.0
_LOCK = threading.Lock()

# Draws an empty white window; prints its class, and whether it is white. The window is not closed, which would take as
# long as to draw it.
TRIAL = """
import os, sys
sys.modules["numpy"] = None  # VTK would import it
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
os._exit(0)
"""


class DrawingUnavailable(RuntimeError):
    """A library for drawing is missing; the message is one sentence that says what to install."""


def missing_plots() -> str | None:
    """Return a sentence on what is missing for plots and pages, which need no renderer, or None."""
    missing = [name for name in LIBRARIES if importlib.util.find_spec(name) is None]
    return f"drawing needs {', '.join(missing)}: {EXTRA}" if missing else None


def missing_renderer() -> str | None:
    """Return a sentence on why VTK cannot draw off screen and what to install, or None; takes 0.5 s at first."""
    with _LOCK:  # a trial at a time, whose result is cached
        return missing_plots() or working_window()[1]


def missing_window() -> str | None:
    """Return a few words on why no window can be shown, or None if one can."""
    problem = missing_plots()
    if problem is not None or not sys.platform.startswith("linux"):
        return problem
    display = os.environ.get("DISPLAY")
    if not display:
        return "there is no display: DISPLAY is not set"
    return None if try_window(X_WINDOW) == (True, X_WINDOW) else f"the display {display} cannot be drawn on"


def prepare() -> None:
    """Start the trial drawing and import the drawing libraries in a thread, beside other work."""

    def import_libraries() -> None:
        with suppress(Exception):  # drawing raises it again
            if missing_renderer() is None:
                importlib.import_module("pyvista")
            importlib.import_module("matplotlib.figure")

    threading.Thread(target=import_libraries, name="trial drawing", daemon=True).start()


def set_up_renderer() -> None:
    """Make VTK draw off screen in this process, without warnings, or raise DrawingUnavailable."""
    if (problem := missing_renderer()) is not None:
        raise DrawingUnavailable(problem)
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")
    if sys.platform.startswith("linux"):
        os.environ[WINDOW_VARIABLE] = working_window()[0]
    with deferred_interrupts():  # one that comes while libraries of VTK are loaded may crash Python
        from vtkmodules.vtkCommonCore import vtkLogger

    # VTK warns of every library that it would have preferred, as of a missing X server.
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)


@functools.cache
def working_window() -> tuple[str, str | None]:
    """Return the VTK class of a window that draws off screen, and None or why none does."""
    linux, answer = sys.platform.startswith("linux"), ""
    for window in (os.environ.get(WINDOW_VARIABLE), *([OSMESA_WINDOW] if linux else [])):
        drawn, answer = try_window(window)
        if drawn:
            return answer, None
    last = answer.rpartition("\n")[2]
    reason = NO_DRIVER if linux else "VTK opens no off-screen OpenGL window on this machine"
    if last.startswith(("ImportError", "ModuleNotFoundError")):
        reason = f"VTK cannot be imported ({last}): {EXTRA}"
    return "", f"the plate cannot be drawn: {reason}"


def try_window(window: str | None, timeout: float = TIMEOUT) -> tuple[bool, str]:
    """Return whether a trial drawing can be seen, and the class of its window or the subprocess's error output.

    VTK falls back to another class if ``window`` does not work; None leaves the choice to it.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment |= {} if window is None else {WINDOW_VARIABLE: window}
    # In a session of its own, as Ctrl-C is meant for the command, not for its trial.
    options = {"env": environment, "errors": "replace", "timeout": timeout, "start_new_session": True}
    try:
        trial = subprocess.run([sys.executable, "-c", TRIAL], capture_output=True, text=True, **options)
    except subprocess.TimeoutExpired:
        return False, f"no answer in {timeout:g} s"
    answer = trial.stdout.split()
    drawn = trial.returncode == 0 and answer[-1:] == ["True"]
    return drawn, answer[-2] if drawn else trial.stderr.strip()
