"""The time update of one node, shared by all paths.

    ρH ü + c u̇ + D∇⁴u = f,   velocity form:  rate⁺ = decay·rate − stiffness·∇⁴u + load,   u⁺ = u + rate⁺

``rate`` is the displacement gained in one step, Δt·u̇ at the half-step between two levels of u. Displacement is in
units of the plate's largest drive × Δt²/ρH, which keeps all numbers near one whatever the material: ``stiffness`` =
(κΔt/h²)² (fourth order: (κΔt/12h²)²) and ``load`` ≤ 1, both divided by 1 + cΔt/2ρH where damping is centred in time.

Only the update in time is here. Each path gathers ∇⁴u and the load by itself.
"""

from functools import cache

import warp as wp


@cache
def make_parameters(real):
    """Make the struct of numbers that all plates and nodes share: stiffness, aspect (see ``stencil``), decay."""

    @wp.struct
    class Parameters:
        stiffness: real
        aspect: real
        decay: real

    return Parameters


@cache
def make_update(effects, real):
    """Make ``update``: the rate half a step later from the rate, ∇⁴u, the load and the stiffness at a node."""
    Parameters = make_parameters(real)

    @wp.func
    def update(rate: real, biharmonic: real, load: real, stiffness: real, p: Parameters):
        # Evaluated from the left, so that each term is one fused multiply-add.
        if wp.static(effects.damping):
            return load + p.decay * rate - stiffness * biharmonic
        else:
            return load + rate - stiffness * biharmonic

    return update
