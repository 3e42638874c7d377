"""Compares the fast engine with HermiT on random ontologies and tags, and writes a table.

    python experiments/matching/crosscheck.py --worlds 400 --tags 80 --large 20 --out experiments/matching/crosscheck.md

HermiT classifies all tags. Its classification is compared with the results of the fast engine, with those of finite
models, and with HermiT's own answers about some pairs that both leave undecided. Two errors are counted: a match that
the classification denies (false positive), and a match of the classification that is denied (certified miss). Both
counts must be zero.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from realistic import realistic_world
from small_worlds import World, small_world

from cfgplan.errors import InputError
from cfgplan.matching import Matcher, Matching, match

QUESTIONS_A_ROW = 3
"""So many open pairs of a demanded tag are asked about: few enough that they are not classified."""
PATIENCE_S = 30.0
"""How long HermiT may take over one world."""
MOST_TAGS_FAR = 40
"""So many tags has a world far outside the fragment at most: more are often too hard for HermiT."""


def compare(world: World) -> Counter[str]:
    """Count the pairs of one world by the answers of the fast engine, finite models and HermiT."""
    found: Counter[str] = Counter(worlds=1)
    try:
        fast = match(world.offered, world.demanded, world.ontology, reasoner="el")
    except InputError:
        fast = None
    try:
        reference = match(world.offered, world.demanded, world.ontology, reasoner="hermit", time_limit_s=PATIENCE_S)
    except InputError as error:
        if "contradicts" not in str(error):
            found["refused by HermiT"] += 1
        elif fast is None:
            found["inconsistent, both agree"] += 1
        else:
            found["inconsistent, found by HermiT only"] += 1
            undecided = len(world.offered) * len(world.demanded)
            found["certified misses"] += len([*fast.similarity.open_pairs()]) < undecided and not fast.warnings
        return found
    if fast is None:
        found["false positives"] += 1
        return found
    if reference.similarity.open:
        found["too hard for HermiT"] += 1
        return found
    _count_errors(found, world, fast, reference)
    asked, found["asked one by one"] = _questioned(world)
    _count_errors(found, world, asked, reference)
    impossible = reference.impossible
    for demanded in world.demanded:
        found["pairs"] += len(world.offered)
        found["matches"] += len(reference.similarity.offers[demanded])
        found["pairs of impossible tags"] += len(impossible)
        found["not certified"] += len(fast.similarity.open.get(demanded, frozenset()) - impossible)
    return found


def _questioned(world: World) -> tuple[Matching, int]:
    """Return the matching after HermiT was asked about some open pairs of each demanded tag, and the number
    of these.
    """
    matcher = Matcher(world.ontology)
    matcher.add(offered=world.offered, demanded=world.demanded)
    open_rows = matcher.matching(decide=False).similarity.open
    pairs = [
        (offered, demanded)
        for demanded, row in sorted(open_rows.items())
        for offered in islice(sorted(row), QUESTIONS_A_ROW)
    ]
    asked = matcher.decide(pairs, time_limit_s=PATIENCE_S)
    return matcher.matching(decide=False), asked


def _count_errors(found: Counter[str], world: World, told: Matching, reference: Matching) -> None:
    impossible, impossible_too = reference.impossible, told.impossible
    found["false positives"] += len(impossible_too - impossible)
    for demanded in world.demanded:
        true = reference.similarity.offers[demanded]
        for offered in world.offered:
            said = told.similarity.holds(offered, demanded)
            if offered in impossible:
                is_missed = offered not in impossible_too and not said
            else:
                is_missed = offered in true and not said
                found["false positives"] += said and offered not in true
            found["certified misses"] += is_missed and not told.similarity.is_open(offered, demanded)


def main() -> int:
    """Run the comparison and print or write its table. Returns 1 if an error was found, otherwise 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=200)
    parser.add_argument("--tags", type=int, default=60)
    parser.add_argument("--large", type=int, default=0, help="how many large worlds")
    parser.add_argument("--large-tags", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first world")
    parser.add_argument("--seconds", type=float, default=None, help="stop after so long")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    kinds: dict[str, Callable[[int], World]] = {
        "small, inside the fragment": lambda seed: small_world(seed, options.tags),
        "small, some axioms outside": lambda seed: small_world(seed, options.tags, outside=0.15),
        "small, far outside": lambda seed: small_world(seed, min(options.tags, MOST_TAGS_FAR), outside=0.6, far=True),
    }
    large = {"large and realistic": lambda seed: realistic_world(options.large_tags, seed)}
    totals = {kind: Counter[str]() for kind in [*kinds, *large]}
    started = time.monotonic()
    for number in range(max(options.worlds, options.large)):
        seed = options.first + number
        chosen = (kinds if number < options.worlds else {}) | (large if number < options.large else {})
        for kind, make in chosen.items():
            found = compare(make(seed))
            totals[kind] += found
            if found["false positives"] or found["certified misses"]:
                print(f"seed {seed}, {kind}: {dict(found)}", file=sys.stderr)
        if options.out is not None:
            options.out.write_text(table(totals))
        if options.seconds is not None and time.monotonic() - started > options.seconds:
            break
    print(table(totals))
    return int(any(total["false positives"] or total["certified misses"] for total in totals.values()))


def table(totals: dict[str, Counter[str]]) -> str:
    """Return the counts as a Markdown table."""
    rows = [
        "worlds",
        "inconsistent, both agree",
        "inconsistent, found by HermiT only",
        "refused by HermiT",
        "too hard for HermiT",
    ]
    rows += [
        "pairs",
        "matches",
        "pairs of impossible tags",
        "not certified",
        "asked one by one",
        "false positives",
        "certified misses",
    ]
    lines = ["| | " + " | ".join(totals) + " |", "|---|" + "---:|" * len(totals)]
    lines += [f"| {row} | " + " | ".join(f"{total[row]:,}" for total in totals.values()) + " |" for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
