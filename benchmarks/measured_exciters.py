"""Impedances of measured panels: python benchmarks/measured_exciters.py FOLDER [--json FILE] [--pictures OUT].

FOLDER holds files of github.com/Homeswinghome/DML-simulation-test-cases: NAME.txt (plate, material, exciter), Z_NAME
(frequency [Hz], impedance [Ω], phase [°]) and EFR_NAME (frequency, level of the pressure at 1 m [dB]). Plates are free,
with an exciter in the middle whose magnet is held. Fitted are the series resistance, and a common gain of levels.

Printed are rms differences of |Z| in dB, the first peaks of the PMMA panel, and rms differences of levels in third
octaves; those computed are of a panel in a baffle, those measured of one without. OUT gets a picture for each panel:
impedance, magnitude and phase, and levels at 1 m.
"""

from __future__ import annotations

import argparse
import configparser
import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize_scalar

from warp_plate import Scene
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.radiation import AIR, pressures
from warp_plate.plate.designs import scene_phasors
from warp_plate.studies.frequency_response import frf

PANELS = {
    "PMMA": ("PMMA3d5_FFFF_42x30.txt", "PMMA3d5_42x30.txt"),
    "plywood": ("PWD5d15_585x407_FFFF.txt", "PWD5_FFFF.txt"),
    "foam": ("EPS12d55_582x406_FFFF.txt", "EPS12d55_582x406.txt"),
}
BANDS = ((20.0, 200.0), (200.0, 1000.0), (1000.0, 5000.0), (200.0, 5000.0))
# Radius of the coil [m], and half the band around a measured peak in which the computed one is sought.
RADIUS, AROUND = 0.0125, 0.06
PEAKS = (41.0, 87.2, 176.1, 233.6)
# Middles of third octaves [Hz] in which levels are compared, frequencies in each, and distance of the microphone [m].
OCTAVES, IN_OCTAVE, DISTANCE = 1000 * 2 ** (np.arange(-6, 8) / 3), 40, 1.0


def scene_of(file: Path) -> Scene:
    """Return the scene of a file of parameters."""
    table = configparser.ConfigParser()
    table.read(file)
    numbers = {key: float(value) for part in ("plate", "material") for key, value in table[part].items()}
    width, height, thickness = numbers["lxmm"] / 1e3, numbers["lymm"] / 1e3, numbers["h"]
    along, across = numbers["ex"], numbers["ey"]
    share = thickness**3 / 12 / (1 - numbers["nux"] * numbers["nuy"])
    rigidities = {"Dx": along * share, "Dy": across * share, "D1": numbers["nuy"] * along * share}
    place = (float(table["exciter"][f"pos{axis}"]) * side for axis, side in (("x", width), ("y", height)))
    return Scene.from_tables(
        {
            "title": table["testcase"]["casetitle"],
            "plate": {
                "size": (width, height),
                "thickness": thickness,
                "young_modulus": (along * across) ** 0.5,
                "poisson_ratio": (numbers["nux"] * numbers["nuy"]) ** 0.5,
                "density": numbers["rho"],
            },
            "edges": dict.fromkeys(("left", "bottom", "right", "top"), "free"),
            "effects": {
                "orthotropic": {**rigidities, "Dxy": numbers["gxy"] * thickness**3 / 12},
                "modal_damping": {"ratio": numbers["zetamd"]},
            },
            "drive": {"frequency": 200.0},
            "target": {"area": (0.0, width / 2, 0.0, height / 2)},
            "actuators": [
                {"name": "coil", "kind": "coil", "model": "DAEX25VT-4", "voltage": 2.0, "disc": (*place, RADIUS)}
            ],
        }
    )


def compare(scene: Scene, measured: np.ndarray) -> dict[str, Any]:
    """Return differences from measured impedances (n, 3): frequency, magnitude and phase."""
    frequency, magnitude, _ = measured[(measured[:, 0] >= BANDS[0][0]) & (measured[:, 0] <= BANDS[-1][1])].T
    response = frf(scene, quantity="impedance", frequency_range=(20.0, 5000.0))
    computed = np.interp(frequency, response.frequencies, response.responses[0])
    fitted = (frequency >= BANDS[-1][0]) & (frequency <= BANDS[-1][1])

    def decibels(added: float) -> np.ndarray:
        return 20 * np.log10(np.abs(computed + added) / magnitude)

    added = minimize_scalar(lambda value: (decibels(value)[fitted] ** 2).sum(), bounds=(-2.0, 5.0)).x
    errors = decibels(added)
    rms = {}
    for low, high in BANDS:
        band = (frequency >= low) & (frequency <= high)
        rms[f"{low:g} to {high:g} Hz"] = float(np.sqrt(np.mean(errors[band] ** 2)))
    shown = np.geomspace(BANDS[0][0], BANDS[-1][1], 2000)
    curve = np.interp(shown, response.frequencies, response.responses[0]) + added
    return {
        "curve": (shown, curve),
        "resistance": scene.actuators[0].coil.resistance + float(added),
        "rms_db": rms,
        "largest_error_bar": float((response.errors.responses / np.abs(response.responses)).max()),
        "peaks": [
            _peaks(peak, frequency, magnitude, response.frequencies, response.responses[0] + added) for peak in PEAKS
        ],
    }


