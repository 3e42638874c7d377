"""The loading time of environment files, in total and for each step.

    python experiments/formats/load_speed.py [--transformations 50000]

Each step's time is also given as a multiple of the time that libyaml needs to parse the same text
into bare events, so that figures of different machines can be compared.
"""

from __future__ import annotations

import argparse
import gc
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import yaml

from cfgplan.formats.assembly import build
from cfgplan.formats.document import read_document
from cfgplan.formats.fields import EnvironmentPart
from cfgplan.formats.json_text import read_json
from cfgplan.formats.xml_dump import dump_xml
from cfgplan.formats.yaml_text import read_yaml

T = TypeVar("T")


class FreeNames:
    """Stands for an ontology: no class has individuals, and every tag is accepted."""

    def instances(self, _class_name: str) -> tuple[str, ...]:
        return ()

    def check_tag(self, _text: str) -> None:
        return None


def environment(count: int) -> dict[str, object]:
    """Return a plain environment: `count` transformations with three ports each, a chain of units, targets."""
    transformations = [
        {
            "label": f"transformation{number}",
            "source": "units.py:Transformation",
            "labor": 0.25,
            "upkeep": 0.02,
            "params": {"threshold": 3},
            "inputs": {"left": f"C{number} and hasSource some D", "right": f"C{number + 1}"},
            "outputs": {"out": f"C{number + 2}"},
        }
        for number in range(count)
    ]
    units = [
        {
            "id": f"unit{number}",
            "transformation": f"transformation{number}",
            "inputs": {"left": f"unit{number - 1}/out" if number else None},
            "topics": {"out": [f"/topic{number}"]},
        }
        for number in range(count // 100)
    ]
    targets = [
        {"label": f"target{number}", "topic": f"/topic{number}", "tag": f"C{number}"} for number in range(count // 100)
    ]
    return {
        "format": "cfgplan/1",
        "horizon": 600,
        "transformations": transformations,
        "units": units,
        "targets": targets,
    }


def timed(what: str, step: Callable[[], T], unit_s: float | None = None) -> tuple[T, float]:
    """Run a step and print its time, as a multiple of `unit_s` too."""
    gc.collect()
    begin = time.perf_counter()
    result = step()
    took = time.perf_counter() - begin
    print(f"{what:<44} {took:7.2f} s" + (f" {took / unit_s:6.1f} x" if unit_s else ""))
    return result, took


def bare_events(text: str) -> int:
    """Return the number of parser events in a YAML text."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
    return sum(1 for _ in iter(loader.get_event, None))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--transformations", type=int, default=50_000)
    data = environment(parser.parse_args().transformations)
    with tempfile.TemporaryDirectory() as folder:
        as_yaml, as_json, as_xml = (Path(folder) / f"env.{suffix}" for suffix in ("yaml", "json", "xml"))
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
        as_yaml.write_text(yaml.dump(data, Dumper=dumper, sort_keys=False, width=1000))
        as_json.write_text(json.dumps(data))
        text = as_yaml.read_text()
        print(f"{len(text) / 1e6:.1f} MB of YAML")
        _, unit_s = timed("bare libyaml events", lambda: bare_events(text))
        source, _ = timed("own construction from events", lambda: read_yaml(text, "env.yaml"), unit_s)
        timed("parts of plain data", lambda: EnvironmentPart.reader()(source.data), unit_s)
        document, _ = timed("read_document, YAML", lambda: read_document(as_yaml), unit_s)
        timed("build", lambda: build(document, FreeNames()), unit_s)
        timed("all, YAML", lambda: build(read_document(as_yaml), FreeNames()), unit_s)
        timed("all, JSON", lambda: build(read_document(as_json), FreeNames()), unit_s)
        as_xml.write_text(dump_xml(data))
        timed("all, XML", lambda: build(read_document(as_xml), FreeNames()), unit_s)
        timed("bare JSON construction", lambda: read_json(as_json.read_text(), "env.json"), unit_s)
        world = build(document, FreeNames())
        timed("digest", lambda: world.digest, unit_s)
        timed("PyYAML's own safe_load, for comparison", lambda: yaml.load(text, loader), unit_s)
        timed("place of one part", lambda: world.place(transformation="transformation7"), unit_s)


if __name__ == "__main__":
    main()
