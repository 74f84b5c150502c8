"""What the actuators do in time, as a sum of terms that is as short as possible.

    pressure of actuator k at step n = Σ_t wave[n, t] · coefficient[plate, t, k]

The waves are the same for all plates, or each plate's own (``waves_per_plate``), and the coefficients are the same for
all steps, so a step costs the same for any number of actuators. With V = envelope·Re(Z·carrier), Z the phasor:

    linear:         V                  = Re Z·(e Re a) + (−Im Z)·(e Im a)                  a the carrier, e the envelope
    electrostatic:  gain·(bias + V)²   = gain·(bias² + 2 bias V + ½|Z|² e²|a|² + ½ Re(Z² e²a²))
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TypeAlias

import numpy as np

from warp_plate.plate.sampled_signal import Samples, read_samples, resample
from warp_plate.scene.drive import Burst, Chirp
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# What a coefficient is made of; the first two are all that a linear drive needs.
FEATURES = ("Re Z", "-Im Z", "1", "|Z|²", "Re Z²", "-Im Z²")
LINEAR_FEATURES = 2
_ONE, _SQUARE = FEATURES.index("1"), FEATURES.index("|Z|²")
_PHASOR, _PHASOR_SQUARED = FEATURES.index("Re Z"), FEATURES.index("Re Z²")

# What tells waves apart → wave (..., steps), mixing. Power of the envelope; its start [s]; frequency [Hz], 0 where none
# is; for what is no tone the power of the carrier, −1 for its size squared; and the carrier's number where each is kept
# apart.
_Key: TypeAlias = tuple[int, float, float, int, int]
_Terms: TypeAlias = dict[_Key, tuple[np.ndarray, np.ndarray]]
# envelope or its square (..., steps), by its power
_Envelope: TypeAlias = Callable[[int], np.ndarray]


@dataclass(frozen=True)
class _Carrier:
    """wave: (..., steps) complex; frequency at t = 0 [Hz], 0 of a file's; steady: whether its size is one throughout;
    actuators: (actuators,) one for those that it drives; start: of its burst [s], 0 without one and where plates
    differ in it; number: from 1 on where it shares no wave with others."""

    wave: np.ndarray
    frequency: float
    steady: bool
    actuators: np.ndarray
    envelope: _Envelope
    start: float = 0.0
    number: int = 0


@dataclass(frozen=True)
class Signals:
    """The time functions of a scene and how phasors mix them.

    wave: (steps, terms), below two in size. The first step is halved: the plate is at rest at t = 0, when the load
    sets in, and half a step later its velocity is half of Δt·f/ρH; a whole first load would be an error of first order.
    mixing: (terms, features, actuators); linear: whether coefficients are linear in the phasors' real and imaginary
    parts, without which no bound holds.
    """

    wave: np.ndarray
    mixing: np.ndarray
    linear: bool

    @property
    def terms(self) -> int:
        """How many waves there are."""
        return self.wave.shape[1]

    @cached_property
    def _mixed(self) -> list[list[int]]:
        """Where ``mixing`` is not zero."""
        places: list[list[int]] = np.argwhere(self.mixing).tolist()
        return places

    def coefficients(self, phasors: np.ndarray) -> np.ndarray:
        """(plates, terms, actuators) real factors of the waves for phasors Z (plates, actuators)."""
        features = [phasors.real, -phasors.imag]
        with np.errstate(over="ignore", invalid="ignore"):  # a drive that is not finite harms its own plate alone
            if self.linear:
                # Powers of two and zeros: exact in any order. Plates innermost: NumPy is slow along short rows.
                columns = np.zeros((self.terms, phasors.shape[1], len(phasors)))
                for term, feature, actuator in self._mixed:
                    part = features[feature][:, actuator]
                    columns[term, actuator] += self.mixing[term, feature, actuator] * part
                return columns.transpose(2, 0, 1)
            squared = phasors**2
            features += [np.ones(phasors.shape), np.abs(phasors) ** 2, squared.real, -squared.imag]
            return np.einsum("tfk,fpk->ptk", self.mixing, np.stack(features))


def highest_frequency(scene: Scene) -> float:
    """[Hz] that the time step must carry: of tones and sweeps, twice that where the voltage is squared; and of a
    moving load.

    Where a file is the carrier, it is what ``drive.frequency`` says instead; no file is opened.
    """
    return max(times * frequency for _, frequency, times in _named_frequencies(scene))


def carrier_frequencies(scene: Scene) -> tuple[float, ...]:
    """The different frequencies [Hz] of the actuators' carriers at t = 0, in the order of the actuators; of a file one
    in all."""
    if scene.drive.signal is not None:
        return (scene.drive.frequency,)
    return tuple(dict.fromkeys(actuator_frequencies(scene).tolist()))


def waves_apart(scene: Scene) -> int:
    """How many different carriers there are, each with its burst."""
    frequencies = carrier_frequencies(scene)[:1] * len(scene.actuators)
    if scene.drive.signal is None:
        frequencies = tuple(actuator_frequencies(scene).tolist())
    return len(set(zip(frequencies, actuator_delays(scene).tolist(), strict=True)))


def actuator_frequencies(scene: Scene) -> np.ndarray:
    """(actuators,) frequency at t = 0 [Hz] of each actuator's tone."""
    return np.array([actuator.frequency or scene.drive.frequency for actuator in scene.actuators])