def _peaks(
    near: float, frequency: np.ndarray, magnitude: np.ndarray, computed_at: np.ndarray, computed: np.ndarray
) -> tuple[float, float]:
    """Return the frequencies of the measured and of the computed peak near a frequency, the vertices of parabolas."""
    peaks = []
    for x, values in ((frequency, magnitude), (computed_at, np.abs(computed))):
        inside = np.flatnonzero(np.abs(x / near - 1) < AROUND)
        top = int(inside[values[inside].argmax()])
        curvature, slope, _ = np.polyfit(x[top - 1 : top + 2] - x[top], values[top - 1 : top + 2], 2)
        peaks.append(float(x[top] - slope / (2 * curvature)))
    return peaks[0], peaks[1]


def compare_levels(scene: Scene, measured: np.ndarray) -> dict[str, Any]:
    """Return differences from measured levels (n, 2), frequency and dB, in third octaves, after a common gain."""
    bands = OCTAVES[:, None] * 2 ** ((np.arange(IN_OCTAVE) + 0.5) / IN_OCTAVE / 3 - 1 / 6)
    plate, frequencies = solve_modes(scene, float(bands.max())), bands.ravel()
    place = np.array([[*np.array(scene.plate.size) / 2, DISTANCE]])
    pressure = pressures(plate, frequencies, plate.respond_to_drive(frequencies, scene_phasors(scene)), place, AIR)
    squares = np.abs(pressure[:, 0, 0]) ** 2, 10 ** (np.interp(frequencies, *measured.T) / 10)
    computed, level = (10 * np.log10(part.reshape(bands.shape).mean(axis=1)) for part in squares)
    gain = np.mean(computed - level)
    differences = computed - level - gain
    return {
        "rms_db": float(np.sqrt(np.mean(differences**2))),
        "differences_db": differences.round(2).tolist(),
        "curve": (OCTAVES, computed - gain, level),
    }


def draw(name: str, found: dict[str, Any], impedance: np.ndarray, out: Path) -> None:
    """Draw measured and computed impedance and levels of a panel."""
    figure, axes = plt.subplots(3, 1, figsize=(7, 8), layout="constrained")
    frequency, curve = found["curve"]
    measured = impedance[(impedance[:, 0] >= frequency[0]) & (impedance[:, 0] <= frequency[-1])].T
    octaves, computed, level = found["levels"]["curve"]
    rows = (
        ("|impedance| (Ω)", measured[:2], (frequency, np.abs(curve))),
        ("phase of the impedance (°)", measured[[0, 2]], (frequency, np.degrees(np.angle(curve)))),
        ("level at 1 m, third octaves (dB)", (octaves, level), (octaves, computed)),
    )
    for axis, (label, of_panel, of_model) in zip(axes, rows, strict=True):
        axis.semilogx(*of_panel, color="0.45", label="measured")
        axis.semilogx(*of_model, color="C0", linewidth=1, label="computed")
        axis.set(ylabel=label, xlim=(frequency[0], 6000.0))
        axis.grid(alpha=0.3)
        axis.set_xticks([20, 50, 100, 200, 500, 1000, 2000, 5000])
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter("")
    axes[0].set_title(f"{name}: {found['resistance']:.2f} Ω in series, a common gain of levels")
    axes[0].legend()
    axes[-1].set_xlabel("frequency (Hz)")
    figure.savefig(out / f"measured-{name.lower()}.png", dpi=120)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    results = {}
    for name, (parameters, ending) in PANELS.items():
        scene = scene_of(options.folder / parameters)
        impedance = np.loadtxt(options.folder / f"Z_{ending}")
        results[name] = found = compare(scene, impedance)
        scene = scene.replace("actuators.coil.resistance", found["resistance"])
        found["levels"] = compare_levels(scene, np.loadtxt(options.folder / f"EFR_{ending}"))
        if options.pictures is not None:
            draw(name, found, impedance, options.pictures)
        del found["curve"], found["levels"]["curve"]
        rms = ", ".join(f"{band}: {value:.2f} dB" for band, value in found["rms_db"].items())
        print(f"{name}: series resistance {found['resistance']:.2f} Ω; rms of |Z| {rms}")
        levels = found["levels"]
        print(f"{name}: third octaves, 250 Hz to 5 kHz: rms {levels['rms_db']:.1f} dB, {levels['differences_db']}")
    for measured, computed in results["PMMA"]["peaks"]:
        print(
            f"PMMA: peak measured at {measured:.1f} Hz, computed at {computed:.1f} Hz, {computed / measured - 1:+.1%}"
        )
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
