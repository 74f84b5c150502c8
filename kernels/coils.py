"""Coils on patches, implicit in the rates: the force of a coil on its patch, and the motion of its magnet.

With ū, r and z, s the displacements and rates of patch and magnet at the start of a step, r⁺, s⁺ the rates half a step
after it, p the force on the patch and i the current, in the scaled units of ``update``,

    p = k (z − ū) − m (r⁺ − r) − d ½(r⁺ + r − s⁺ − s) + β (V + c i),
    M (s⁺ − s) = −k (z − ū) + d ½(r⁺ + r − s⁺ − s) − β (V + c i) − κ z − ρ ½(s⁺ + s),
    r⁺ = r* + Y p,

r* being the mean rate of the patch without the coil. The loss Bl²/(R + 2L/Δt) in d, β = Bl/(R + 2L/Δt) and c = 2L/Δt
are the trapezoidal rule for L di/dt + R i = V − Bl (r − s)/Δt. An inductor Lₖ that is shunted by Rₖ has a current j,
Lₖ dj/dt = Rₖ (i − j); with a = RₖΔt/2Lₖ it adds Rₖ/(1 + a) to R, and Rₖ/(1 + a) j to V.
"""

from functools import cache

import warp as wp

from warp_plate.kernels.update import make_material, make_state

# Numbers of a coil, in this order. magnet: 1 / (M + ρ/2 + d/2), 0 if it is fixed; magnet_decay: M − ρ/2 − d/2;
# response: Y; implicit: 1 / (1 + Y resistance), resistance: −∂p/∂r⁺; current: 1 / (R + 2L/Δt); induced: Bl/Δt; follow:
# 2 if the current goes on by the trapezoidal rule, 1 if it follows at once.
NUMBERS = (
    "stiffness", "half_damping", "moving_mass", "force", "memory", "magnet", "magnet_decay", "magnet_stiffness",
    "response", "implicit", "resistance", "current", "induced", "follow",
)  # fmt: skip
# Numbers of a coil's state: displacement and rate of the magnet, current, and rate of the patch; then the currents of
# shunted inductors. The numbers of these follow those above: Rₖ/(1 + a), and 2a/(1 + a).
STATE, BRANCH = 4, 2


@cache
def make_coil_force(effects, real):
    """Make ``coil_force``: move a magnet by one step, and return the coil's force on its patch of the plate."""
    Material, (Forcing, Fields) = make_material(real), make_state(real)
    at = {name: index for index, name in enumerate(NUMBERS)}

    @wp.func
    def coil_force(d: Forcing, f: Fields, m: Material, k: int, c: int, n: int, patch_u: real, predicted: real):
        magnet_u = f.coils[k, c, 0]
        magnet_rate = f.coils[k, c, 1]
        current = f.coils[k, c, 2]
        before = f.coils[k, c, 3]
        driven = m.coils[c, wp.static(at["memory"])] * current
        for b in range(wp.static(effects.branches)):
            driven += m.coils[c, wp.static(len(NUMBERS)) + wp.static(BRANCH) * b] * f.coils[k, c, wp.static(STATE) + b]
        for t in range(wp.static(effects.terms)):
            driven += d.wave[k, n, t] * d.coefficients[k, t, m.coil_actuators[c]]
        half = m.coils[c, wp.static(at["half_damping"])]
        pull = m.coils[c, wp.static(at["stiffness"])] * (magnet_u - patch_u)
        pull += m.coils[c, wp.static(at["force"])] * driven
        magnet = m.coils[c, wp.static(at["magnet"])]
        held = m.coils[c, wp.static(at["magnet_stiffness"])] * magnet_u
        moved = magnet * (m.coils[c, wp.static(at["magnet_decay"])] * magnet_rate - pull - held + half * before)
        free = pull + m.coils[c, wp.static(at["moving_mass"])] * before - half * (before - magnet_rate - moved)
        after = predicted + m.coils[c, wp.static(at["response"])] * free
        after = m.coils[c, wp.static(at["implicit"])] * after
        force = free - m.coils[c, wp.static(at["resistance"])] * after
        moved += magnet * half * after
        stroke = real(0.5) * ((after - moved) + (before - magnet_rate))
        driven -= m.coils[c, wp.static(at["induced"])] * stroke
        mean = m.coils[c, wp.static(at["current"])] * driven
        f.coils[k, c, 0] = magnet_u + moved
        f.coils[k, c, 1] = moved
        f.coils[k, c, 2] = current + m.coils[c, wp.static(at["follow"])] * (mean - current)
        f.coils[k, c, 3] = after
        for b in range(wp.static(effects.branches)):
            shunted = f.coils[k, c, wp.static(STATE) + b]
            follow = m.coils[c, wp.static(len(NUMBERS) + 1) + wp.static(BRANCH) * b]
            f.coils[k, c, wp.static(STATE) + b] = shunted + follow * (mean - shunted)
        return force

    return coil_force
