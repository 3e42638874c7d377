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
"""One in this many requests goes to all backends, so that the balancer learns which backends answer."""

Message = dict[str, Any]


def entrance() -> Iterator[Message]:
    """Yield the requests of visitors. Their numbers also rise when another entrance takes over."""
    first = time.time_ns() // 10_000_000
    for number in count(first):
        yield {"number": number, "article": number % ARTICLES}


class Balancer:
    """Sends each request to one of the backends in turn, and returns their answers to visitors."""

    def __init__(self) -> None:
        self._answered = 0

    def __call__(self, requests: Message, pages: list[Message] | None) -> Message:
        number, known = requests["number"], sorted(page["by"] for page in pages or ())
        to = known[number % len(known)] if known and number % _ROLL_CALL else None
        new = {page["number"]: page for page in pages or () if page["number"] > self._answered}
        self._answered = max(new, default=self._answered)
        return {"jobs": {**requests, "to": to}, "answers": [new[number] for number in sorted(new)] or None}


class Backend:
    """Answers requests to itself or to all backends with the article's number in the newest copy of the stock."""

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
    """Yield each sale, and the whole stock after it. Versions also rise when another database takes over."""
    while True:
        version = int(time.time() * 100)
        left = {article: 100 - version // 10 % (10 + article) for article in range(ARTICLES)}
        article = version % (ARTICLES if version % 3 else 2)
        yield {
            "changes": {"version": version, "article": article, "left": left[article]},
            "stock": {"version": version, "left": left},
        }


class Replica:
    """Applies the database's changes to a copy of the stock, and returns the copy."""

    def __init__(self) -> None:
        self._left: dict[int, int] = {}

    def __call__(self, changes: Message) -> Message:
        self._left[changes["article"]] = changes["left"]
        return {"version": changes["version"], "left": self._left}


class Cache:
    """Counts the sales, and returns the three articles that were sold most often."""

    def __init__(self) -> None:
        self._sold: Counter[int] = Counter()

    def __call__(self, changes: Message) -> list[int]:
        self._sold[changes["article"]] += 1
        return [article for article, _ in self._sold.most_common(3)]


def python() -> Iterator[None]:
    """Stand for an installed package: the unit runs, but yields nothing."""
    yield from ()