def actuator_delays(scene: Scene) -> np.ndarray:
    """(actuators,) start [s] of each actuator's burst; 0 without one."""
    burst = scene.drive.burst
    common = 0.0 if burst is None else burst.start
    return np.array([common if actuator.delay is None else actuator.delay for actuator in scene.actuators])


def check_rate(scene: Scene, time_step: float) -> None:
    """Refuse what the steps cannot carry.

    Raises:
        SceneError: a frequency of half the steps' rate or more, or a burst shorter than a step.
    """
    for key, frequency, square in _named_frequencies(scene):
        if square * frequency >= 0.5 / time_step:
            why = "" if square == 1 else " under drive.electrostatic, which doubles it"
            raise SceneError(
                f"{key} = {frequency:g}: a step of {time_step:g} s carries less than {0.5 / time_step / square:.6g} "
                f"Hz{why}; lower it, or write a smaller grid.time_step"
            )
    burst = scene.drive.burst
    if burst is not None and burst.duration < time_step:
        raise SceneError(
            f"drive.burst.duration = {burst.duration:g}: shorter than a step of {time_step:g} s; make it longer, or "
            "write a smaller grid.time_step"
        )


def make_signals(
    scene: Scene, time_step: float, steps: int, folder: Path | None = None, each: bool = False
) -> Signals:
    """The signals of a scene at t = n·time_step [s]; ``folder`` is where the file of ``[drive.signal]`` lies.

    ``each``: every actuator gets waves of its own, also where it might share them.

    Raises:
        SceneError: a frequency that the steps cannot carry, a burst shorter than a step, a file that is missing or
            not what it should be.
    """
    check_rate(scene, time_step)
    samples = None if scene.drive.signal is None else read_samples(scene.drive.signal, folder)
    burst = scene.drive.burst

    def envelope(start: float, power: int) -> np.ndarray:
        return np.ones(1) if burst is None else _burst(burst, start, time_step, steps, power)

    terms = _terms(scene, steps, _carriers(scene, time_step, steps, samples, envelope, each))
    features = LINEAR_FEATURES if scene.drive.electrostatic is None else len(FEATURES)
    wave, mixing = _columns(terms, steps, features, len(scene.actuators))
    return Signals(wave, mixing, scene.drive.electrostatic is None)


def waves_per_plate(
    scene: Scene, time_step: float, steps: int, frequency: np.ndarray, delay: np.ndarray | None
) -> np.ndarray:
    """(plates, steps, terms) waves of plates with frequencies [Hz] and starts of the burst [s] of their own.

    frequency: (plates, carriers), one carrier for all actuators or one for each; delay: the same, None without bursts.
    The terms are those of ``make_signals``, with ``each`` where there is more than one carrier; no file is a carrier.
    """
    carriers, actuators = frequency.shape[1], len(scene.actuators)
    drives = np.ones((1, actuators)) if carriers == 1 else np.eye(actuators)
    burst = scene.drive.burst

    def envelope(power: int, index: int) -> np.ndarray:
        if burst is None or delay is None:
            return np.ones(1)
        return _burst(burst, delay[:, index, None], time_step, steps, power)

    made = [
        _Carrier(
            _tone(scene, frequency[:, index, None], time_step, steps), 1.0, True, who,
            partial(envelope, index=index), number=index + 1,
        )
        for index, who in enumerate(drives)
    ]
    terms = _terms(scene, steps, made)
    features = LINEAR_FEATURES if scene.drive.electrostatic is None else len(FEATURES)
    wave, _ = _columns(terms, steps, features, actuators)
    return wave


