"""How much of a long search runs: a share of it in `make test`, which a person waits for, and all of it in
`make test-deep`.

A fault that one example in a hundred shows is found by the deep run; the quick one finds what is broken.
"""

from __future__ import annotations

import os
import random
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

VARIABLE = "SKYGCS_TEST_EXAMPLES"
"""Environment variable with the multiple of Hypothesis examples: 10 in `make test-deep`, 100 in its nightly run; `make
test` does not set it."""

SEARCH = "SKYGCS_TEST_SEARCH"
"""Environment variable: set, the run takes random examples and a random seed of hashes (`make test-deep SEARCH=1`, the
nightly run). Without it a run of the same code is the same run: what fails, fails again, and is a fault of the change
that is tested. A fault that one seed in ten thousand shows stopped a change that had nothing to do with it."""

SEED_OFFSET = "SKYGCS_TEST_SEED_OFFSET"
"""Environment variable: a number, 0 by default, that is added to each seed (`shift_seeds`). A test of a network with
random losses passes with any of them: run a new one with offsets 1 to 3."""

SHARE = 4
"""`make test` runs one example or seed in so many."""

CASES = 1
"""Cases of a parametrised flight of a whole daemon in `make test`, another one of each flight. `make test-deep` flies
each value of each parameter (`each_value`), its nightly run all combinations."""

SEEDS_APART = 1_000_003
"""Between two offsets: the tests' own seeds are small numbers in a row, and would be each other's."""

LEAST = 10
LEAST_SEEDS = 2

T = TypeVar("T")


def searches() -> bool:
    """True if this run looks for new examples."""
    return bool(os.environ.get(SEARCH))


def is_deep() -> bool:
    """True in `make test-deep`, which says how many examples it takes."""
    return bool(_multiple())


def shift_seeds() -> None:
    """Give each number that seeds a `random.Random` of this process the offset that the environment names: those of
    networks, simulated vehicles and radios, of the tests and of Hypothesis."""
    offset = int(os.environ.get(SEED_OFFSET, "0")) * SEEDS_APART
    if not offset:
        return
    seed_as_said = random.Random.seed

    def seed(rng: random.Random, a: Any = None, version: int = 2) -> None:
        seed_as_said(rng, a + offset if isinstance(a, int) else a, version)

    random.Random.seed = seed  # type: ignore[method-assign, assignment]


def _multiple() -> int:
    return int(os.environ.get(VARIABLE, "0"))


def examples(count: int) -> int:
    """Hypothesis examples of a test that says ``count``."""
    return count * _multiple() or min(count, max(LEAST, count // SHARE))


def seeds(count: int) -> range:
    """Seeds of a random scenario: a share of ``count``, all of them in the deep run, more in the nightly one."""
    return range(count * max(1, _multiple() // 10) if _multiple() else min(count, max(LEAST_SEEDS, count // SHARE)))


def flown_cases(cases: Sequence[T], turn: int) -> Sequence[T]:
    """`CASES` of the cases of one flight. Flights take different ``turn``s: some fly a PX4, others an ArduCopter."""
    step = len(cases) // 2 | 1  # odd: the next one is, as a rule, of the other autopilot
    return [cases[(turn + number * step) % len(cases)] for number in range(min(CASES, len(cases)))]


def each_value(cases: Sequence[Sequence[str]]) -> list[int]:
    """Numbers of cases of one flight, each given by the ids of its parameters, in which every value of every parameter
    is flown: of three modes and two autopilots three cases, not six."""
    pairs = [set(enumerate(ids)) for ids in cases]
    left = set().union(*pairs)
    chosen = []
    while left:
        number = max(range(len(pairs)), key=lambda n: (len(left & pairs[n]), -n))
        left -= pairs[number]
        chosen.append(number)
    return sorted(chosen)


def thinned(items: Iterable[T], keep: int, *, turn: int = 0) -> Sequence[T]:
    """``keep`` of a table's rows, evenly spaced; all of them in the deep run. Tests over one table take different
    ``turn``s, so that each row has its turn in some of them."""
    rows = list(items)
    if _multiple() or len(rows) <= keep:
        return rows
    step = len(rows) / keep
    return [rows[(int(number * step) + turn) % len(rows)] for number in range(keep)]
