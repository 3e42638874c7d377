"""Compares the fast engine with HermiT on random ontologies and tags, and writes a table of the result.

    python experiments/matching/crosscheck.py --worlds 400 --tags 80 --large 20 --out experiments/matching/crosscheck.md

Two errors are looked for: a match that HermiT denies (false positive), and a match of HermiT's that the engine
denies although it certified the row (certified miss). Both must be zero.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from realistic import realistic_world
from small_worlds import World, small_world

from cfgplan.errors import InputError
from cfgplan.matching import match

PATIENCE_S = 30.0
"""How long HermiT may take over one world."""


def compare(world: World) -> Counter[str]:
    """Count the pairs of one world by what the fast engine and HermiT say."""
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
    impossible = {warning.split("'")[1] for warning in reference.warnings if warning.startswith("nothing")}
    impossible_fast = {warning.split("'")[1] for warning in fast.warnings if warning.startswith("nothing")}
    found["false positives"] += len(impossible_fast - impossible)
    for demanded in world.demanded:
        true = reference.similarity.offers[demanded]
        for offered in world.offered:
            found["pairs"] += 1
            said, is_true = fast.similarity.holds(offered, demanded), offered in true
            found["matches"] += is_true
            if offered in impossible:
                found["pairs of impossible tags"] += 1
                if offered not in impossible_fast and not fast.similarity.is_open(offered, demanded) and not said:
                    found["certified misses"] += 1
            elif said and not is_true:
                found["false positives"] += 1
            elif fast.similarity.is_open(offered, demanded):
                found["not certified"] += 1
            elif is_true and not said:
                found["certified misses"] += 1
    return found


def main() -> int:
    """Run the comparison and print or write its table; 1 if an error was found."""
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
    """The counts as a Markdown table."""
    rows = [
        "worlds",
        "inconsistent, both agree",
        "inconsistent, found by HermiT only",
        "refused by HermiT",
        "too hard for HermiT",
    ]
    rows += ["pairs", "matches", "pairs of impossible tags", "not certified", "false positives", "certified misses"]
    lines = ["| | " + " | ".join(totals) + " |", "|---|" + "---:|" * len(totals)]
    lines += [f"| {row} | " + " | ".join(f"{total[row]:,}" for total in totals.values()) + " |" for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
