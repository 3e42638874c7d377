"""A matcher that lives on while tags come and go and the ontology changes, so that nothing is worked out twice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from cfgplan.domain import Similarity
from cfgplan.errors import Fault, InputError
from cfgplan.matching.concepts import Concept
from cfgplan.matching.engine import Engine, roles_in
from cfgplan.matching.faults import InconsistentOntologyError, MatchingError, ReasonerTimeoutError
from cfgplan.matching.functional import parse
from cfgplan.matching.ontology import Ontology
from cfgplan.matching.reasoners import reference_named
from cfgplan.matching.registry import TagRegistry
from cfgplan.matching.rows import Rows
from cfgplan.matching.tracing import contradiction
from cfgplan.matching.verdicts import Question, Verdicts


@dataclass(frozen=True)
class Matching:
    """The similarity of tags, what is odd about them, and how many pairs of distinct tags each reasoner answered."""

    similarity: Similarity
    warnings: tuple[str, ...] = ()
    answered_by: Mapping[str, int] = field(default_factory=dict, hash=False)


class Matcher:
    """The similarity of the tags that are registered now.

    Tags are counted: one that was added twice is there until it was removed twice. The fast engine takes changes in
    at once; the reference is asked, when `matching` is called, for what the engine can't certify, and only about pairs
    that it was not asked about before. Raises UnknownNameError for a reasoner that is none of REASONERS.
    """

    def __init__(self, ontology: Ontology, *, reasoner: str = "auto") -> None:
        self._reference, self._classifier = reference_named(reasoner)
        self._uses_engine = reasoner in ("auto", "el")
        self._offered = TagRegistry()
        self._demanded = TagRegistry()
        self._start(ontology)

    def _start(self, ontology: Ontology) -> None:
        self._ontology = ontology
        self._engine: Engine | None = None
        self._rows: Rows | None = None
        self._verdicts = Verdicts(ontology, self._classifier)

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
        new_offers = self._offered.add(offers)
        new_demands = self._demanded.add(demands)
        if self._rows is not None:
            self._rows.add_offers(new_offers)
            for concept in new_demands.values():
                self._rows.add_demand(concept)

    def remove(self, *, offered: Iterable[str] = (), demanded: Iterable[str] = ()) -> None:
        """Take tags back. Raises KeyError for one that is not registered."""
        gone, renamed = self._offered.remove(offered)
        for name, concept in gone.items():
            if self._rows is not None:
                self._rows.remove_offer(name, concept)
            if concept not in renamed.values():
                self._verdicts.forget(concept)
        if self._rows is not None:
            self._rows.add_offers(renamed)
        for concept in self._demanded.remove(demanded)[0].values():
            if self._rows is not None and concept not in self._demanded:
                self._rows.remove_demand(concept)

    def change_ontology(self, ontology: Ontology) -> None:
        """Match by another ontology from now on.

        Where whole individuals come and go that say nothing new of others, such as robots that register, what the
        fast engine knows stays; else it starts over, and so does the reference in any case. Raises InputError with
        every tag that can't be read in the new ontology; nothing is changed then.
        """
        faults: list[Fault] = []
        offered, demanded = self._offered.reread(ontology, faults), self._demanded.reread(ontology, faults)
        if faults:
            raise InputError(faults)
        before, after = self._ontology.axioms, ontology.axioms
        added, removed = ({axiom: parse(axiom) for axiom in sorted(some)} for some in (after - before, before - after))
        stays = offered.names == self._offered.names and demanded.names == self._demanded.names
        engine, rows = self._engine, self._rows
        self._start(ontology)
        self._offered, self._demanded = offered, demanded
        left = frozenset(ontology.individuals.values())
        if stays and engine is not None and engine.take_in(added, removed, left):
            self._engine, self._rows = engine, rows

    def matching(self, *, time_limit_s: float | None = None) -> Matching:
        """The similarity of the tags registered now. Raises InputError for an ontology that can't be reasoned with."""
        rows = self._current_rows()
        wanted = self._for_the_reference(rows)
        warnings = [*self._ontology.warnings]
        try:
            questions = self._verdicts.open_questions(wanted)
            if questions and self._classifier is not None:
                self._verdicts.ask(questions, time_limit_s)
        except ReasonerTimeoutError:
            warnings.append(f"{self._reference} did not answer everything in {time_limit_s:g} s: give it more time")
        except MatchingError as error:
            raise self._input_error(error) from error
        open_questions = self._verdicts.open_questions(wanted)
        similarity = self._similarity(rows, open_questions, warnings)
        asked = sum(map(len, wanted.values()))
        open_pairs = sum(len(question.offered) * len(question.demanded) for question in open_questions)
        answered = {
            "el": len(self._offered.names) * len(self._demanded.names) - asked,
            self._reference: asked - open_pairs,
        }
        return Matching(similarity, tuple(warnings), {name: pairs for name, pairs in answered.items() if pairs})

    def outside(self) -> Mapping[str, str]:
        """The axioms that the fast engine has no words for, with the reason."""
        return self._current_engine().outside

    def _current_engine(self) -> Engine:
        if self._engine is None:
            concepts = [*self._offered.names.values(), *self._demanded.names.values()]
            self._engine = Engine(self._ontology.trees, set().union(*map(roles_in, concepts)))
            if self._engine.is_inconsistent:
                raise self._input_error(self._contradiction())
        return self._engine

    def _current_rows(self) -> Rows | None:
        if self._rows is None and self._uses_engine:
            rows = Rows(self._current_engine())
            rows.add_offers(self._offered.names)
            for concept in self._demanded.names.values():
                rows.add_demand(concept)
            self._rows = rows
        return self._rows

    def _for_the_reference(self, rows: Rows | None) -> dict[Concept, frozenset[Concept]]:
        """The demands that only the reference can decide, for each offer that has such."""
        offers = self._offered.names
        if rows is None:
            demands = frozenset(self._demanded.names.values())
            return dict.fromkeys(offers.values(), demands) if demands else {}
        wanted: dict[Concept, frozenset[Concept]] = {}
        if rows.beyond_words:
            possible = (concept for name, concept in offers.items() if name not in rows.impossible)
            wanted.update(dict.fromkeys(possible, frozenset(rows.beyond_words)))
        if rows.uncertified and self._demanded.names:
            demands = frozenset(self._demanded.names.values())
            wanted.update(dict.fromkeys((offers[name] for name in rows.uncertified), demands))
        return wanted

    def _similarity(self, rows: Rows | None, open_questions: list[Question], warnings: list[str]) -> Similarity:
        never = set(map(self._offered.name_of, self._verdicts.unsatisfiable))
        if rows is not None:
            never |= rows.impossible
        warnings.extend(
            f"nothing can have the offered tag {text!r}: it contradicts the ontology and never matches"
            for text in sorted(self._offered.spelled(frozenset(never)))
        )
        told: dict[Concept, set[str]] = {}
        for concept in self._verdicts.offers:
            for demand in self._verdicts.accepted(concept):
                told.setdefault(demand, set()).add(self._offered.name_of(concept))
        offers: dict[str, frozenset[str]] = {}
        for name, demand in self._demanded.names.items():
            row = rows.row(demand) if rows is not None else frozenset()
            more = told.get(demand)
            full = self._offered.spelled((row.union(more) if more else row).difference(never) if never or more else row)
            for text in self._demanded.texts(name):
                offers[text] = full
        return Similarity(offers, self._open(offers, open_questions, warnings))

    def _open(
        self, offers: Mapping[str, frozenset[str]], open_questions: list[Question], warnings: list[str]
    ) -> dict[str, frozenset[str]]:
        """The rows of pairs that are not decided; a warning says how many there are."""
        rows: dict[str, frozenset[str]] = {}
        for question in open_questions:
            names = frozenset(map(self._offered.name_of, question.offered))
            offered = self._offered.spelled(names)
            for wanted in map(self._demanded.name_of, question.demanded):
                for demanded in self._demanded.texts(wanted):
                    if not offered <= offers[demanded]:
                        rows[demanded] = rows.get(demanded, frozenset()) | offered
        count = sum(len(row - offers[demanded]) for demanded, row in rows.items())
        if count:
            why = ""
            if self._uses_engine and self._classifier is None and self.outside():
                axiom, reason = next(iter(self.outside().items()))
                told = self._ontology.shortened(axiom)
                why = f"; the ontology is outside the fast engine's fragment: {told} ({reason})"
            pairs = "1 pair" if count == 1 else f"{count} pairs"
            warnings.append(f"{pairs} of tags could not be decided and do not match{why}")
        return rows

    def _contradiction(self) -> InconsistentOntologyError:
        steps = "; ".join(contradiction(self._ontology))
        return InconsistentOntologyError(
            f"the ontology contradicts itself, so that everything would match: {steps}",
            "remove one of the axioms that clash",
        )

    def _input_error(self, error: MatchingError) -> InputError:
        file = str(self._ontology.files[0]) if self._ontology.files else None
        return InputError([Fault(self._ontology.shortened(error.message), file=file, mend=error.mend)])
