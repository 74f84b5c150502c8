"""The equation of motion, in the one place where it is written.

    ρH ü + c u̇ + D∇⁴u = f,   velocity form:  rate⁺ = decay·rate − stiffness·∇⁴u + load,   u⁺ = u + rate⁺

``rate`` is the displacement gained in one step, Δt·u̇ at the half-step between two levels of u. Displacement is
measured in units of the plate's largest drive × Δt²/ρH, so that all numbers stay near one whatever the material:
``stiffness`` = (κΔt/h²)², of fourth order (κΔt/12h²)², and ``load`` ≤ 1, both divided by 1 + cΔt/2ρH where damping is
centred in time.
"""

from functools import cache

import warp as wp


@cache
def make_parameters(real):
    """The struct of run-time numbers, equal for all plates and nodes, in the precision ``real``."""

    @wp.struct
    class Parameters:
        stiffness: real
        aspect: real
        decay: real

    return Parameters


@cache
def make_update(effects, real):
    """The rate half a step later from the rate, ∇⁴u, the load and the stiffness at one node."""
    Parameters = make_parameters(real)

    @wp.func
    def update(rate: real, biharmonic: real, load: real, stiffness: real, p: Parameters):
        # From the left, each step is one fused multiply-add.
        if wp.static(effects.damping):
            return load + p.decay * rate - stiffness * biharmonic
        else:
            return load + rate - stiffness * biharmonic

    return update