def running_sums(wave: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Σ over the steps up to each one, of waves (..., steps, terms), below two in size; and the powers of two (...,
    terms) by which they were divided.

    A plate that is linear, does not change and begins at rest answers them with the running sums of its rates, which
    are its displacements.
    """
    sums = np.cumsum(wave, axis=-2)
    size = _size(np.abs(sums).max(axis=-2))
    return sums / size[..., None, :], size


def _terms(scene: Scene, steps: int, carriers: Iterable[_Carrier]) -> _Terms:
    drive, square = scene.drive, scene.drive.electrostatic
    shaped = drive.burst is not None
    flat = np.ones(steps)
    terms: _Terms = {}
    for one in carriers:
        carrier, frequency, who, start, number = one.wave, one.frequency, one.actuators, one.start, one.number
        # Actuators share a wave that has the same key: a tone squared is the tone of twice the frequency, a sweep not.
        other = 0 if frequency and drive.chirp is None else 1
        shape = one.envelope(1) * carrier
        if square is None:
            _add(terms, (shaped, start, frequency, other, number), shape, _PHASOR, who)
            continue
        squared = one.envelope(2)
        if square.bias:
            _add(terms, (0, 0.0, 0.0, 0, 0), flat, _ONE, square.gain * square.bias**2 * who)
            _add(terms, (shaped, start, frequency, other, number), shape, _PHASOR, 2 * square.gain * square.bias * who)
        size = flat if one.steady and not shaped else flat * squared * np.abs(carrier) ** 2
        of_size = (2 * shaped, start, 0.0, 0 if one.steady else -1, number if shaped else 0)
        _add(terms, of_size, size, _SQUARE, square.gain / 2 * who)
        twice = squared * carrier**2
        of_twice = (2 * shaped, start, 2 * frequency, 2 * other, number)
        _add(terms, of_twice, twice, _PHASOR_SQUARED, square.gain / 2 * who)
    return terms


def step_means(integral: Callable[[np.ndarray], np.ndarray], time_step: float, steps: int) -> np.ndarray:
    """(steps,) mean of a function over the step around each t_n, from its integral; n = 0 has only the later half.

    What jumps between two steps is then right to second order, as the scheme is, wherever between them it jumps.
    """
    edges = time_step * np.concatenate([[0.0], np.arange(steps) + 0.5])
    means: np.ndarray = np.diff(integral(edges)) / np.diff(edges)
    return means


def _square(scene: Scene) -> int:
    """By how much the drive multiplies the frequencies of a voltage."""
    return 1 if scene.drive.electrostatic is None else 2


def _named_frequencies(scene: Scene) -> Iterator[tuple[str, float, int]]:
    """Every frequency [Hz] that some actuator or the moving load has at some time, with its key, and by how much the
    drive multiplies it."""
    own, load, square = [actuator.frequency for actuator in scene.actuators], scene.effects.moving_load, _square(scene)
    if scene.drive.signal is not None or None in own:
        yield "drive.frequency", scene.drive.frequency, square
    for index, frequency in enumerate(own):
        if frequency is not None:
            yield f"actuators[{index}].frequency", frequency, square
    if scene.drive.chirp is not None:
        yield "drive.chirp.end_frequency", scene.drive.chirp.end_frequency, square
    if load is not None and load.frequency is not None:
        yield "effects.moving_load.frequency", load.frequency, 1


def _carriers(
    scene: Scene,
    time_step: float,
    steps: int,
    samples: Samples | None,
    envelope: Callable[[float, int], np.ndarray],
    each: bool,
) -> Iterator[_Carrier]:
    """Each different carrier with each different start of its burst, or each actuator's.

    ``envelope``: of its start [s] and its power, 1 or 2.
    """
    actuators = len(scene.actuators)
    own, starts = actuator_frequencies(scene), actuator_delays(scene)
    if each and samples is None:
        for index, who in enumerate(np.eye(actuators)):
            start = float(starts[index])
            tone = _tone(scene, own[index], time_step, steps)
            yield _Carrier(tone, 1.0, True, who, partial(envelope, start), start, index + 1)
        return
    # Squaring doubles the band of a file, so only half of it may be filled.
    file = None if samples is None else resample(samples, time_step, steps, 1 / _square(scene))
    for start in dict.fromkeys(starts.tolist()):
        shape = partial(envelope, start)
        if file is not None:
            yield _Carrier(file, 0.0, False, (starts == start).astype(float), shape, start)
            continue
        for frequency in dict.fromkeys(own[starts == start].tolist()):
            who = ((own == frequency) & (starts == start)).astype(float)
            yield _Carrier(
                _tone(scene, np.float64(frequency), time_step, steps), frequency, True, who, shape, start
            )


def _tone(scene: Scene, frequency: np.ndarray | np.float64, time_step: float, steps: int) -> np.ndarray:
    """(..., steps) complex tone, or sweep, from frequencies (..., 1) or () [Hz] at t = 0."""
    if scene.drive.chirp is None:
        angle = 2 * math.pi * frequency * time_step * np.arange(steps)
    else:
        angle = _sweep(scene.drive.chirp, np.asarray(frequency), time_step * np.arange(steps))
    return np.cos(angle) + 1j * np.sin(angle)


def _sweep(chirp: Chirp, start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(..., steps) phase [rad] of a sweep from ``start`` (..., 1) or () [Hz], the integral of 2πf over time."""
    span, end = chirp.duration, chirp.end_frequency
    inside = np.minimum(times, span)
    cycles = inside * (start + (end - start) / 2 * (inside / span))
    if chirp.law == "logarithmic":
        growth = np.array([math.log(end / one) for one in start.flat]).reshape(start.shape)
        grown = start * span / np.where(growth == 0, 1, growth) * np.expm1(growth * (inside / span))
        cycles = np.where(growth == 0, cycles, grown)
    angle: np.ndarray = 2 * math.pi * (cycles + end * (times - inside))
    return angle


def _burst(burst: Burst, start: np.ndarray | float, time_step: float, steps: int, power: int) -> np.ndarray:
    """(..., steps) means over a step of the envelope, or of its square (power 1 or 2), its ramps ½(1 − cos πt/ramp).

    start: (..., 1) or a number [s], instead of the burst's own.
    """
    duration, ramp = burst.duration, burst.ramp
    whole_ramp = ramp / 2 if power == 1 else 3 * ramp / 8

    def risen(time: np.ndarray) -> np.ndarray:
        """Integral of the rise up to ``time`` within 0 ... ramp."""
        if not ramp:
            return 0 * time
        turn = math.pi / ramp
        if power == 1:
            return (time - np.sin(turn * time) / turn) / 2
        return 3 * time / 8 - np.sin(turn * time) / (2 * turn) + np.sin(2 * turn * time) / (16 * turn)

    def once(time: np.ndarray) -> np.ndarray:
        top = np.clip(time - ramp, 0, max(duration - 2 * ramp, 0))
        falling = np.clip(time - (duration - ramp), 0, ramp)
        return risen(np.clip(time, 0, ramp)) + top + (whole_ramp - risen(ramp - falling))

    def integral(time: np.ndarray) -> np.ndarray:
        since = time - start
        past = np.zeros(since.shape) if burst.period is None else np.maximum(np.floor(since / burst.period), 0)
        each = max(duration - 2 * ramp, 0) + 2 * whole_ramp
        return past * each + once(since - past * (burst.period or 0.0))

    return step_means(integral, time_step, steps)


def _add(terms: _Terms, key: _Key, wave: np.ndarray, feature: int, factor: np.ndarray) -> None:
    """Put a term in, or onto one with the same wave; a complex wave is two terms, and takes two features."""
    if key not in terms:
        terms[key] = (wave, np.zeros((len(FEATURES), factor.size)))
    terms[key][1][feature] += factor


def _columns(terms: _Terms, steps: int, features: int, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    """Real waves (..., steps, terms) below two in size, and mixing (terms, features, actuators)."""
    count = sum(2 if np.iscomplexobj(wave) else 1 for wave, _ in terms.values())
    plates = np.broadcast_shapes(*(wave.shape[:-1] for wave, _ in terms.values()))
    waves, mixing = np.empty((*plates, steps, count)), np.zeros((count, features, actuators))
    column = 0
    for wave, mix in terms.values():
        waves[..., column] = wave.real
        mixing[column] = mix[:features]
        column += 1
        if np.iscomplexobj(wave):
            # Re(Z·a) = Re Z·Re a + (−Im Z)·Im a: the imaginary part takes the feature after the real part's.
            waves[..., column] = wave.imag
            mixing[column] = np.roll(mix, 1, axis=0)[:features]
            column += 1
    size = _size(np.abs(waves).max(axis=tuple(range(waves.ndim - 1))))
    waves /= size
    waves[..., 0, :] /= 2
    return waves, mixing * size[:, None, None]


def _size(largest: np.ndarray) -> np.ndarray:
    """Powers of two, which round nothing: a gain of a million belongs to the coefficients."""
    size: np.ndarray = 2.0 ** np.floor(np.log2(np.maximum(largest, 1.0)))
    return size
