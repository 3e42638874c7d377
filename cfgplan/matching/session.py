"""A matcher that is kept while tags and the ontology change, so that nothing is computed twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Final

from cfgplan.domain import Similarity
from cfgplan.errors import Fault, InputError, MatchingError, TagError
from cfgplan.matching.answer import Matching, impossible
from cfgplan.matching.concepts import TOP, Concept
from cfgplan.matching.countermodels import Countermodels
from cfgplan.matching.derivations import contradiction
from cfgplan.matching.engine import FastEngine, MatchedRows, roles_in
from cfgplan.matching.faults import InconsistentOntologyError
from cfgplan.matching.functional import parse
from cfgplan.matching.justifications import clash
from cfgplan.matching.losses import Losses
from cfgplan.matching.modules import Module, Modules, individuals_in, names_in
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reference import reference_named
from cfgplan.matching.syntax import parse_tag
from cfgplan.matching.verdicts import AskedPair, Verdicts, countdown
from cfgplan.planning import Pair


class TagRegistry:
    """The texts of tags by their concept, and how often each text was added."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._concepts: dict[str, Concept] = {}
        self._texts: dict[Concept, dict[str, None]] = {}

    @property
    def concepts(self) -> Mapping[str, Concept]:
        """The concept of each text."""
        return self._concepts

    @property
    def texts(self) -> Mapping[Concept, Iterable[str]]:
        """The texts that mean each concept, in the order in which they were added."""
        return self._texts

    def spelled(self, concepts: Iterable[Concept]) -> frozenset[str]:
        """All texts that mean one of some registered concepts."""
        return frozenset(text for concept in concepts for text in self._texts[concept])

    def read(self, texts: Iterable[str], ontology: Ontology, faults: list[Fault]) -> list[tuple[str, Concept]]:
        """Texts with their meaning; `faults` gets those that can't be read."""
        read: list[tuple[str, Concept]] = []
        for text in texts:
            try:
                read.append((text, self._concepts.get(text) or parse_tag(text, ontology)))
            except TagError as error:
                faults.append(Fault(f"tag {text!r}, column {error.column}: {error.message}", mend=error.mend))
        return read

    def reread(self, ontology: Ontology, faults: list[Fault]) -> TagRegistry:
        """The same tags as they read in another ontology; `faults` gets those that can't be read in it."""
        again = TagRegistry()
        again.add(again.read(self._counts, ontology, faults))
        again._counts = self._counts.copy()
        return again

    def add(self, read: Iterable[tuple[str, Concept]]) -> None:
        """Register texts."""
        for text, concept in read:
            self._counts[text] += 1
            self._concepts[text] = concept
            self._texts.setdefault(concept, {})[text] = None

    def remove(self, texts: Iterable[str]) -> None:
        """Take texts back. Raises KeyError for a text that is not registered; nothing is taken back then."""
        taken = Counter(texts)
        for text, times in taken.items():
            if self._counts[text] < times:
                raise KeyError(text)
        self._counts -= taken
        for text in taken.keys() - self._counts.keys():
            concept = self._concepts.pop(text)
            del self._texts[concept][text]
            if not self._texts[concept]:
                del self._texts[concept]


_FEW_PAIRS: Final = 8
"""The most undecided pairs examined for the reason why they are undecided."""
_FEW_LOSSES: Final = 3
"""The most dropped statements named in one warning."""
REFUTING: Final = 0.25
"""The share of a time limit that models may take, in CPU time, before the reference is asked."""


