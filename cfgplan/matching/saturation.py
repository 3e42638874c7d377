"""Consequence-based saturation of an EL ontology: derives the consequences for each kind of thing in its axioms.

A context stands for all things that have some atoms (or for one individual). It collects the atoms that these have and
the links that they have to other contexts. The contexts without ⊥ are a model of the ontology: the canonical one.

Reference: Y. Kazakov, M. Krötzsch, F. Simančík, "The Incredible ELK", J. Automated Reasoning 53 (2014).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from typing import TypeAlias

from cfgplan.matching.rules import BOTTOM_ATOM, TOP_ATOM, Rules

Edge: TypeAlias = "tuple[int, Context]"
DerivedFact: TypeAlias = "tuple[Context, int] | tuple[Context, int, Context]"
"""That a context has an atom, or a link by a role to another context."""
_ContextKey: TypeAlias = "tuple[frozenset[int], frozenset[Edge]]"
Reason: TypeAlias = "tuple[tuple[object, ...], tuple[DerivedFact, ...]]"
"""The rule (a key of `Rules.origin`, if it comes from an axiom) and the facts from which a fact follows."""


class Context:
    """The atoms and links of all things with the atoms `seeds` and the links that the context was made with.

    `exists`: every model has such a thing. `conditional`: if one exists, an individual has atoms that it does not have
    otherwise, so the context may be incomplete; its atoms and links hold all the same.
    """

    __slots__ = ("atoms", "conditional", "exists", "finished", "individual", "links", "preds", "seeds")

    def __init__(self, seeds: frozenset[int], individual: bool = False) -> None:
        self.seeds = seeds
        self.individual = individual
        self.atoms: set[int] = set()
        self.links: defaultdict[int, set[Context]] = defaultdict(set)
        self.preds: defaultdict[int, set[Context]] = defaultdict(set)
        self.exists = False
        self.finished = False
        self.conditional = False

    @property
    def is_unsatisfiable(self) -> bool:
        """Whether no such thing can exist."""
        return BOTTOM_ATOM in self.atoms

    @property
    def edges(self) -> Iterator[Edge]:
        """The links one by one."""
        return ((role, target) for role, targets in self.links.items() for target in targets)


class Saturation:
    """The contexts of an ontology, made and saturated on demand; contexts of individuals are made at once."""

    def __init__(self, rules: Rules, *, reasons: dict[DerivedFact, Reason] | None = None) -> None:
        """Saturate what must exist. `reasons`, if given, gets the first reason found for each fact."""
        self.rules = rules
        self._reasons = reasons
        self._contexts: dict[_ContextKey, Context] = {}
        self._fresh: list[Context] = []
        self._disturbed = False
        self._atoms: list[tuple[Context, int]] = []
        self._links: list[tuple[Context, int, Context]] = []
        self.top = self._context(frozenset((TOP_ATOM,)))
        self._let_exist(self.top)
        for atom in list(rules.individuals):
            self._let_exist(self._context(frozenset((atom,))))
        self._run()

    @property
    def is_inconsistent(self) -> bool:
        """Whether something that must exist can't."""
        return any(context.exists and context.is_unsatisfiable for context in self._contexts.values())

    def context(self, seeds: Collection[int], links: Collection[Edge] = ()) -> Context:
        """The saturated context of the things with these atoms and links."""
        key = frozenset(seeds or (TOP_ATOM,)), frozenset(links)
        known = self._contexts.get(key)
        if known is None:
            individuals = [atom for atom in key[0] if atom in self.rules.individuals]
            if individuals and len(key[0]) + len(key[1]) > 1:
                known = self._contexts[key] = self._more_of_individuals(key, individuals)
            else:
                known = self._context(*key)
                if known.individual:
                    self._let_exist(known)
                self._run()
        return known

    def _more_of_individuals(self, key: _ContextKey, individuals: Iterable[int]) -> Context:
        """The context of things that are these individuals and have further atoms. It is conditional.

        An individual's own context is returned if nothing is added to it.
        """
        own = [self.context((atom,)) for atom in individuals]
        found = self._context(*key)
        for one in own:
            for atom in one.atoms:
                self._add(found, atom, ())
            for role, target in one.edges:
                self._link(found, role, target, ())
        self._run()
        if len(own) == 1 and found.atoms == own[0].atoms and {*found.edges} <= {*own[0].edges}:
            return own[0]
        found.conditional = True
        return found

    def learn(self) -> None:
        """Apply the rules added since the last call to all contexts."""
        if self.rules.new_premises:
            for context in self._contexts.values():
                self._atoms.extend((context, atom) for atom in self.rules.new_premises & context.atoms)
            self.rules.new_premises.clear()
            self._run()

    def let_individuals_come(self, atoms: Iterable[int]) -> bool:
        """Make contexts of new individuals. Returns False if that changes a context that was there before."""
        self._disturbed = False
        for atom in atoms:
            self._let_exist(self._context(frozenset((atom,))))
        self._run()
        return not self._disturbed

    def let_individuals_go(self, atoms: Iterable[int]) -> bool:
        """Whether nothing else depends on these individuals. They stay known, but nothing leads to them."""
        seen: set[Context] = set()
        waiting = [self._context(frozenset((atom,))) for atom in atoms]
        while waiting:
            context = waiting.pop()
            if context in seen:
                continue
            seen.add(context)
            for role, target in context.edges:
                if target.individual and self.rules.ranges[role]:
                    return False
                if not target.individual:
                    waiting.append(target)
        return True

    def _is_conditional_link(self, role: int, target: Context) -> bool:
        """Whether a link, if it exists, tells something new about an individual, or leads to a context that does."""
        return target.conditional or (target.individual and not self.rules.ranges[role] <= target.atoms)

    def _context(self, seeds: frozenset[int], links: frozenset[Edge] = frozenset()) -> Context:
        known = self._contexts.get((seeds, links))
        if known is None:
            individual = len(seeds) == 1 and not links and not seeds.isdisjoint(self.rules.individuals)
            known = self._contexts[seeds, links] = Context(seeds, individual)
            self._fresh.append(known)
            for atom in (TOP_ATOM, *seeds):
                self._add(known, atom, ())
            for role, target in links:
                self._link(known, role, target, ())
        return known

    def _let_exist(self, context: Context) -> None:
        waiting = [context]
        while waiting:
            existing = waiting.pop()
            if existing.exists:
                continue
            existing.exists = True
            for role, targets in existing.links.items():
                for target in targets:
                    waiting.append(target)
                    self._add_ranges(existing, role, target)

    def _add_ranges(self, source: Context, role: int, target: Context) -> None:
        if target.individual:
            for atom in self.rules.ranges[role]:
                self._add(target, atom, ("range", role, atom), (source, role, target))

    def _add(self, context: Context, atom: int, rule: tuple[object, ...], *premises: DerivedFact) -> None:
        if atom not in context.atoms:
            context.atoms.add(atom)
            self._disturbed = self._disturbed or context.finished
            self._atoms.append((context, atom))
            if self._reasons is not None:
                self._reasons.setdefault((context, atom), (rule, premises))

    def _link(
        self, source: Context, role: int, target: Context, rule: tuple[object, ...], *premises: DerivedFact
    ) -> None:
        for upper in self.rules.supers[role]:
            if target not in source.links[upper]:
                self._disturbed = self._disturbed or source.finished
                source.links[upper].add(target)
                target.preds[upper].add(source)
                self._links.append((source, upper, target))
                if self._reasons is not None:
                    own = (rule, premises) if upper == role else (("role", role, upper), ((source, role, target),))
                    self._reasons.setdefault((source, upper, target), own)

    def _run(self) -> None:
        while self._atoms or self._links:
            while self._atoms:
                self._follow_atom(*self._atoms.pop())
            if self._links:
                self._follow_link(*self._links.pop())
        self._finish()

    def _follow_atom(self, context: Context, atom: int) -> None:
        rules = self.rules
        for implied in rules.sub.get(atom, ()):
            self._add(context, implied, ("sub", atom, implied), (context, atom))
        partners = rules.joint.get(atom)
        if partners:
            for partner in partners.keys() & context.atoms:
                for joined in partners[partner]:
                    self._add(context, joined, (), (context, atom), (context, partner))
        for role, fillers in rules.right.get(atom, ()):
            rule = ("right", atom, role, fillers)
            self._link(context, role, self._filler(role, fillers), rule, (context, atom))
        for role, sources in list(context.preds.items()):
            heads: Iterable[int] = rules.left[role].get(atom, ()) if role in rules.left else ()
            for head in (BOTTOM_ATOM,) if atom == BOTTOM_ATOM else heads:
                for source in list(sources):
                    self._add(source, head, (), (source, role, context), (context, atom))

    def _filler(self, role: int, fillers: frozenset[int]) -> Context:
        if any(atom in self.rules.individuals for atom in fillers):
            return self._context(fillers)
        return self._context((fillers | self.rules.ranges[role]) or frozenset((TOP_ATOM,)))

    def _follow_link(self, source: Context, role: int, target: Context) -> None:
        rules = self.rules
        if BOTTOM_ATOM in target.atoms:
            self._add(source, BOTTOM_ATOM, (), (source, role, target), (target, BOTTOM_ATOM))
        heads = rules.left.get(role)
        if heads:
            for atom in heads.keys() & target.atoms:
                for head in heads[atom]:
                    self._add(source, head, (), (source, role, target), (target, atom))
        for second, composed in rules.chains.get(role, ()):
            for end in list(target.links.get(second, ())):
                rule = ("chain", role, second, composed)
                self._link(source, composed, end, rule, (source, role, target), (target, second, end))
        for first, composed in rules.chained.get(role, ()):
            for start in list(source.preds.get(first, ())):
                rule = ("chain", first, role, composed)
                self._link(start, composed, target, rule, (start, first, source), (source, role, target))
        if source.exists:
            self._add_ranges(source, role, target)
            self._let_exist(target)

    def _finish(self) -> None:
        """Mark new contexts as finished, and find those that are conditional."""
        fresh, self._fresh = self._fresh, []
        for context in fresh:
            context.finished = True
        waiting = [
            context
            for context in fresh
            if not context.exists and any(self._is_conditional_link(role, target) for role, target in context.edges)
        ]
        while waiting:
            context = waiting.pop()
            if not context.conditional:
                context.conditional = True
                waiting += [source for sources in context.preds.values() for source in sources if not source.exists]
