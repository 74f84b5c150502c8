"""Impedance and sound of measured panels: python benchmarks/measured_exciters.py SOURCE [options].

SOURCE is a folder with files of github.com/Homeswinghome/DML-simulation-test-cases: NAME.txt (plate, material,
exciter), Z_NAME (frequency [Hz], impedance [Ω], phase [°]) and EFR_NAME (frequency, level of the pressure at 1 m [dB]);
or the JSON of an earlier run, of which the picture is drawn again. Three plates are free, with an exciter in the middle
whose magnet is held; fitted are the series resistance, and a common gain of levels. Two are supported, with free
magnets, whose mass is set by the first peak of the impedance; samples of their files are in supported_panels.toml.

Printed are rms differences of |Z| in dB, the first peaks of the PMMA panel, and rms differences of levels in third
octaves, of panels without a baffle, open at the back: in vacuo, and with the load of the air on both sides. The peaks
are printed again with a magnet that swings in its holder, air, and a modulus that rises with the frequency.
"""

from __future__ import annotations

import argparse
import configparser
import json
import tomllib
from collections.abc import Sequence
from itertools import product
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize_scalar

from warp_plate import Scene
from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.modal.poles import adaptive_frequencies
from warp_plate.modal.unbaffled import Unbaffled
from warp_plate.plate.designs import scene_phasors

PANELS = {
    "PMMA": ("PMMA3d5_FFFF_42x30.txt", "PMMA3d5_42x30.txt"),
    "plywood": ("PWD5d15_585x407_FFFF.txt", "PWD5_FFFF.txt"),
    "foam": ("EPS12d55_582x406_FFFF.txt", "EPS12d55_582x406.txt"),
}
Bands = Sequence[tuple[float, float]]
BANDS = ((20.0, 200.0), (200.0, 1000.0), (1000.0, 5000.0), (200.0, 5000.0))
# Radius of the coil [m], and half the band around a measured peak in which the computed one is sought.
RADIUS, AROUND = 0.0125, 0.06
PEAKS = (41.0, 87.2, 176.1, 233.6)
# Middles of third octaves [Hz] in which levels are compared, frequencies in each, and distance of the microphone [m].
OCTAVES, IN_OCTAVE, DISTANCE = 1000 * 2 ** (np.arange(-6, 8) / 3), 12, 1.0
# Supported panels: file, sides [m], mass of the magnet [kg], and bands [Hz] and third octaves of their samples.
SUPPORTED, SIDES, MAGNET = Path(__file__).with_name("supported_panels.toml"), (0.407, 0.585), 0.074
SAMPLED, SAMPLED_OCTAVES = ((20.0, 75.0), (75.0, 230.0)), slice(1, 10)
# The holder of the PMMA panel's magnet [Hz, damping ratio], masses of magnets [kg], rises of the modulus by decade, and
# frequencies at which it is the published one [Hz].
HOLDER, MAGNETS, RISES, PUBLISHED_AT = (65.0, 0.07), (0.06, 0.117), (0.0, 0.05, 0.075, 0.1), (70.0, 100.0)
# Series resistance of the panels of PMMA and plywood besides that of the model [Ω].
SERIES = 1.17
# Points of curves in files, and names of the plates in the picture.
SHOWN = 700
TITLES = {
    "PMMA": "acrylic glass, free",
    "plywood": "plywood, free",
    "foam": "polystyrene foam, free",
    "plywood-40": "plywood, supported, exciter at 0.4",
    "plywood-50": "plywood, supported, exciter at 0.5",
}


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


def supported(free: Scene, place: float) -> Scene:
    """Return a supported panel of a free one's material, with a free magnet, the exciter at a part of the sides."""
    tables = free.model_dump(mode="json", exclude_none=True, include={"effects", "drive", "target"})
    coil = {"disc": (SIDES[0] * place, SIDES[1] * place, RADIUS), "magnet": "free", "magnet_mass": MAGNET}
    return Scene.from_tables(
        {
            **tables,
            "plate": {**free.plate.model_dump(exclude_none=True), "size": SIDES},
            "edges": dict.fromkeys(("left", "bottom", "right", "top"), "supported"),
            "actuators": [{"name": "coil", "kind": "coil", "model": "DAEX25VT-4", "voltage": 2.0, **coil}],
        }
    )


