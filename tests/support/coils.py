"""Coils, and a panel with them."""

from support.scenes import scene_of

EXCITER = {"kind": "coil", "model": "DAEX25VT-4", "voltage": 2.0}
FREE = {"magnet": "free", "magnet_mass": 0.05}
SPRUNG = {"magnet": "sprung", "magnet_mass": 0.03, "magnet_stiffness": 800.0, "magnet_damping": 0.3}
COILS = [
    {**EXCITER, **FREE, "name": "free", "disc": (0.05, 0.06, 0.012)},
    {**EXCITER, **SPRUNG, "name": "sprung", "area": (0.11, 0.13, 0.1, 0.13), "inductance": 2e-4, "phase": 1.0},
    {
        "kind": "coil",
        "name": "fixed",
        "disc": (0.14, 0.05, 0.01),
        "current": 0.3,
        "force_factor": -2.0,
        "resistance": 6.0,
    },
    {"name": "pressed", "area": (0.02, 0.04, 0.12, 0.14), "force": 0.4},
]
# The same without lossy inductance, which only steady tones have.
LOSSLESS = {"eddy_resistance": (0.0, 0.0), "eddy_reactance": (0.0, 0.0)}
LOSSLESS_COILS = [{**row, **LOSSLESS} if "model" in row else row for row in COILS]


def panel(actuators=COILS, coupled=False):
    """Return a panel with coils; its modes may be coupled by a damper on a patch."""
    tables = {"damping": {"viscous": 20.0}}
    if coupled:
        tables["loss_factor"] = {"eta": 0.01}
        tables["oscillators"] = [{"area": (0.12, 0.15, 0.05, 0.08), "mass": 0.002, "stiffness": 400.0, "damping": 1.0}]
    return scene_of(size=(0.2, 0.16), effects=tables).with_tables(actuators=actuators)
