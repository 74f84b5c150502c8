"""The tables under ``[effects]``: each turns one effect on, and nothing else does."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class Table(BaseModel):
    """A table of the scene file: unknown keys are refused, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Damping(Table):
    """Viscous damping, c u̇ on the left of the equation of motion.

    ``viscous`` is c [N·s/m³]. ``scheme`` says at which time the rate u̇ is taken: "centred" between the two
    half-steps (second order; leaves the stability limit alone) or "backward", at the last half-step, as the
    source paper prints it in equation (6) (first order; lowers the limit).
    """

    viscous: float = Field(ge=0)
    scheme: Literal["centred", "backward"] = "centred"


class Effects(Table):
    """The effects that a scene names; ``None`` means that the effect is not in the compiled kernel."""

    damping: Damping | None = None
