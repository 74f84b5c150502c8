"""Drive signals in time, as a sum of as few terms as possible.

    pressure of actuator k at step n = Σ_t wave[n, t] · coefficient[plate, t, k]

The waves are the same for all plates, or each plate's own (``waves_per_plate``), and the coefficients are the same for
all steps, so a step costs the same for any number of actuators. With V = envelope·Re(Z·carrier), Z the phasor:

    linear:         V                  = Re Z·(e Re a) + (−Im Z)·(e Im a)                  a the carrier, e the envelope
    electrostatic:  gain·(bias + V)²   = gain·(bias² + 2 bias V + ½|Z|² e²|a|² + ½ Re(Z² e²a²))
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from warp_plate.effects.table import TRAVELLING
from warp_plate.plate.waveforms import burst_means, read_samples, resample, tone
from warp_plate.scene.drive import Burst, Drive
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Functions of the phasor in coefficients; a linear drive needs only the first two.
FEATURES = ("Re Z", "-Im Z", "1", "|Z|²", "Re Z²", "-Im Z²")
LINEAR_FEATURES = 2

# Samples in a period of the highest frequency (between two, a sine rises by 2 % at most), and in a run at most.
SAMPLES_A_PERIOD, MOST_SAMPLES = 16, 320
# Samples too few for every period are shifted by multiples of the golden ratio, so as never to keep in step with the
# motion.
GOLDEN = (math.sqrt(5) - 1) / 2

# Terms of equal keys share a wave: power of the envelope; group of the carrier; frequency [Hz], or 0; power of a
# carrier that is no tone, −1 for its size squared. Each has a wave (..., steps) and mixing (features, actuators).
_Terms: TypeAlias = dict[tuple[int, float, float, int], tuple[np.ndarray, np.ndarray]]


class _Carrier(NamedTuple):
    """A carrier and the actuators that it drives."""

    wave: np.ndarray  # (..., steps) complex
    actuators: np.ndarray  # (actuators,) one for driven actuators, otherwise zero
    envelope: Callable[[int], np.ndarray]  # Envelope (..., steps) to a power, 1 or 2
    frequency: float  # Frequency at t = 0 [Hz]; 0 for a file
    group: float  # Start of its burst [s]; or a number from 1 on that no other carrier has


@dataclass(frozen=True)
class Signals:
    """Waves of a scene and how phasors mix them.

    The first step of the waves is halved: the plate is at rest at t = 0, when the load sets in, and half a step later
    its velocity is half of Δt·f/ρH. A whole first load would be an error of first order.
    """

    wave: np.ndarray  # (steps, terms), below two in size
    mixing: np.ndarray  # (terms, features, actuators) factors of the FEATURES in the coefficients
    linear: bool  # True if coefficients are linear in the phasors' real and imaginary parts

    @property
    def terms(self) -> int:
        """Number of waves."""
        return self.wave.shape[1]

    @cached_property
    def _entries(self) -> list[tuple[int, int, int, float]]:
        """Term, feature, actuator and factor of the entries of ``mixing`` that are not zero."""
        return [(t, f, a, float(self.mixing[t, f, a])) for t, f, a in np.argwhere(self.mixing).tolist()]

    def coefficients(self, phasors: np.ndarray) -> np.ndarray:
        """Return (plates, terms, actuators) real factors of the waves for phasors Z (plates, actuators)."""
        features = [phasors.real, -phasors.imag]
        with np.errstate(over="ignore", invalid="ignore"):  # a drive that is not finite affects only its own plate
            if self.linear:
                # Powers of two and zeros: exact in any order. Plates innermost: NumPy is slow along short rows.
                columns = np.zeros((self.terms, phasors.shape[1], len(phasors)))
                for term, feature, actuator, factor in self._entries:
                    columns[term, actuator] += factor * features[feature][:, actuator]
                return columns.transpose(2, 0, 1)
            squared = phasors**2
            features += [np.ones(phasors.shape), np.abs(phasors) ** 2, squared.real, -squared.imag]
            return np.einsum("tfk,fpk->ptk", self.mixing, np.stack(features))


def highest_frequency(scene: Scene) -> float:
    """Return the highest frequency that the time step must carry [Hz], twice that of a voltage that is squared.

    A moving load counts too. For a file it is ``drive.frequency``; the file is not opened.
    """
    return max(times * frequency for _, frequency, times in _named_frequencies(scene))


def key_of_highest(scene: Scene) -> str:
    """Return the key of the highest frequency."""
    return max(_named_frequencies(scene), key=lambda named: named[1] * named[2])[0]


def actuator_frequencies(scene: Scene) -> np.ndarray:
    """Return (actuators,) frequencies of the actuators' carriers at t = 0 [Hz]; ``drive.frequency`` for a file."""
    return np.array([actuator.frequency or scene.drive.frequency for actuator in scene.actuators])


