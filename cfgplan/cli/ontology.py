"""`cfgplan ontology`: write a first ontology, from the names that an environment's tags use."""

from __future__ import annotations

import argparse
import shlex

from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen
from cfgplan.errors import InputError


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan ontology new env.yaml --out env.ttl\n"
        "then write `ontology: env.ttl` into the environment, and add subclass axioms to env.ttl."
    )
    parser.add_argument("what", choices=("new",), help="new: write a taxonomy of the names in ENV's tags")
    shared.add_environment(parser)
    shared.add_out(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan.matching.taxonomy import taxonomy

    world = shared.load(options, screen)
    if not world.ontology.is_open:
        mend = f"edit that file; `cfgplan suggest {shlex.quote(options.env)}` proposes tags in its words"
        raise InputError.of("this environment names an ontology already", file=options.env, mend=mend)
    tags = {*world.environment.outputs.values(), *world.environment.demands.values()}
    text, left_out = taxonomy(sorted(tags))
    shared.put(text, options.out, screen)
    if left_out:
        screen.warn(f"not written: {', '.join(left_out)}; an IRI can't end in these names, so rename them in the tags")
    return Exit.OK
