"""A result's plates in motion inside a notebook: the page of ``render``, in a frame.

    >>> from warp_plate import load_result, view
    >>> view(load_result("paper-localize.h5"))

The frame holds the whole page, so that it plays without a server, without a network, and in a notebook that was saved.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element, tostring

from warp_plate.result.model import Result
from warp_plate.scene.errors import SceneError


@dataclass(frozen=True)
class Page:
    """A page that a notebook shows in a frame of this height [pixels]; ``html`` is all of it."""

    html: str
    height: int

    def _repr_html_(self) -> str:
        # The page's scripts see nothing of the notebook.
        looks = {"sandbox": "allow-scripts", "width": "100%", "height": str(self.height), "style": "border: none"}
        frame = Element("iframe", {"srcdoc": self.html, **looks})
        return tostring(frame, encoding="unicode", short_empty_elements=False)


def view(
    result: Result,
    *cases: str,
    quantity: str = "displacement",
    span: tuple[float, float] | None = None,
    frames: int | None = None,
    rate: float = 30.0,
    height: int = 680,
    device: str = "auto",
) -> Page:
    """Run the drives of a result once more and show their plates, side by side, to play and to turn.

    Args:
        cases: names of the result's cases; left out: the best, or the only one.
        quantity: in colour: displacement, velocity, energy, rms-velocity or phase.
        span: beginning and end of what is shown [s], frames: how many; left out: 60 over the last period of the drive,
            or over the first burst or the window where the drive does not repeat.
        rate: frames a second at first; height: of the frame in the notebook [pixels].
        device: where the plates run: cpu, cuda, cuda:1, ...; auto takes a CUDA device where there is one.

    Raises:
        SceneError: a case or quantity that is none, a span outside the run.
        DrawingUnavailable: PyVista is not installed.
    """
    from warp_plate.analysis.motion import motions
    from warp_plate.viz.availability import DrawingUnavailable, missing_meshes
    from warp_plate.viz.notebook import shown_case
    from warp_plate.viz.page import write_page
    from warp_plate.viz.quantity import QUANTITIES

    names = cases or (shown_case(result)[0],)
    for key, value, known in [("quantity", quantity, QUANTITIES), *(("case", name, result.cases) for name in names)]:
        if value not in known:
            raise SceneError(f"{key} = {value!r}: must be one of {', '.join(known)}")
    if (problem := missing_meshes()) is not None:
        raise DrawingUnavailable(problem)
    moving = motions(result.scene, {name: result.cases[name] for name in names}, span, frames, device)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "page.html"
        write_page(result.scene, moving, path, quantity, rate)
        return Page(path.read_text(encoding="utf-8"), height)
