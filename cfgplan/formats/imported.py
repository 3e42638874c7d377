"""The environment file that an import writes: a draft for a person to complete, with remarks at its top."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from cfgplan.domain import Environment
from cfgplan.formats import fields
from cfgplan.formats.dump import dump_yaml, plain_environment

_COSTS = ("labor", "upkeep")


@dataclass(frozen=True)
class ImportedSources:
    """Sources from `origin` as an environment without targets, with its ontology (Turtle) and the size in words.

    `example` is a target as YAML, `remark` an addition to the request for targets. `notes` name the parts that were
    left out, `hints` are advice.
    """

    origin: str
    size: str
    environment: Environment
    ontology: str
    example: str
    notes: tuple[str, ...]
    hints: tuple[str, ...]
    remark: str = ""

    def text(self, ontology: str) -> str:
        """Return the environment file (YAML), which imports `ontology`; comments at its top list notes and hints."""
        return imported_text(self.environment, ontology, self._heading())

    def _heading(self) -> Iterator[str]:
        yield f"Imported from {self.origin}: {self.size}."
        yield from (f"Not imported: {note}." for note in self.notes)
        yield from (f"Hint: {hint}." for hint in self.hints)
        yield f"Nothing is wanted yet. Say it so{self.remark}:"
        yield "  targets:"
        yield f"    - {self.example}"


def imported_text(environment: Environment, ontology: str, heading: Iterable[str]) -> str:
    """Return the YAML text of an imported environment, whose costs are unknown, with `heading` as comments above.

    `ontology` is the name of its ontology file.
    """
    plain = plain_environment(environment, horizon_s=fields.DEFAULT_HORIZON_S, ontology=[ontology])
    for transformation in plain.get("transformations", ()):
        for cost in _COSTS:
            transformation.pop(cost, None)
    return "".join(f"# {_on_one_line(line)}".rstrip() + "\n" for line in heading) + dump_yaml(plain)


def _on_one_line(text: str) -> str:
    """Return a text with escapes for the characters that a comment can't hold."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
