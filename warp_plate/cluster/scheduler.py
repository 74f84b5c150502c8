"""Tasks over a pool until each is done once: elsewhere where a worker ended, elsewhere and smaller where memory was
short, and twice where one worker is much slower than the others."""

from __future__ import annotations

import statistics
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from warp_plate.cluster.pool import Answer, Pool, Task

# So many workers may end under a task, or be short of memory, before it is to blame itself.
ATTEMPTS = 3
# Where workers are idle, a task is given to a second one after so many times what tasks usually take, and not before
# so many seconds: a host that slows to a tenth holds the others no longer than that and one task more. Before any task
# is done, which may have kernels to compile, it is FIRST_SECONDS.
SLOW, LEAST_SECONDS, FIRST_SECONDS = 3.0, 0.2, 20.0
# Seconds between looks at the clock where nothing comes.
LOOK = 0.05

Halves = Callable[[Task], list[Task]]
Again = Callable[[Task, Mapping[str, Any]], Task | None]


class Tasks(Protocol):
    """As many as it says; each is made when it is asked for."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Task]: ...


@dataclass
class _Flight:
    task: Task
    since: float
    second: bool = False


def spread(
    pool: Pool,
    tasks: Tasks,
    halves: Halves | None = None,
    again: Again | None = None,
    taken: deque[float] | None = None,
) -> Iterator[tuple[Task, Answer]]:
    """Each task with its answer, in the order in which they are done; of a task done twice the first answer counts.

    Args:
        tasks: each is made when a worker has time for it.
        halves: makes of a task for which memory was short two smaller ones that stand for it, and avoid the same
            workers; or none where it cannot be cut any more. Such a task is tried elsewhere.
        again: called with a task and its value; a task that it returns is done in its place.
        taken: seconds that tasks like these took before, to which these are added.

    An answer whose fault is "lost" or "memory" comes after all attempts; one that is "wrong" at once. Whoever leaves
    the loop early, by Ctrl-C too, ends what is under way.

    Raises:
        WorkersGone: see there.
    """
    fresh, left = iter(tasks), len(tasks)
    waiting, running, taken = deque[Task](), dict[int, _Flight](), deque() if taken is None else taken
    done, heard = 0, time.monotonic()
    try:
        while left or waiting or running:
            given = (waiting or left) and pool.free(waiting[0] if waiting else None) > 0
            if given:
                if not waiting:
                    waiting.append(next(fresh))
                    left -= 1
                task = waiting.popleft()
                running[pool.submit(task)] = _Flight(task, time.monotonic())
            elif not (waiting or left):
                _second(pool, running, taken)
            answers = pool.wait(0.0 if given else LOOK)  # who gets the next one depends on what is done
            if answers:
                heard = time.monotonic()
            elif waiting and pool.free() > 0 and heard < _before(taken, FIRST_SECONDS):
                waiting[0].avoid = ()  # for whom it waits may stand still
            for ticket, answer in answers:
                flight = running.pop(ticket, None)
                if flight is None:  # another worker was quicker
                    continue
                others = [number for number, other in running.items() if other.task is flight.task]
                if answer.fault in ("lost", "waiting", "memory") and others:
                    continue
                for number in others:
                    del running[number]
                    pool.forget(number)
                instead = _instead(flight.task, answer, halves, again)
                if instead:
                    if answer.fault in ("lost", "memory"):
                        pool.retried[answer.text] += 1
                    waiting.extendleft(instead)
                    continue
                taken.append(time.monotonic() - flight.since)
                done += 1
                if pool.told is not None:
                    pool.told(done, done + left + len(waiting) + len({id(other.task) for other in running.values()}))
                yield flight.task, answer
    except BaseException:  # also whoever left the loop
        pool.abandon()
        raise


def _before(taken: deque[float], least: float) -> float:
    """What began before this takes long: more than so many seconds at least."""
    usual = SLOW * statistics.median(taken) if taken else FIRST_SECONDS
    return time.monotonic() - max(least, usual)


def _second(pool: Pool, running: dict[int, _Flight], taken: deque[float]) -> None:
    """Give tasks that take long to idle workers too."""
    if pool.idle() == 0:
        return
    late = _before(taken, LEAST_SECONDS)
    for flight in [one for one in running.values() if not one.second and one.since < late]:
        if pool.idle(flight.task) > 0:
            flight.second = True
            running[pool.submit(flight.task)] = _Flight(flight.task, time.monotonic(), second=True)


def _instead(task: Task, answer: Answer, halves: Halves | None, again: Again | None) -> list[Task]:
    """What is to be done in place of a task that came to this answer; nothing where the answer counts."""
    if answer.fault == "" and again is not None:
        repeated = again(task, answer.value)
        return [] if repeated is None else [repeated]
    if answer.fault == "waiting":
        return [task]
    if answer.fault not in ("lost", "memory"):
        return []
    task.avoid = (*(one for one in task.avoid if one != answer.worker), answer.worker)
    smaller = halves(task) if answer.fault == "memory" and halves is not None else []
    if smaller:
        return smaller
    task.attempts += 1
    return [task] if task.attempts < ATTEMPTS else []
