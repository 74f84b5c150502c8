"""A force that travels over the plate; its weights on the grid are in ``plate/travelling.py``."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from warp_plate.effects.effect import Effect, Setting
from warp_plate.scene.fields import Instant, Moderate, Positive, Unit

Place = Annotated[float, Field(ge=-1e6, le=1e6)]


class MovingLoad(Effect):
    """A force that travels over the plate at constant velocity."""

    force: Annotated[Moderate, Unit("N"), Field(examples=[0.01])]
    """Force in the direction of positive displacement."""
    start: Annotated[tuple[Place, Place], Unit("m"), Field(examples=[[0.0, 0.06]])]
    """Position (x, y) at ``from_time``."""
    velocity: Annotated[tuple[Place, Place], Unit("m/s"), Field(examples=[[2.0, 0.0]])] = (0.0, 0.0)
    """Velocity (x, y)."""
    size: Annotated[float, Field(ge=0, le=1e6, examples=[0.01]), Unit("m")] = 0.0
    """Side of the square over which the force is distributed; 0 for a point."""
    from_time: Annotated[Instant, Unit("s"), Field(examples=[0.01])] = 0.0
    """Start of the force."""
    to_time: Annotated[Positive | None, Unit("s"), Field(examples=[0.09])] = None
    """End of the force (default: the end of the run)."""
    frequency: Annotated[Positive | None, Unit("Hz"), Field(examples=[100.0])] = None
    """Frequency f of a force that varies as cos(2πft) (default: a constant force)."""

    travels = True

    @model_validator(mode="after")
    def _times_in_order(self) -> MovingLoad:
        if self.to_time is not None and self.to_time <= self.from_time:
            raise ValueError(f"to_time: {self.to_time:g} s must be later than from_time = {self.from_time:g} s")
        return self

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        width, height = setting.plate.size
        speed = width / setting.end
        text = f"1 mN on a point that crosses the plate along x at {speed:.2g} m/s"
        return cls(force=1e-3, start=(0.0, height / 2), velocity=(speed, 0.0)), text
