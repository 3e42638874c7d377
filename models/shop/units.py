"""The units of the shop, as `transformations.yaml` names them: visitors ask how many of an article are left."""

from __future__ import annotations

import time
import uuid
from collections import Counter
from collections.abc import Iterator
from itertools import count
from typing import Any

ARTICLES = 7
_ROLL_CALL = 8
"""Of so many requests, one goes to all backends: the balancer knows those that answer."""

Message = dict[str, Any]


def entrance() -> Iterator[Message]:
    """Gives the requests of visitors. Numbers rise, also when another entrance takes over."""
    first = time.time_ns() // 10_000_000
    for number in count(first):
        yield {"number": number, "article": number % ARTICLES}


class Balancer:
    """Gives each request to one of the backends in turn, and to visitors what these answer."""

    def __init__(self) -> None:
        self._answered = 0

    def __call__(self, requests: Message, pages: list[Message] | None) -> Message:
        number, known = requests["number"], sorted(page["by"] for page in pages or ())
        to = known[number % len(known)] if known and number % _ROLL_CALL else None
        new = {page["number"]: page for page in pages or () if page["number"] > self._answered}
        self._answered = max(new, default=self._answered)
        return {"jobs": {**requests, "to": to}, "answers": [new[number] for number in sorted(new)] or None}


class Backend:
    """Answers the requests that are for it or for all: how many are left, by the newest copy of the stock."""

    def __init__(self) -> None:
        self._name = uuid.uuid4().hex[:6]

    def __call__(self, job: Message, stock: list[Message], best_sellers: list[int] | None) -> Message | None:
        if job["to"] not in (None, self._name):
            return None
        article, newest = job["article"], max(stock, key=lambda copy: copy["version"])
        sells = article in (best_sellers or ())
        return {
            "number": job["number"],
            "article": article,
            "left": newest["left"].get(article),
            "sells": sells,
            "by": self._name,
        }


def database() -> Iterator[Message]:
    """Gives each sale, and the whole stock after it. Versions go on when another database takes over."""
    while True:
        version = int(time.time() * 100)
        left = {article: 100 - version // 10 % (10 + article) for article in range(ARTICLES)}
        article = version % (ARTICLES if version % 3 else 2)
        yield {
            "changes": {"version": version, "article": article, "left": left[article]},
            "stock": {"version": version, "left": left},
        }


class Replica:
    """Gives the stock, by the database's changes."""

    def __init__(self) -> None:
        self._left: dict[int, int] = {}

    def __call__(self, changes: Message) -> Message:
        self._left[changes["article"]] = changes["left"]
        return {"version": changes["version"], "left": self._left}


class Cache:
    """Gives the three articles that have been sold most often."""

    def __init__(self) -> None:
        self._sold: Counter[int] = Counter()

    def __call__(self, changes: Message) -> list[int]:
        self._sold[changes["article"]] += 1
        return [article for article, _ in self._sold.most_common(3)]


def python() -> Iterator[None]:
    """A package: its unit runs, and gives nothing."""
    yield from ()