def compare(plate: ModalPlate, frequency: np.ndarray, magnitude: np.ndarray, bands: Bands) -> dict[str, Any]:
    """Return differences from measured impedances |Z| (n,) at frequencies (n,) in bands, in the last of which the
    series resistance is fitted."""
    assert plate.coils is not None
    low, high = frequency[0], frequency[-1]
    frequencies = adaptive_frequencies(*plate.coils.resonances(opened=True), low, high)
    if plate.air is not None:  # whose resonances are lower than those that the grid resolves
        frequencies = np.union1d(np.arange(low, 120.0, 0.4), np.geomspace(low, high, 600))
    impedance = plate.coils.impedance(2 * np.pi * frequencies)[0][:, 0, 0]
    computed = np.interp(frequency, frequencies, impedance)
    inside = (frequency >= bands[-1][0]) & (frequency <= bands[-1][1])

    def decibels(added: float) -> np.ndarray:
        return 20 * np.log10(np.abs(computed + added) / magnitude)

    added = minimize_scalar(lambda value: (decibels(value)[inside] ** 2).sum(), bounds=(-2.0, 5.0)).x
    errors, rms = decibels(added), {}
    for start, end in bands:
        band = (frequency >= start) & (frequency <= end)
        rms[f"{start:g} to {end:g} Hz"] = float(np.sqrt(np.mean(errors[band] ** 2)))
    shown = np.geomspace(low, high, SHOWN)
    curves = np.interp(shown, frequency, magnitude), np.abs(np.interp(shown, frequencies, impedance + added))
    return {
        "resistance": plate.coils.numbers[0].resistance + float(added),
        "rms_db": rms,
        "peaks": [
            _peaks(peak, frequency, magnitude, frequencies, impedance + added) for peak in PEAKS if peak < high * 0.94
        ],
        "impedance": [curve.round(3).tolist() for curve in (shown, *curves)],
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


def compare_levels(scene: Scene, level: np.ndarray, chosen: slice) -> dict[str, Any]:
    """Return differences from measured levels (n,) [dB] of some third octaves, after a common gain."""
    octaves = OCTAVES[chosen]
    bands = octaves[:, None] * 2 ** ((np.arange(IN_OCTAVE) + 0.5) / IN_OCTAVE / 3 - 1 / 6)
    plate, frequencies = solve_modes(scene, float(bands.max())), bands.ravel()
    place = np.array([[*np.array(scene.plate.size) / 2, DISTANCE]])
    amplitudes = plate.respond_to_drive(frequencies, scene_phasors(scene))
    pressure = Unbaffled(plate, float(frequencies.max())).pressures(frequencies, amplitudes, place)
    computed = 10 * np.log10((np.abs(pressure[:, 0, 0]) ** 2).reshape(bands.shape).mean(axis=1))
    gain = np.mean(computed - level)
    differences = computed - level - gain
    return {
        "rms_db": float(np.sqrt(np.mean(differences**2))),
        "differences_db": differences.round(2).tolist(),
        "curve": [curve.round(2).tolist() for curve in (octaves, level, computed - gain)],
    }


def mean_levels(level: np.ndarray) -> np.ndarray:
    """Return mean levels [dB] of the last axis."""
    return np.asarray(10 * np.log10((10 ** (level / 10)).mean(axis=-1)))


def draw(results: dict[str, Any], out: Path) -> None:
    """Draw measured and computed impedance and levels of all panels."""
    figure, axes = plt.subplots(len(TITLES), 2, figsize=(9, 11.5), layout="constrained")
    for row, (name, title) in zip(axes, TITLES.items(), strict=True):
        for key, style in (("", {"color": "C0"}), (" in air", {"color": "C3", "linestyle": "--"})):
            found, label = results[name + key], "computed" + (key or " in vacuo")
            frequency, measured, computed = found["impedance"]
            octaves, level, computed_level = found["levels"]["curve"]
            if not key:
                row[0].loglog(frequency, measured, color="0.55", linewidth=2, label="measured")
                row[1].semilogx(octaves, level, "o-", color="0.55", linewidth=2, markersize=3)
            row[0].loglog(frequency, computed, linewidth=0.9, label=label, **style)
            row[1].semilogx(octaves, computed_level, linewidth=1.2, **style)
        row[0].set(title=title, ylabel="|impedance| [Ω]", xlim=(20, 5000), ylim=(4, 60))
        row[0].set_yticks([5, 10, 20, 50])
        row[1].set(title="level at 1 m, third octaves, one gain", ylabel="level [dB]", xlim=(200, 6000))
        for axis in row:
            axis.set_xticks([20, 50, 100, 200, 500, 1000, 2000, 5000][3 * (axis is row[1]) :])
            axis.grid(alpha=0.3)
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter("")
        row[0].yaxis.set_major_formatter("{x:g}")
        row[0].yaxis.set_minor_formatter("")
    axes[0, 0].legend(fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("frequency [Hz]")
    figure.savefig(out, dpi=130)
    plt.close(figure)


def compare_panel(folder: Path, name: str, air: bool) -> dict[str, Any]:
    """Return the comparison of a panel in vacuo or in air, and print it."""
    if name in PANELS:
        parameters, ending = PANELS[name]
        scene, limits, chosen = scene_of(folder / parameters), BANDS, slice(None)
        frequency, magnitude, _ = np.loadtxt(folder / f"Z_{ending}").T
        inside = (frequency >= BANDS[0][0]) & (frequency <= BANDS[-1][1])
        frequency, magnitude = frequency[inside], magnitude[inside]
        bands = OCTAVES[:, None] * 2 ** ((np.arange(40) + 0.5) / 120 - 1 / 6)
        level = mean_levels(np.interp(bands, *np.loadtxt(folder / f"EFR_{ending}").T))
    else:
        scene, limits, chosen = scene_of(folder / PANELS["plywood"][0]), SAMPLED, SAMPLED_OCTAVES
        samples = tomllib.loads(SUPPORTED.read_text(encoding="utf-8"))[name]
        scene = supported(scene, samples["place"])
        frequency, magnitude = np.array(samples["impedance"]).T
        level = mean_levels(np.reshape(samples["levels"], (-1, 3)))
    if air:
        name, scene = f"{name} in air", scene.replace("effects.air", {"baffle": False})
    found = compare(solve_modes(scene, frequency[-1]), frequency, magnitude, limits)
    scene = scene.replace("actuators.coil.resistance", found["resistance"])
    found["levels"] = levels = compare_levels(scene, level, chosen)
    rms = ", ".join(f"{band}: {value:.2f} dB" for band, value in found["rms_db"].items())
    lines = [f"{name}: series resistance {found['resistance']:.2f} Ω; rms of |Z| {rms}"]
    lines.append(f"{name}: third octaves: rms {levels['rms_db']:.1f} dB, {levels['differences_db']}")
    for measured, computed in found["peaks"]:
        ends = f"measured at {measured:.1f} Hz, computed at {computed:.1f} Hz"
        lines += [f"{name}: peak {ends}, {computed / measured - 1:+.1%}"] * name.startswith("PMMA")
    print("\n".join(lines), flush=True)
    return found


def print_explained_peaks(folder: Path) -> None:
    """Print the differences of the first peaks of the PMMA panel in air, with magnets that swing in their holder, for
    moduli that rise with the frequency."""
    fixed, (holder, ratio) = scene_of(folder / PANELS["PMMA"][0]).replace("effects.air", {"baffle": False}), HOLDER
    frequency, magnitude, _ = np.loadtxt(folder / f"Z_{PANELS['PMMA'][1]}").T
    laws, omega = [(0.0, 100.0), *product(RISES[1:], PUBLISHED_AT)], 2 * np.pi * holder
    for mass, (rise, at) in product(MAGNETS, laws):
        magnet = {"magnet": "sprung", "magnet_mass": mass, "magnet_stiffness": mass * omega**2}
        magnet["magnet_damping"] = 2 * ratio * mass * omega
        differences = []
        for near in PEAKS:
            scene, factor = fixed, (1 + rise) ** np.log10(near / at)
            for key, value in fixed.effects.orthotropic:
                scene = scene.replace(f"effects.orthotropic.{key}", value * factor)
            coil = {**scene.actuators[0].model_dump(exclude_unset=True), **magnet}
            scene = scene.with_tables(actuators=[coil])
            around = near * np.linspace(1 - AROUND, 1 + AROUND, 121)
            coils = solve_modes(scene, 300.0).coils
            assert coils is not None
            impedance = coils.impedance(2 * np.pi * around)[0][:, 0, 0] + SERIES
            measured, computed = _peaks(near, frequency, magnitude, around, impedance)
            differences.append(f"{computed / measured - 1:+.1%}")
        law = f"modulus {rise:+.1%} by decade, published at {at:g} Hz" if rise else "modulus as published"
        print(f"PMMA in air, magnet of {mass:g} kg, {law}: {', '.join(differences)}", flush=True)


def run(folder: Path, jobs: int) -> dict[str, Any]:
    """Return the comparisons of all panels by name."""
    cases = list(product(TITLES, (False, True)))
    with Pool(jobs) as pool:
        results = pool.starmap(compare_panel, [(folder, *case) for case in cases], chunksize=1)
    return {name + " in air" * air: found for (name, air), found in zip(cases, results, strict=True)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    source = options.source
    results = run(source, options.jobs) if source.is_dir() else json.loads(source.read_text(encoding="utf-8"))
    if source.is_dir():
        print_explained_peaks(source)
    if options.json is not None:
        options.json.write_text(json.dumps(results), encoding="utf-8")
    if options.picture is not None:
        draw(results, options.picture)


if __name__ == "__main__":
    main()
