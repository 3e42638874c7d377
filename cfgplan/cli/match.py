"""`cfgplan match`: the validity matrix, or why two ports do or do not match."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

from cfgplan.canonical import normal
from cfgplan.cli import options as shared
from cfgplan.cli.exits import Exit
from cfgplan.cli.screen import Screen, counted
from cfgplan.cli.suggest import port_named
from cfgplan.errors import InputError, known

if TYPE_CHECKING:
    from cfgplan.domain import Environment, Similarity


MOST_OPEN = 10
"""The most open outputs listed for one input; if more, only their number is shown."""


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example:\n"
        "  cfgplan match models/nao/1-piff-registered.yaml\n"
        "  cfgplan match models/nao/1-piff-registered.yaml 'segmenter(piff)/y'\n"
        "  cfgplan match models/nao/1-piff-registered.yaml 'segmenter(piff)/hull' 'ball_detector(piff)/hull'"
    )
    shared.add_environment(parser)
    parser.add_argument(
        "output",
        nargs="?",
        type=normal,
        help="an output as transformation/port; if no input follows, any port or target (default: all)",
    )
    parser.add_argument(
        "input", nargs="?", type=normal, help="an input as transformation/port, or the label of a target"
    )
    parser.add_argument(
        "--decide", action="store_true", help="let the reasoner decide every open pair of tags, even if that takes long"
    )
    shared.add_matching(parser)
    shared.add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, screen: Screen) -> Exit:
    from cfgplan.api import FEW_PAIRS

    world = shared.load(options, screen)
    if options.input is None:
        one = None if options.output is None else port_named(world.environment, options.output)
        matches = shared.matches(options, screen, world, None if options.decide else FEW_PAIRS)
        _show_matrix(world.environment, matches.similarity, screen, one)
        if matches.similarity.open and not options.decide:
            screen.note(
                f"More than {FEW_PAIRS} pairs of tags are open: `solve` decides those it needs, --decide decides all."
            )
        return Exit.OK
    environment, label = world.environment, f"target {options.input}"
    _check_order(environment, options.output, options.input)
    offered = _tag(environment.outputs, options.output, "output")
    demanded = _tag(environment.demands, label if label in environment.demands else options.input, "input or target")
    from cfgplan import api

    with screen.phase("explain"):
        reasoning = {"reasoner": options.reasoner, "time_limit_s": options.reasoner_timeout}
        explanation = api.explain_match(world, offered, demanded, **reasoning)
        nearest = () if explanation.matches else api.nearest_offers(world, demanded, **reasoning)
    if screen.json:
        document = {"output": options.output, "input": options.input, **asdict(explanation)}
        screen.show_json({**document, "nearest": [asdict(offer) for offer in nearest]})
        return Exit.OK
    lines = list(explanation.lines())
    for offer in nearest:
        names = ", ".join(name for name, tag in world.environment.outputs.items() if tag == offer.offered)
        lines.append(f"  nearest: {names} gives {offer.offered}: {offer.verdict}")
    screen.show("\n".join(lines))
    return Exit.OK


def _show_matrix(environment: Environment, similarity: Similarity, screen: Screen, one: str | None) -> None:
    """Show which outputs may feed all inputs and targets, or one of them; or the inputs that one output may feed."""
    rows, columns = environment.demands, environment.outputs
    if one is not None and one in columns:
        offer = columns[one]
        columns = {one: offer}
        rows = {
            name: tag for name, tag in rows.items() if similarity.holds(offer, tag) or similarity.is_open(offer, tag)
        }
    elif one is not None:
        rows = {one: rows[one]}
    shown = {*columns.values()}, {*rows.values()}
    undecided = [[given, tag] for given, tag in similarity.open_pairs() if given in shown[0] and tag in shown[1]]
    fed_by: dict[str, list[str]] = {}
    by_tag: dict[str, list[str]] = {}
    for output, tag in columns.items():
        by_tag.setdefault(tag, []).append(output)
    for input_, tag in rows.items():
        offers = similarity.offers.get(tag, frozenset())
        fed_by[input_] = sorted(output for offer in offers for output in by_tag.get(offer, ()))
    if screen.json:
        matches = {input_: {"tag": rows[input_], "outputs": outputs} for input_, outputs in fed_by.items()}
        screen.show_json({"inputs": matches, "outputs": columns, "unknown": undecided})
        return
    from cfgplan.cli.styled import Text

    count = sum(len(outputs) for outputs in fed_by.values())
    width = max(map(len, rows), default=0)
    lines = []
    for input_, outputs in fed_by.items():
        line = Text(f"{input_:{width}}", style="bold")
        line.append(f"  {rows[input_]}", style="dim")
        lines.append(line)
        lines += [Text(f"  <- {output}", style="green") for output in outputs]
        unknown = sorted({name for tag in similarity.open.get(rows[input_], ()) for name in by_tag.get(tag, ())})
        lines += [Text(f"  ?? {output}", style="yellow") for output in unknown[:MOST_OPEN]]
        if len(unknown) > MOST_OPEN:
            lines.append(Text(f"  ?? and {len(unknown) - MOST_OPEN} more that are not decided", style="yellow"))
        if not outputs and not unknown:
            lines.append(Text("  nothing", style="red"))
    left = len(undecided)
    open_pairs = f", {counted(left, 'pair')} of tags not decided (??)" if left else ""
    over = f"{counted(len(rows), 'input or target', 'inputs and targets')} x {counted(len(columns), 'output')}"
    pairs = len(rows) * len(columns)
    verb = "matches" if pairs == 1 else "match"
    matching = f"{count:,} of {counted(pairs, 'pair')} {verb}{open_pairs}" if pairs else "there is no pair"
    screen.show(Text("\n").join([*lines, Text(f"{over}: {matching}.", style="bold")]))


def _check_order(environment: Environment, output: str, taker: str) -> None:
    """Raise InputError if an input or target is named first, and the output second."""
    kinds = {output: "an input", f"target {output}": "a target"}
    kind = next((kind for name, kind in kinds.items() if name in environment.demands), None)
    if output not in environment.outputs and taker in environment.outputs and kind is not None:
        raise InputError.of(f"`{output}` is {kind}", mend=f"write the output first: `{taker} {output}`")


def _tag(tags: Mapping[str, str], name: str, what: str) -> str:
    return tags[known(name, tags, what, "`cfgplan match ENV` lists them all")]