def actuator_delays(scene: Scene) -> np.ndarray:
    """Return (actuators,) starts of the actuators' bursts [s]; 0 without one."""
    common = 0.0 if scene.drive.burst is None else scene.drive.burst.start
    return np.array([common if actuator.delay is None else actuator.delay for actuator in scene.actuators])


def sample_times(scene: Scene) -> tuple[float, ...]:
    """Return the times [s] at which to sample the displacement for its peak.

    If all periods of the run take too many samples, the first burst and a moving load's passage get as many samples as
    the whole run.
    """
    end = scene.window.end
    wanted = math.ceil(SAMPLES_A_PERIOD * highest_frequency(scene) * end)
    if wanted <= MOST_SAMPLES:
        return tuple((end * np.arange(1, wanted + 1) / wanted).tolist())
    spans = [(0.0, end)]
    burst, load = scene.drive.burst, scene.effects.travelling
    if burst is not None:
        spans.append((burst.start, min(burst.start + burst.duration, end)))
    if load is not None and load.from_time < end:
        spans.append((load.from_time, min(load.to_time or end, end)))
    count = MOST_SAMPLES // len(spans)
    place = np.arange(1, count + 1)
    share = (place - place * GOLDEN % 1) / count
    return tuple(start + (stop - start) * part for start, stop in spans for part in share.tolist())


def carrier_frequencies(scene: Scene) -> tuple[float, ...]:
    """Return the different frequencies [Hz] of the carriers at t = 0, in the order of the actuators."""
    return tuple(dict.fromkeys(actuator_frequencies(scene).tolist()))


def waves_apart(scene: Scene) -> int:
    """Return the number of different carriers, each with its burst."""
    if scene.drive.signal is not None and scene.drive.signal.per_actuator:
        return len(scene.actuators)
    return len(set(zip(actuator_frequencies(scene).tolist(), actuator_delays(scene).tolist(), strict=True)))


def check_rate(scene: Scene, time_step: float) -> None:
    """Refuse frequencies of half the steps' rate or more and bursts shorter than a step, by a SceneError."""
    for key, frequency, times in _named_frequencies(scene):
        if times * frequency >= 0.5 / time_step:
            why = "" if times == 1 else " under drive.electrostatic, which doubles it"
            raise SceneError(
                f"{key} = {frequency:g}: a step of {time_step:g} s carries less than {0.5 / time_step / times:.6g} "
                f"Hz{why}; lower it, or write a smaller grid.time_step"
            )
    burst = scene.drive.burst
    if burst is not None and burst.duration < time_step:
        raise SceneError(
            f"drive.burst.duration = {burst.duration:g}: shorter than a step of {time_step:g} s; make it longer, or "
            "write a smaller grid.time_step"
        )


