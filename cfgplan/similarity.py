"""The similarity relation between tags (paper, Definition 5), with the pairs that no reasoner has decided."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field
from functools import cached_property

from cfgplan.arguments import checked
from cfgplan.canonical import fields_of
from cfgplan.frozen import dataclass
from cfgplan.summary import Summary, counted, summarised, summary


def _similarity_summary(similarity: Similarity) -> Summary:
    pairs, still = sum(map(len, similarity.offers.values())), sum(map(len, similarity.open.values()))
    line = f"{counted(pairs, 'pair')} of tags match, {still} open"
    return summary(
        line,
        ("demanded", "offered"),
        ((tag, ", ".join(sorted(offered))) for tag, offered in sorted(similarity.offers.items())),
    )


@summarised(_similarity_summary)
@dataclass(frozen=True)
@checked
class Similarity:
    """The relation ~ between tags (Definition 5): it says which offered tag may feed which demanded tag.

    `offers` maps each demanded tag to the offered tags that it accepts; collected over the ports of a library this is
    the paper's validity matrix. `open` maps a demanded tag to offered tags that no reasoner has decided; an open pair
    does not match, and no claim may depend on it. If a row of `offers` and one of `open` share a tag, it matches.
    """

    offers: Mapping[str, frozenset[str]] = field(hash=False)
    open: Mapping[str, frozenset[str]] = field(default_factory=dict, hash=False)

    __getstate__ = fields_of

    def holds(self, offered: str, demanded: str) -> bool:
        """Whether an output tagged `offered` may feed an input or a target tagged `demanded`."""
        return offered in self.offers.get(demanded, ())

    def is_open(self, offered: str, demanded: str) -> bool:
        """Return whether it is still undecided if `offered` may feed `demanded`."""
        return offered in self.open.get(demanded, ()) and not self.holds(offered, demanded)

    def open_pairs(self) -> Iterator[tuple[str, str]]:
        """The (offered, demanded) pairs that are not decided, sorted by the demanded tag."""
        for demanded, offered in sorted(self.open.items()):
            for each in sorted(offered - self.offers.get(demanded, frozenset())):
                yield each, demanded

    @cached_property
    def decided(self) -> Similarity:
        """The relation in which no open pair matches."""
        return Similarity(self.offers) if self.open else self

    @cached_property
    def optimistic(self) -> Similarity:
        """The relation in which every open pair matches: no plan is cheaper than the optimum under it."""
        if not self.open:
            return self
        rows = {tag: self.offers.get(tag, frozenset()) | more for tag, more in self.open.items()}
        return Similarity({**self.offers, **rows})

    def refined(self, later: Similarity) -> Similarity:
        """The same relation with what a later one has decided of its open pairs."""
        rows = {tag: row for tag, row in self.open.items() if tag in later.offers}
        matching = {tag: self.offers.get(tag, frozenset()) | (row & later.offers[tag]) for tag, row in rows.items()}
        still = {tag: row & later.open.get(tag, frozenset()) for tag, row in rows.items()}
        open_rows = {tag: row for tag, row in {**self.open, **still}.items() if row}
        return Similarity({**self.offers, **matching}, open_rows)
