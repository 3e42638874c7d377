"""Properties that only name the inverse of another and can be replaced by it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping

from cfgplan.matching.expressions import BUILT_IN_ROLE, OutsideError
from cfgplan.matching.functional import Tree


def replaceable_inverses(trees: Collection[Tree], roles_of_tags: Collection[str]) -> dict[str, str]:
    """Roles that only name the inverse of another: declared, with domain, range and assertions, nothing else."""
    uses: Counter[str] = Counter()
    pairs: list[tuple[str, str]] = []
    for tree in trees:
        keyword = tree[0]
        if keyword == "InverseObjectProperties" and isinstance(tree[1], str) and isinstance(tree[2], str):
            pairs.append((tree[1], tree[2]))
            uses.update((tree[1], tree[2]))
        elif keyword in ("ObjectPropertyDomain", "ObjectPropertyRange"):
            uses.update(_words(tree[2:]))
        elif keyword == "ObjectPropertyAssertion":
            uses.update(() if isinstance(tree[1], str) else (str(tree[1][1]), str(tree[1][1])))
        elif keyword != "Declaration":
            uses.update(_words(tree[1:]))
    replaced: dict[str, str] = {}
    for pair in pairs:
        for role, other in sorted((pair, pair[::-1]), key=lambda turn: (turn[0] in roles_of_tags, turn)):
            if uses[role] == 1 and role != other and other not in replaced and not role.startswith(BUILT_IN_ROLE):
                replaced[role] = other
                break
    return replaced


def _words(trees: Collection[Tree]) -> Iterator[str]:
    for tree in trees:
        if isinstance(tree, str):
            yield tree
        else:
            yield from _words(tree)


def without_inverses(tree: Tree, inverses: Mapping[str, str]) -> Tree:
    """An axiom with the properties that inverses replace. Raises OutsideError for inverses that stay."""
    assert not isinstance(tree, str), "an axiom is a keyword with arguments"
    keyword, rest = tree[0], tree[1:]
    if keyword == "InverseObjectProperties":
        if rest[0] in inverses or rest[1] in inverses:
            return tree
        raise OutsideError("inverse properties that are both in use are outside the fast fragment")
    role = inverses.get(str(rest[0])) if rest and isinstance(rest[0], str) else None
    if role is None:
        return tree
    match keyword:
        case "ObjectPropertyDomain":
            return ("ObjectPropertyRange", role, *rest[1:])
        case "ObjectPropertyRange":
            return ("ObjectPropertyDomain", role, *rest[1:])
        case "ObjectPropertyAssertion":
            return (keyword, role, rest[2], rest[1])
    return tree
