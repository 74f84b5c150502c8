"""Plants faults in the measurements of random panels, and counts the verdicts of fits that name them.

    python benchmarks/planted_faults.py --panels 100 --out benchmarks/results/planted-faults.json
    python benchmarks/planted_faults.py --panels 100 --clean

Each panel has a fault in turn: in its responses with 1 % noise (its modulus and loss factor are fitted), or in its
natural frequencies with 0.2 % noise; or in a record of its motion by a random force. With ``--clean`` there is none,
and verdicts against the model are false alarms.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.io import wavfile

from warp_plate import Scene
from warp_plate.fitting.fit import fit, fit_modes, fit_responses
from warp_plate.fitting.measured_modes import MeasuredModes
from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.fitting.panel_responses import PanelResponses
from warp_plate.fitting.verdict import thin_plate_error
from warp_plate.modal.modes import solve_modes

NOISE, NOISE_OF_MODES, GRAVITY, MODES, FREQUENCIES = 0.01, 0.002, 9.80665, 10, 120
FREE = {"plate.young_modulus": (50e9, 100e9), "effects.loss_factor.eta": (0.002, 0.1)}
MODULI = {"plate.young_modulus": (40e9, 120e9)}
Arrays = tuple[np.ndarray, np.ndarray]


def power(order: int) -> Callable[[Arrays], np.ndarray]:
    return lambda data: data[1] * (2j * np.pi * data[0]) ** order


def factor(value: complex, sensor: int | None = None) -> Callable[[Arrays], np.ndarray]:
    def scaled(data: Arrays) -> np.ndarray:
        chosen = np.arange(len(data[1]))[:, None] == sensor if sensor is not None else True
        return np.where(chosen, value * data[1], data[1])

    return scaled


def order(*sensors: int) -> Callable[[Arrays], np.ndarray]:
    return lambda data: data[1][list(sensors)]


# Faults of the responses of three sensors, and the cause that names each.
IN_DATA = {
    "sign": ("sign", factor(-1)),
    "in g": ("gravity", factor(1 / GRAVITY)),
    "9.81 twice": ("gravity", factor(GRAVITY)),
    "sign and in g": ("sign and gravity", factor(-1 / GRAVITY)),
    "mm/s²": ("thousand", factor(1e3)),
    "mobility": ("quantity", power(-1)),
    "receptance": ("quantity", power(-2)),
    "conjugate": ("phase", lambda data: data[1].conj()),
    "two sensors exchanged": ("order", order(1, 0, 2)),
    "sensors turned": ("order", order(1, 2, 0)),
    "sign of a sensor": ("sign of a sensor", factor(-1, 1)),
    "a sensor in g": ("gravity of a sensor", factor(1 / GRAVITY, 2)),
}
# Faults of the scene: places that are written wrongly.
IN_PLACES = {
    "mirrored in x": ("mirrored in x", lambda size, at: (size[0] - at[0], at[1])),
    "mirrored in y": ("mirrored in y", lambda size, at: (at[0], size[1] - at[1])),
    "turned": ("turned", lambda size, at: (size[0] - at[0], size[1] - at[1])),
    "other edge": ("mirrored in x", None),
}
IN_MODES = ("missing mode", "further mode", "rad/s", "thick")
IN_TIME = ("clipped", "channels", "exponential window")
FAULTS = (*IN_DATA, *IN_PLACES, *IN_MODES, *IN_TIME)
# Decay rate of the exponential window over that of the lowest mode; part of the largest sample of a sensor at which its
# record is clipped; segments of the record, and their duration in periods of the lowest mode.
WINDOW, CLIPPED, SEGMENTS, PERIODS = (5.0, 20.0), 0.6, 8, 100


def random_panel(random: np.random.Generator, thick: bool = False) -> Scene:
    """Return a panel of aluminium that is clamped or supported on the left."""
    size = (random.uniform(0.25, 0.4), random.uniform(0.15, 0.22))
    edges = {side: str(random.choice(["supported", "free"])) for side in ("bottom", "top")}
    if len(set(edges.values())) == 1:
        edges["top"] = "free" if edges["top"] == "supported" else "supported"
    left = str(random.choice(["clamped", "supported"]))
    thickness = 0.12 * size[1] if thick else random.uniform(0.001, 0.003)
    area = {"area": (0.05, 0.07, 0.05, 0.07)}
    plate = {"size": size, "thickness": thickness, "density": 2700.0, "young_modulus": 70e9, "poisson_ratio": 0.33}
    rows = [
        {"force_at": at[0], "point": point}
        for at in [[tuple(float(random.uniform(0.1, 0.9) * side) for side in size) for _ in range(4)]]
        for point in at[1:]
    ]
    return Scene.from_tables({
        "plate": plate, "edges": {"left": left, "right": "free", **edges}, "measurement": rows, "target": area,
        "effects": {"loss_factor": {"eta": 0.02}}, "actuators": [{"name": "a", **area}], "drive": {"frequency": 100.0},
        "fit": {"free": FREE, "starts": 1}, "grid": {"modal_density": 0.5},
    })  # fmt: skip


def elastic_frequencies(scene: Scene, count: int) -> np.ndarray:
    frequencies = solve_modes(scene, highest=0.0, count=count + 3).frequencies
    return frequencies[frequencies > 0][:count]


def verdict_on_responses(scene: Scene, fault: str | None, random: np.random.Generator) -> tuple[str | None, object]:
    """Return the cause that should be named and the verdict on responses."""
    frequencies = np.linspace(0.5 * elastic_frequencies(scene, 1)[0], elastic_frequencies(scene, 8)[-1], FREQUENCIES)
    exact = PanelResponses(scene, MeasuredResponses("", frequencies, np.ones((3, FREQUENCIES), complex))).values
    noise = random.normal(size=(2, *exact.shape)) * NOISE / np.sqrt(2)
    data, wanted = exact * (1 + noise[0] + 1j * noise[1]), None
    if fault in IN_DATA:
        wanted, change = IN_DATA[fault]
        data = change((frequencies, data))
    elif fault in IN_PLACES:
        wanted, move = IN_PLACES[fault]
        size = scene.plate.size
        if move is None:
            edges = {"left": "free", "right": scene.edges.left, "bottom": scene.edges.bottom, "top": scene.edges.top}
            scene = scene.with_tables(edges=edges)
        else:
            rows = [{"force_at": move(size, row.force_at), "point": move(size, row.point)} for row in scene.measurement]
            scene = scene.with_tables(measurement=rows)
    wrong = scene.replace("plate.young_modulus", random.uniform(62e9, 82e9))
    return wanted, fit_responses(wrong, MeasuredResponses("a", frequencies, data)).verdict


def verdict_on_window(scene: Scene, fault: str | None, random: np.random.Generator) -> tuple[str | None, object]:
    """Return the cause that should be named and the verdict on responses of hits under an exponential window."""
    resonances = elastic_frequencies(scene, 8)
    frequencies = np.linspace(0.5 * resonances[0], resonances[-1], FREQUENCIES)
    rate = np.pi * scene.effects.loss_factor.eta * resonances[0] * random.uniform(*WINDOW) if fault else 0.0
    flat = MeasuredResponses("", frequencies, np.ones((3, FREQUENCIES), complex), decay=rate)
    noise = random.normal(size=(2, *flat.responses.shape)) * NOISE / np.sqrt(2)
    data = PanelResponses(scene, flat).values * (1 + noise[0] + 1j * noise[1])
    wrong = scene.replace("plate.young_modulus", random.uniform(62e9, 82e9))
    return fault, fit_responses(wrong, MeasuredResponses("a", frequencies, data)).verdict


def verdict_on_record(scene: Scene, fault: str | None, random: np.random.Generator) -> tuple[str | None, object]:
    """Return the cause that should be named and the verdict on a record of a random force and three sensors."""
    resonances = elastic_frequencies(scene, 8)
    rate, segment = round(3 * resonances[-1]), PERIODS / resonances[0]
    samples = int((SEGMENTS + 1) / 2 * segment * rate)
    lines = np.fft.rfftfreq(samples, 1 / rate)
    inside = (lines > 0.3 * resonances[0]) & (lines < 1.2 * resonances[-1])
    spectrum = np.where(inside, random.normal(size=lines.size) + 1j * random.normal(size=lines.size), 0)
    at = np.linspace(lines[inside][0], lines[inside][-1], 4000)
    response = PanelResponses(scene, MeasuredResponses("", at, np.ones((3, at.size), complex))).values
    rows = [np.interp(lines, at, row.real) + 1j * np.interp(lines, at, row.imag) for row in response]
    record = np.fft.irfft(np.array([spectrum, *(row * spectrum for row in rows)]), samples)
    record += NOISE * record.std(axis=1, keepdims=True) * random.normal(size=record.shape)
    if fault == "channels":
        record = record[np.insert([1, 2, 3], random.integers(1, 4), 0)]
    elif fault == "clipped":
        sensor = random.integers(1, 4)
        most = CLIPPED * np.abs(record[sensor]).max()
        record[sensor] = record[sensor].clip(-most, most)
    signals = {"segment": segment}
    wrong = scene.with_tables(fit={**scene.fit.model_dump(exclude_none=True), "signals": signals,
                                   "range": (0.5 * resonances[0], resonances[-1])})  # fmt: skip
    with TemporaryDirectory() as folder:
        wavfile.write(path := Path(folder) / "a.wav", rate, record.T.astype(np.float32))
        return fault, fit(wrong.replace("plate.young_modulus", random.uniform(62e9, 82e9)), path).verdict


def verdict_on_modes(scene: Scene, fault: str | None, random: np.random.Generator) -> tuple[str | None, object]:
    """Return the cause that should be named and the verdict on natural frequencies."""
    exact = elastic_frequencies(scene, MODES + 1)
    noisy, wanted = np.sort(exact * (1 + NOISE_OF_MODES * random.normal(size=len(exact)))), fault
    if fault == "missing mode":
        noisy = np.delete(noisy, random.integers(0, MODES - 2))
    elif fault == "further mode":
        noisy = np.sort([*noisy[:-1], random.uniform(noisy[0], noisy[MODES - 2])])
    elif fault == "rad/s":
        noisy, wanted = noisy * 2 * np.pi, "unit"
    elif fault == "thick":
        noisy = noisy / (1 + np.array([thin_plate_error(scene, frequency) for frequency in noisy]))
    wrong = scene.with_tables(fit={"free": MODULI, "starts": 3}).replace("plate.young_modulus", 80e9)
    return wanted, fit_modes(wrong, MeasuredModes("a", noisy, np.full(len(noisy), np.nan))).verdict


def judged(number: int, clean: bool) -> dict:
    """Return the row of a panel."""
    random = np.random.default_rng([number, 48])
    fault = FAULTS[number % len(FAULTS)]
    scene = random_panel(random, thick=fault == "thick" and not clean)
    judge = verdict_on_modes if fault in IN_MODES else verdict_on_responses
    judge = verdict_on_record if fault in ("clipped", "channels") else judge
    judge = verdict_on_window if fault == "exponential window" else judge
    wanted, verdict = judge(scene, None if clean else fault, random)
    named = verdict.describes if clean else not verdict.describes and verdict.cause == wanted
    return {"panel": number, "fault": None if clean else fault, "right": named, "error": verdict.error,
            "cause": verdict.cause, "text": verdict.text}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--panels", type=int, default=100)
    parser.add_argument("--clean", action="store_true", help="panels without faults")
    parser.add_argument("--out", type=Path, help="counts and rows as JSON")
    asked = parser.parse_args()
    rows = []
    for number in range(asked.first, asked.first + asked.panels):
        rows.append(judged(number, asked.clean))
        print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
    found = {"panels": len(rows), "right": sum(row["right"] for row in rows), "rows": rows}
    print(f"{found['right']} of {len(rows)} verdicts are right")
    if asked.out:
        asked.out.write_text(json.dumps(found, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
