"""A generated instance as an environment file with its ontology: `python -m experiments.export NAME --out FOLDER`.

NAME is the instance's name in the tables, such as 'nao(robots=2)#0'. The file is a problem with the same optimum.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from cfgplan.domain import Environment
from cfgplan.errors import CfgplanError, InputError
from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.planning import Problem
from experiments.study.instances import named

ONTOLOGY = "ontology.ttl"
ENVIRONMENT = "environment.yaml"


def export(problem: Problem, folder: Path) -> Path:
    """Write a problem's environment and an ontology that entails its similarity; returns the environment file.

    Offered and demanded tags become separate classes, so that transitivity adds no match. Raises InputError if a pair
    of tags is undecided, which an ontology can't express.
    """
    if problem.similarity.open:
        raise InputError.of("some pairs of tags are open", mend="match the environment with a reasoner first")
    environment = problem.environment
    offered = _classes("Offered", (port.tag for each in environment.library for port in each.outputs))
    demanded = _classes("Demanded", [port.tag for each in environment.library for port in each.inputs])
    demanded |= _classes("Wanted", {each.tag for each in environment.stream_targets} - demanded.keys())
    document = plain_environment(
        _renamed(environment, offered.__getitem__, demanded.__getitem__),
        horizon_s=problem.horizon_s,
        max_cost_us=problem.max_cost_us,
        ontology=[ONTOLOGY],
        survive=problem.survive,
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ONTOLOGY).write_text(_ontology(problem, offered, demanded), encoding="utf-8")
    (folder / ENVIRONMENT).write_text(dump_yaml(document), encoding="utf-8")
    return folder / ENVIRONMENT


def _classes(prefix: str, tags: Iterable[str]) -> dict[str, str]:
    """A class for each tag, named by its number."""
    return {tag: f"{prefix}{number}" for number, tag in enumerate(sorted(set(tags)))}


def _renamed(environment: Environment, offered: Callable[[str], str], demanded: Callable[[str], str]) -> Environment:
    """The environment with other tags."""
    library = tuple(
        replace(
            each,
            inputs=tuple(replace(port, tag=demanded(port.tag)) for port in each.inputs),
            outputs=tuple(replace(port, tag=offered(port.tag)) for port in each.outputs),
        )
        for each in environment.library
    )
    streams = frozenset(environment.stream_targets)
    targets = tuple(replace(t, tag=demanded(t.tag)) if t in streams else t for t in environment.targets)
    return replace(environment, library=library, targets=targets)


def _ontology(problem: Problem, offered: Mapping[str, str], demanded: Mapping[str, str]) -> str:
    """A class for each tag, labelled with it; an offered one is a subclass of every demanded one that it may feed."""
    lines = [
        "@prefix : <urn:cfgplan:instance#> .",
        "@prefix owl: <http://www.w3.org/2002/07/owl#> .",
        "@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .",
        "<urn:cfgplan:instance> a owl:Ontology .",
    ]
    for tag, name in (*demanded.items(), *offered.items()):
        text = tag.replace("\\", "\\\\").replace('"', '\\"')
        lines.append(f':{name} a owl:Class ; rdfs:label "{text}" .')
    for tag, name in demanded.items():
        accepted = problem.similarity.offers.get(tag, frozenset()) & offered.keys()
        lines += [f":{offered[each]} rdfs:subClassOf :{name} ." for each in sorted(accepted)]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", metavar="NAME", help="an instance by its name in the tables")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where the two files go")
    options = parser.parse_args()
    print(export(named(options.name).problem, options.out))


if __name__ == "__main__":
    try:
        main()
    except CfgplanError as error:
        sys.exit(f"error: {error}")