class Matcher:
    """The similarity of the tags that are registered now.

    Tags are counted: a tag added twice stays until it is removed twice. The fast engine takes in changes at once. The
    reference is asked about pairs that the engine leaves open: `matching` asks about all of them, `decide` about the
    given ones, after which `matching(decide=False)` has the answers. No pair is asked about twice. An unsatisfiable
    offered tag matches nothing once that is known: after `matching` if time suffices, and after `decide` for the tags
    that it asked about. Until then it matches what the fast engine finds. The fast engine gets the module of the
    ontology for all registered tags, the reference the module for the tags in question. Raises UnknownNameError for a
    reasoner that is not in REASONERS.
    """

    def __init__(self, ontology: Ontology, *, reasoner: str = "auto") -> None:
        self._name, self._reference = reference_named(reasoner)
        self._uses_engine = reasoner in ("auto", "el")
        self._offered = TagRegistry()
        self._demanded = TagRegistry()
        self._asked = 0
        self._start(ontology)

    def _start(self, ontology: Ontology) -> None:
        self._ontology = ontology
        self._engine: FastEngine | None = None
        self._rows: MatchedRows | None = None
        self._modules: Modules | None = None
        self._known: Module | None = None
        self._parts: Modules | None = None
        self._verdicts = Verdicts(self._part, self._reference)
        self._countermodels: Countermodels | None = None
        self._losses = Losses(ontology, self._modules_of_all)

    @property
    def ontology(self) -> Ontology:
        """The ontology by which tags are matched; `change_ontology` sets another."""
        return self._ontology

    def add(self, *, offered: Iterable[str] = (), demanded: Iterable[str] = ()) -> None:
        """Register tags. Raises InputError with every tag that can't be read; nothing is registered then."""
        faults: list[Fault] = []
        offers = self._offered.read(offered, self._ontology, faults)
        demands = self._demanded.read(demanded, self._ontology, faults)
        if faults:
            raise InputError(faults)
        self._offered.add(offers)
        self._demanded.add(demands)
        self._rows = None

    def remove(self, *, offered: Iterable[str] = (), demanded: Iterable[str] = ()) -> None:
        """Take tags back. Raises KeyError for one that is not registered."""
        self._offered.remove(offered)
        self._demanded.remove(demanded)
        self._rows = None

    def change_ontology(self, ontology: Ontology) -> None:
        """Match by another ontology from now on.

        The fast engine keeps its derivations if the change only adds or removes individuals that say nothing new about
        others, such as robots that register; otherwise it starts over. The reference always starts over. Raises
        InputError with every tag that can't be read in the new ontology; nothing is changed then.
        """
        faults: list[Fault] = []
        offered, demanded = self._offered.reread(ontology, faults), self._demanded.reread(ontology, faults)
        if faults:
            raise InputError(faults)
        before, after = self._ontology.axioms, ontology.axioms
        added, removed = ({axiom: parse(axiom) for axiom in sorted(some)} for some in (after - before, before - after))
        stays = offered.concepts == self._offered.concepts and demanded.concepts == self._demanded.concepts
        engine, module = self._engine, self._known
        self._start(ontology)
        self._offered, self._demanded = offered, demanded
        if not stays or engine is None or module is None:
            return
        known = module.after(added, removed, ontology)
        left = frozenset(ontology.individuals.values())
        gone = {axiom: tree for axiom, tree in removed.items() if axiom in module.ontology.axioms}
        if known is not None and engine.take_in(added, gone, left):
            self._engine, self._known = engine, known

    def matching(self, *, time_limit_s: float | None = None, decide: bool = True) -> Matching:
        """The similarity of the tags registered now; pairs that are not decided are in its `open`.

        With `decide` the reference is asked about all open pairs, until the time limit; without it nothing is asked.
        Raises InputError for an ontology that can't be reasoned with.
        """
        rows = self._current_rows()
        left_s = countdown(time_limit_s)
        self._refute(rows, time_limit_s)
        if decide:
            self._ask(self._in_order(rows), left_s(), self._doubtful(rows))
            self._check(rows, left_s())
        return self._told(rows, time_limit_s, is_asked=decide)

    def decide(self, pairs: Sequence[Pair], *, time_limit_s: float | None = None) -> int:
        """Ask the reference about (offered, demanded) texts of registered tags in this order, until the time limit.

        Returns the number of distinct pairs asked about; pairs that are decided or were asked about before do not
        count. Pairs not reached in time stay open. Raises KeyError for a text that is not registered, and InputError
        for an ontology that can't be reasoned with.
        """
        rows = self._current_rows()
        left_s = countdown(time_limit_s)
        self._refute(rows, time_limit_s)
        open_rows = {demand: row - self._refuted(demand) for demand, row in self._open(rows).items()}
        asked = ((self._offered.concepts[offered], self._demanded.concepts[demanded]) for offered, demanded in pairs)
        return self._ask([pair for pair in asked if pair[0] in open_rows.get(pair[1], ())], left_s())

    def outside(self) -> Mapping[str, str]:
        """The axioms that the fast engine does not support, with the reason."""
        return self._current_engine().outside

    def _module(self) -> Module:
        """Return the module of the registered tags. If it has changed, start the engine and the models over."""
        names = names_in((*self._offered.texts, *self._demanded.texts))
        before = self._known
        if before is None or not names <= before.names:
            self._known = self._modules_of_all().of(names)
            self._parts = None
            if before is None or before.ontology != self._known.ontology:
                self._engine = self._countermodels = None
        assert self._known is not None
        return self._known

    def _modules_of_all(self) -> Modules:
        self._modules = self._modules or Modules(self._ontology)
        return self._modules

    def _part(self, concepts: Iterable[Concept]) -> Ontology:
        """Return the module of some of the registered tags."""
        module, names = self._module(), names_in(concepts)
        if not names <= module.names:
            return self._modules_of_all().of(names).ontology
        self._parts = self._parts or Modules(module.ontology)
        return self._parts.of(names).ontology

    def _current_engine(self) -> FastEngine:
        module = self._module()
        if self._engine is None or self._engine.is_too_large(len(self._offered.texts) + len(self._demanded.texts)):
            roles = set().union(*map(roles_in, (*self._offered.texts, *self._demanded.texts)))
            engine = FastEngine(module.ontology.trees, roles, self._losses.of(module))
            if engine.is_inconsistent:
                raise self._input_error(InconsistentOntologyError("the fast engine finds a contradiction"))
            self._engine = engine
        return self._engine

    def _current_rows(self) -> MatchedRows | None:
        if self._rows is None and self._uses_engine:
            self._rows = self._current_engine().rows(self._offered.texts, self._demanded.texts)
        return self._rows

    def _in_order(self, rows: MatchedRows | None) -> Iterable[AskedPair]:
        """The open pairs that an answer may close, in the order in which tags were registered."""
        rank = {concept: number for number, concept in enumerate(self._offered.texts)}
        return (
            (offered, demand)
            for demand, row in self._open(rows).items()
            for offered in sorted(row - self._refuted(demand), key=rank.__getitem__)
        )

    def _ask(
        self, pairs: Iterable[AskedPair], time_limit_s: float | None, doubtful: Collection[Concept] = frozenset()
    ) -> int:
        try:
            asked = self._verdicts.ask(pairs, time_limit_s, doubtful)
        except MatchingError as error:
            raise self._input_error(error) from error
        self._asked += asked
        return asked

    def _doubtful(self, rows: MatchedRows | None) -> Collection[Concept]:
        """The offers that the fast engine does not certify to be satisfiable."""
        return self._offered.texts.keys() if rows is None else rows.uncertified

    def _check(self, rows: MatchedRows | None, time_limit_s: float | None) -> None:
        """Have the reference look for contradictions in offers and in the ontology where that was not done yet."""
        doubtful = {*self._doubtful(rows), *([TOP] if rows is None or self.outside() else [])}
        try:
            self._verdicts.check(doubtful, time_limit_s)
        except MatchingError as error:
            raise self._input_error(error) from error

    def _beyond_engine(self, rows: MatchedRows | None) -> Iterable[tuple[Concept, frozenset[Concept]]]:
        """For each demand the offers that the fast engine neither finds to meet it nor certifies not to."""
        offers = frozenset(self._offered.texts)
        for demand in self._demanded.texts:
            if rows is None:
                yield demand, offers
            elif demand in rows.beyond_words:
                yield demand, offers - rows.impossible
            elif rows.uncertified:
                yield demand, rows.uncertified.difference(rows.met[demand])

    def _refute(self, rows: MatchedRows | None, time_limit_s: float | None) -> None:
        """Look for models that show what does not match, for offers that the fast engine does not certify."""
        if rows is None or not (rows.beyond_words or rows.uncertified):
            return
        individuals = individuals_in((*self._offered.texts, *self._demanded.texts))
        if self._countermodels is None or not individuals <= self._countermodels.individuals:
            self._countermodels = Countermodels(self._module().ontology, individuals)
        beyond = dict(self._beyond_engine(rows))
        share_s = None if time_limit_s is None else REFUTING * time_limit_s
        self._countermodels.build(set().union(*beyond.values()), beyond, share_s)
        self._verdicts.possible |= self._countermodels.possible

    def _open(self, rows: MatchedRows | None) -> dict[Concept, frozenset[Concept]]:
        """For each demand the offers for which it is not decided whether they meet it."""
        verdicts = self._verdicts
        found = {
            demand: offers
            - verdicts.accepted(demand)
            - verdicts.unsatisfiable
            - self._for_certain(demand, verdicts.denied(demand) | self._refuted(demand))
            for demand, offers in self._beyond_engine(rows)
        }
        return {demand: offers for demand, offers in found.items() if offers}

    def _refuted(self, demand: Concept) -> frozenset[Concept]:
        return frozenset() if self._countermodels is None else self._countermodels.refuted(demand)

    def _for_certain(self, demand: Concept, denied: frozenset[Concept]) -> frozenset[Concept]:
        """Return the denied offers that would not match either if the dropped statements of the ontology held."""
        return denied - self._losses.concerned(denied, demand)

    def _told(self, rows: MatchedRows | None, time_limit_s: float | None, *, is_asked: bool) -> Matching:
        warnings = [*self._ontology.warnings]
        never = self._verdicts.unsatisfiable & self._offered.texts.keys()
        if rows is not None:
            never |= rows.impossible
        impossible_tags = self._offered.spelled(never)
        warnings.extend(map(impossible, sorted(impossible_tags)))
        offers: dict[str, frozenset[str]] = {}
        undecided: dict[str, frozenset[str]] = {}
        open_rows = self._open(rows)
        for demand, texts in self._demanded.texts.items():
            found = {*self._verdicts.accepted(demand)} & self._offered.texts.keys()
            found |= set() if rows is None else rows.met[demand]
            row, left = self._offered.spelled(found - never), self._offered.spelled(open_rows.get(demand, ()))
            offers |= dict.fromkeys(texts, row)
            undecided |= dict.fromkeys(texts if left else (), left)
        similarity = Similarity(offers, undecided)
        if is_asked or self._reference is None:
            warnings.extend(self._about_open(undecided, time_limit_s))
        return Matching(similarity, tuple(warnings), self._answered_by(rows, open_rows), self._asked, impossible_tags)

    def _about_open(self, undecided: Mapping[str, frozenset[str]], time_limit_s: float | None) -> Iterable[str]:
        """The warning about pairs that are not decided."""
        count = sum(map(len, undecided.values()))
        if not count:
            return
        if time_limit_s is not None and self._reference is not None and not self._ontology.dropped:
            yield f"{self._name} did not answer everything in {time_limit_s:g} s: give it more time"
        why = ""
        if self._reference is None and self.outside():
            axiom, reason = next(iter(self.outside().items()))
            told = self._ontology.shortened(axiom)
            why = f"; the ontology is outside the fast engine's fragment: {told} ({reason})"
        for text, reason in self._in_the_way(undecided).items():
            why += f"; {self._ontology.shortened(text)} may make them match ({self._ontology.shortened(reason)})"
        pairs = "1 pair" if count == 1 else f"{count} pairs"
        yield f"{pairs} of tags could not be decided and do not match{why}"

    def _in_the_way(self, undecided: Mapping[str, frozenset[str]]) -> Mapping[str, str]:
        """Return some of the losses that may make undecided pairs match, with the reason of each."""
        if not self._ontology.dropped:
            return {}
        offered, demanded = self._offered.concepts, self._demanded.concepts
        pairs = (
            (offered[text], demanded[demand]) for demand in sorted(undecided) for text in sorted(undecided[demand])
        )
        found: dict[str, str] = {}
        for pair in islice(pairs, _FEW_PAIRS):
            found |= self._losses.about(pair)
        return dict(islice(sorted(found.items()), _FEW_LOSSES))

    def _answered_by(self, rows: MatchedRows | None, open_rows: Mapping[Concept, frozenset[Concept]]) -> dict[str, int]:
        """How many pairs of distinct tags each reasoner decided."""
        pairs = len(self._offered.texts) * len(self._demanded.texts)
        beyond = {demand: offers for demand, offers in self._beyond_engine(rows) if offers}
        counts = Counter({"el": pairs - sum(map(len, beyond.values()))})
        for demand, offers in beyond.items():
            refuted = len(self._for_certain(demand, offers & self._refuted(demand)))
            counts["countermodel"] += refuted
            counts[self._name] += len(offers) - refuted - len(open_rows.get(demand, ()))
        return {name: count for name, count in counts.items() if count}

    def _contradiction(self) -> InconsistentOntologyError:
        """Return the error that names the clashing axioms, found by the fast engine or else by the reference."""
        steps = contradiction(self._ontology)
        if not steps and self._reference is not None:
            steps = clash(self._ontology, self._reference)
        told = f": {'; '.join(steps)}" if steps else ""
        return InconsistentOntologyError(
            f"the ontology contradicts itself, so that everything would match{told}",
            "remove one of the axioms that clash",
        )

    def _input_error(self, error: MatchingError) -> InputError:
        if isinstance(error, InconsistentOntologyError):
            error = self._contradiction()
        here, files = Path.cwd(), self._ontology.files
        file = str(files[0].relative_to(here) if files[0].is_relative_to(here) else files[0]) if files else None
        return InputError([Fault(self._ontology.shortened(error.message), file=file, mend=error.mend)])