def make_signals(
    scene: Scene, time_step: float, steps: int, folder: Path | None = None, per_actuator: bool = False
) -> Signals:
    """Return the signals of a scene at t = n·time_step, with the file of ``[drive.signal]`` from a folder.

    With ``per_actuator`` every actuator has separate waves, even if it could share them; no file is a carrier then.

    Raises:
        SceneError: The steps cannot carry a frequency or burst, or a file is missing or malformed.
    """
    check_rate(scene, time_step)
    if per_actuator:
        frequency, delay = actuator_frequencies(scene)[None], actuator_delays(scene)[None]
        carriers = _separate_carriers(scene, time_step, steps, frequency, delay)
    else:
        carriers = _shared_carriers(scene, time_step, steps, folder)
    wave, mixing = _columns(scene.drive, steps, carriers)
    return Signals(wave[0] if per_actuator else wave, mixing, scene.drive.electrostatic is None)


def waves_per_plate(
    scene: Scene, time_step: float, steps: int, frequency: np.ndarray, delay: np.ndarray | None
) -> np.ndarray:
    """Return (plates, steps, terms) waves of plates that differ in frequency or start of the burst.

    The terms are those of ``make_signals``, with ``per_actuator`` if there are several carriers; no file is a carrier.
    Frequencies [Hz] and delays [s], None without bursts, are (plates, carriers), one carrier for all actuators or one
    for each.
    """
    return _columns(scene.drive, steps, _separate_carriers(scene, time_step, steps, frequency, delay))[0]


