"""Checks each peer against the reference, then times the sound ones in turn: A B C A B C ..."""

from __future__ import annotations

import importlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from peer_codes.problem import PeerMissing, Problem, Run, reference

TOLERANCE = {"float32": 1e-4, "float64": 1e-10}  # relative, of the energies; sound peers reach 5e-6 and 5e-15
REFERENCE_NODE_STEPS = 2e7  # under a second for the reference
CHECK_NODE_STEPS = {"cpu": 5e7, "cuda": 2e11}  # under a second for the slowest peer


@dataclass(frozen=True)
class Peer:
    """An entry of the contest: `function` of peer_codes.`module`, called with (problem, threads)."""

    name: str
    module: str
    devices: tuple[str, ...]  # where it runs unless asked for by name
    threaded: bool = False  # whether it heeds `threads` on a CPU
    function: str = "make"
    orders: tuple[int, ...] = (2,)


@dataclass(frozen=True)
class Entry:
    """A peer made ready for one case."""

    peer: Peer
    threads: int
    problem: Problem  # of as many steps as its runs take
    run: Run
    error: float  # largest relative error of the energies found in the check


@dataclass(frozen=True)
class Timing:
    """Times of an entry, in ns per interior node and step."""

    entry: Entry
    median: float
    least: float
    most: float


@dataclass(frozen=True)
class Check:
    """A problem short enough for the reference, and its answer for some of the plates."""

    problem: Problem
    plates: list[int]
    energies: np.ndarray  # (len(plates), 2)

    def error(self, energies: np.ndarray) -> float:
        """Largest relative error of energies (plates, 2); infinite for a wrong shape or a nan."""
        if energies.shape != (self.problem.plates, 2) or not np.isfinite(energies).all():
            return np.inf
        return float(np.abs(energies[self.plates] / self.energies - 1).max())


def make_check(problem: Problem) -> Check:
    """The whole batch over as many steps as the reference affords; it does the first, last and two plates."""
    random = np.random.default_rng(problem.seed).integers(problem.plates, size=2)
    plates = sorted({0, problem.plates - 1, *random.tolist()})
    nodes = (problem.nodes - 2) ** 2
    by_reference = REFERENCE_NODE_STEPS / (len(plates) * nodes)
    by_peers = CHECK_NODE_STEPS[problem.device] / (problem.plates * nodes)
    short = replace(problem, steps=min(problem.steps, max(20, int(min(by_reference, by_peers)))))
    return Check(short, plates, reference(short, plates))


def prepare(peer: Peer, problem: Problem, threads: int, check: Check, seconds: float) -> Entry:
    """Make a peer ready: check it, then give it as many of the problem's steps as take it about `seconds`.

    Raises PeerMissing, or ImportError from the peer's module, where it cannot run here; ArithmeticError where
    its answer is wrong.
    """
    make = getattr(importlib.import_module(f"peer_codes.{peer.module}"), peer.function)
    run = make(check.problem, threads)
    error = check.error(run())
    start = time.perf_counter()
    again = run()  # from zero state once more; compiled by now
    took = time.perf_counter() - start
    error = max(error, check.error(again))
    if not error <= TOLERANCE[problem.precision]:
        raise ArithmeticError(f"wrong answer: relative error {error:.1e}")
    affordable = int(check.problem.steps * seconds / took)
    chosen = replace(problem, steps=max(20, min(problem.steps, affordable)))
    if chosen.steps != check.problem.steps:
        run = make(chosen, threads)
        run()
    return Entry(peer, threads, chosen, run, error)


def prepare_all(
    peers: Sequence[Peer], problem: Problem, threads: Sequence[int], seconds: float
) -> tuple[list[Entry], dict[str, str]]:
    """Every peer with every number of threads it heeds, and why the others are absent."""
    check = make_check(problem)
    entries: list[Entry] = []
    absent: dict[str, str] = {}
    for peer in peers:
        for count in threads if peer.threaded and problem.device == "cpu" else (1,):
            label = f"{peer.name}, {count} threads" if count > 1 else peer.name
            try:
                entries.append(prepare(peer, problem, count, check, seconds))
            except ImportError as error:
                absent[label] = f"not installed ({error})"
            except (PeerMissing, ArithmeticError) as error:
                absent[label] = str(error)
            except (MemoryError, RuntimeError) as error:  # a GPU that is full, a compiler that gives up
                absent[label] = f"failed: {type(error).__name__}: {(str(error).splitlines() or [''])[0]}"
    return entries, absent


def time_in_turn(entries: Sequence[Entry], rounds: int) -> list[Timing]:
    """All entries one after another, `rounds` times over, so that a noisy spell hits all alike."""
    times: list[list[float]] = [[] for _ in entries]
    for _ in range(rounds):
        for entry, taken in zip(entries, times, strict=True):
            time.sleep(0.02)  # idle worker threads of the last peer spin for a while before they sleep
            start = time.perf_counter()
            entry.run()
            taken.append((time.perf_counter() - start) / entry.problem.node_steps * 1e9)
    return [Timing(entry, median(t), min(t), max(t)) for entry, t in zip(entries, times, strict=True)]
