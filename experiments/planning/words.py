"""The cost of fields without effect: `python experiments/planning/words.py`.

Each word of `tests/test_words.py` is added, in a library of 500 and of 1,000 transformations, to two that can't be
started, and to two that no target needs. Hosts, resources and links that never bind are added to the plan's units, and
words that never bind to its transformations. Prints the CPU time of a plan with the word as a multiple of that without
it, the median of some seeds; ends with 1 if a cost, status or proof differs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "planners"), str(ROOT / "tests"), str(ROOT)]

from test_words import WORDS, Word  # noqa: E402

from cfgplan.domain import Environment, Host, InputPort, Link, Objective, Transformation  # noqa: E402
from cfgplan.planners.exact.session import PlannerSession  # noqa: E402
from cfgplan.planning import Plan, Problem  # noqa: E402
from cfgplan.qualities import MICRO  # noqa: E402
from experiments.families.random_library import random_library  # noqa: E402

Said = Callable[[Environment], Environment]
HOSTS = (Host("h"), Host("k"))


def with_each(changed: Callable[[Transformation], Transformation]) -> Said:
    """Return a function that changes each transformation of an environment."""
    return lambda environment: replace(environment, library=tuple(map(changed, environment.library)))


def _with_outputs(t: Transformation, **said: int) -> Transformation:
    return replace(t, outputs=tuple(replace(port, **said) for port in t.outputs))  # type: ignore[arg-type]


def _on_hosts(environment: Environment) -> Environment:
    """The environment on two hosts, with streams that are carried for a price."""
    library = tuple(_with_outputs(t, rate_uhz=MICRO, size_bytes=1000) for t in environment.library)
    return replace(environment, library=library, hosts=HOSTS, transfer_us=20_000)


NEVER_BINDING: Mapping[str, Said] = {
    "`serves: 100` at each output": with_each(lambda t: _with_outputs(t, serves=100)),
    "`max_instances: 1` of each": with_each(lambda t: replace(t, max_instances=1)),
    "an optional input of each": with_each(
        lambda t: replace(t, inputs=(*t.inputs, InputPort("more", "c1_1", optional=True)))
    ),
    "a host": lambda e: replace(e, hosts=HOSTS[:1]),
    "two hosts": lambda e: replace(e, hosts=HOSTS),
    "a host, `minimise: [hosts]`": lambda e: replace(e, hosts=HOSTS[:1], minimise=(Objective.HOSTS,)),
    "a host with rent": lambda e: replace(e, hosts=(replace(HOSTS[0], rent_us=1000),)),
    "two hosts, a price for each stream": _on_hosts,
    "a link with bandwidth": lambda e: replace(_on_hosts(e), links=(Link(("h", "k"), bandwidth=10**6),)),
    "a resource that has room for all": lambda e: replace(
        with_each(lambda t: replace(t, memory_mb=1))(e), hosts=(Host("h", memory_mb=10**6),)
    ),
    "a resource that has room for the plan": lambda e: replace(
        with_each(lambda t: replace(t, memory_mb=1))(e), hosts=(Host("h", memory_mb=100),)
    ),
}


def planned(problem: Problem) -> tuple[Plan, float]:
    """Return a plan and its CPU seconds."""
    began = time.process_time()
    found = PlannerSession(is_asked_once=True).plan(problem, time_limit_s=60)
    return found, time.process_time() - began


def ratio(said: Problem, usual: Problem) -> tuple[float, bool]:
    """Return the ratio of a plan's CPU time to the usual, and whether cost, status and proof are the same."""
    (before, usual_s), (found, took_s) = planned(usual), planned(said)
    rent_us = min((host.rent_us for host in said.environment.hosts), default=0) * said.horizon_s
    as_good = (found.status, found.cost_us, found.ties_proven) == (
        before.status,
        (before.cost_us or 0) + rent_us,
        before.ties_proven,
    )
    return took_s / usual_s, as_good


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[500, 1_000], help="transformations (500, 1000)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--only", default="", help="only rows whose name has this text")
    options = parser.parse_args()
    is_good = True

    def row(name: str, problems: Callable[[Problem], tuple[Problem, Problem]]) -> None:
        nonlocal is_good
        if options.only not in name:
            return
        cells = []
        for size in options.sizes:
            found = [ratio(*problems(random_library(seed, transformations=size, targets=3))) for seed in options.seeds]
            is_good &= all(as_good for _, as_good in found)
            cells.append(f"{median(times for times, _ in found):.2f}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)

    planned(random_library(0, transformations=500))  # so that the solver's import is not measured
    print(f"| word | {' | '.join(f'{size:,}' for size in options.sizes)} |\n|---|{'---|' * len(options.sizes)}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for is_startable, whose in ((False, "of what can't start"), (True, "of what nothing wants")):
            for key, word in WORDS.items():
                if word.beside is not None:
                    row(
                        f"`{key}` {whose}",
                        lambda plain, word=word, is_startable=is_startable: (  # type: ignore[misc]
                            word.where_it_does_nothing(plain, folder, is_startable=is_startable),
                            Word(None).where_it_does_nothing(plain, folder, is_startable=is_startable),
                        ),
                    )
    for key, said in NEVER_BINDING.items():
        row(
            key,
            lambda plain, said=said: (replace(plain, environment=said(plain.environment)), plain),  # type: ignore[misc]
        )
    if not is_good:
        sys.exit("a plan is not as good with a word that does nothing")


if __name__ == "__main__":
    main()
