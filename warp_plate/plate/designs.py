"""What may differ from plate to plate in one batch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Designs:
    """Drives and, where they are not the scene's, what else each plate has of its own; None: as the scene has it.

    drives: (plates, actuators) complex phasors Z [N/m², or V: ``Scene.drive_unit``]; frequency: (plates, actuators)
    [Hz]; centre: (plates, actuators, 2) x, y of the actuators' middles [m]; delay: (plates, actuators) start of the
    burst [s].
    """

    drives: np.ndarray
    frequency: np.ndarray | None = None
    centre: np.ndarray | None = None
    delay: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.drives)

    def __getitem__(self, some: slice) -> Designs:
        own = (None if values is None else values[some] for values in (self.frequency, self.centre, self.delay))
        return Designs(self.drives[some], *own)

    @property
    def only_drives(self) -> bool:
        """Whether plates differ in nothing but their drives, so that superposition holds between them."""
        return self.frequency is None and self.centre is None and self.delay is None