def running_sums(wave: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the running sums over the steps of waves (..., steps, terms), scaled below two in size, and the powers of
    two (..., terms) by which they are scaled.

    A linear plate that begins at rest answers them with the running sums of its rates, which are its displacements.
    """
    sums = np.cumsum(wave, axis=-2)
    size = _power_of_two(np.abs(sums).max(axis=-2))
    return sums / size[..., None, :], size


def plate_harmonic(drive: Drive) -> int:
    """Return the plate's highest frequency as a multiple of the voltage's: its square has twice the frequency."""
    return 1 if drive.electrostatic is None else 2


def _named_frequencies(scene: Scene) -> Iterator[tuple[str, float, int]]:
    """Yield key, frequency [Hz] and the drive's factor of every tone, end of a sweep and moving load."""
    frequencies = [actuator.frequency for actuator in scene.actuators]
    load, square = scene.effects.travelling, plate_harmonic(scene.drive)
    if None in frequencies:
        yield "drive.frequency", scene.drive.frequency, square
    for index, frequency in enumerate(frequencies):
        if frequency is not None:
            yield f"actuators[{index}].frequency", frequency, square
    if scene.drive.chirp is not None:
        yield "drive.chirp.end_frequency", scene.drive.chirp.end_frequency, square
    if load is not None and load.frequency is not None:
        yield f"{TRAVELLING}.frequency", load.frequency, 1


def _envelope(
    burst: Burst | None, time_step: float, steps: int, start: float | np.ndarray | None
) -> Callable[[int], np.ndarray]:
    if burst is None or start is None:
        return lambda power: np.ones(1)
    return partial(burst_means, burst, start, time_step, steps)


def _shared_carriers(scene: Scene, time_step: float, steps: int, folder: Path | None) -> list[_Carrier]:
    """Return each different carrier with each different start of its burst."""
    frequencies, starts, file = actuator_frequencies(scene), actuator_delays(scene), None
    if (signal := scene.drive.signal) is not None:
        # Squaring doubles the band of a file, so only half of it may be filled.
        file = resample(read_samples(signal, folder, starts.size), time_step, steps, 1 / plate_harmonic(scene.drive))
        if signal.per_actuator:
            shaped = [_envelope(scene.drive.burst, time_step, steps, start) for start in starts.tolist()]
            channels = enumerate(zip(file, np.eye(starts.size), shaped, strict=True), 1)
            return [_Carrier(*channel, 0.0, number) for number, channel in channels]
        frequencies = np.zeros(starts.size)
    carriers = []
    for start in dict.fromkeys(starts.tolist()):
        envelope = _envelope(scene.drive.burst, time_step, steps, start)
        for frequency in dict.fromkeys(frequencies[starts == start].tolist()):
            wave = tone(scene.drive.chirp, frequency, time_step, steps) if file is None else file
            driven = ((frequencies == frequency) & (starts == start)).astype(float)
            carriers.append(_Carrier(wave, driven, envelope, frequency, start))
    return carriers


def _separate_carriers(
    scene: Scene, time_step: float, steps: int, frequency: np.ndarray, delay: np.ndarray | None
) -> list[_Carrier]:
    """Return the carriers of ``waves_per_plate``, which share no wave."""
    carriers, actuators = frequency.shape[1], len(scene.actuators)
    driven = np.ones((1, actuators)) if carriers == 1 else np.eye(actuators)
    return [
        _Carrier(
            wave=tone(scene.drive.chirp, frequency[:, [index]], time_step, steps),
            actuators=driven[index],
            envelope=_envelope(scene.drive.burst, time_step, steps, None if delay is None else delay[:, [index]]),
            frequency=1.0,
            group=index + 1,
        )
        for index in range(carriers)
    ]


def _terms(drive: Drive, steps: int, carriers: list[_Carrier]) -> _Terms:
    """Return the terms of all carriers; a complex wave is two terms and takes two features."""
    square, shaped, flat = drive.electrostatic, int(drive.burst is not None), np.ones(steps)
    terms: _Terms = {}

    def add(key: tuple[int, float, float, int], wave: np.ndarray, feature: str, factor: np.ndarray) -> None:
        _, mixing = terms.setdefault(key, (wave, np.zeros((len(FEATURES), factor.size))))
        mixing[FEATURES.index(feature)] += factor

    for wave, driven, envelope, frequency, group in carriers:
        # A tone squared is the tone of twice the frequency, a sweep squared is no sweep.
        power = 0 if frequency and drive.chirp is None else 1
        key, shape = (shaped, group, frequency, power), envelope(1) * wave
        if square is None:
            add(key, shape, "Re Z", driven)
            continue
        if square.bias:
            add((0, 0.0, 0.0, 0), flat, "1", square.gain * square.bias**2 * driven)
            add(key, shape, "Re Z", 2 * square.gain * square.bias * driven)
        squared = envelope(2)
        # Only a file changes in magnitude.
        size = flat if frequency and not shaped else flat * squared * np.abs(wave) ** 2
        key = (2 * shaped, group if shaped or not frequency else 0.0, 0.0, 0 if frequency else -1)
        add(key, size, "|Z|²", square.gain / 2 * driven)
        key = (2 * shaped, group, 2 * frequency, 2 * power)
        add(key, squared * wave**2, "Re Z²", square.gain / 2 * driven)
    return terms


def _columns(drive: Drive, steps: int, carriers: list[_Carrier]) -> tuple[np.ndarray, np.ndarray]:
    """Return real waves (..., steps, terms) below two in size, and mixing (terms, features, actuators)."""
    columns, mixing = [], []
    for wave, mix in _terms(drive, steps, carriers).values():
        columns.append(wave.real)
        mixing.append(mix)
        if np.iscomplexobj(wave):
            # Re(Z·a) = Re Z·Re a + (−Im Z)·Im a: the imaginary part takes the feature after the real part's.
            columns.append(wave.imag)
            mixing.append(np.roll(mix, 1, axis=0))
    waves = np.stack(np.broadcast_arrays(*columns), axis=-1)
    size = _power_of_two(np.abs(waves).max(axis=tuple(range(waves.ndim - 1))))
    waves /= size
    waves[..., 0, :] /= 2
    features = LINEAR_FEATURES if drive.electrostatic is None else len(FEATURES)
    return waves, np.array(mixing)[:, :features] * size[:, None, None]


def _power_of_two(largest: np.ndarray) -> np.ndarray:
    """Return powers of two, at least one and at most ``largest``, to divide by without rounding."""
    power: np.ndarray = 2.0 ** np.floor(np.log2(np.maximum(largest, 1.0)))
    return power
