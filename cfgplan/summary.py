"""Summaries of values: the line of their `repr`, and the table that a notebook shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice
from typing import TypeVar

from cfgplan.frozen import dataclass

Kind = TypeVar("Kind", bound=type)
MOST_ROWS = 60
"""The greatest number of rows of a table; the last one then says how many are left out."""


@dataclass(frozen=True)
class Summary:
    """A line, and a table with a row for each part."""

    line: str
    heads: tuple[str, ...] = ()
    rows: tuple[tuple[object, ...], ...] = ()
    left_out: int = 0

    def html(self) -> str:
        """The table with the line as its caption; markup in texts stays text."""
        from html import escape

        heads = "".join(f"<th>{escape(head)}</th>" for head in self.heads)
        rows = "".join(f"<tr>{''.join(f'<td>{escape(str(each))}</td>' for each in row)}</tr>" for row in self.rows)
        more = f"<tr><td colspan={len(self.heads)}>and {self.left_out} more</td></tr>" if self.left_out else ""
        caption = f'<caption style="text-align: left">{escape(self.line)}</caption>'
        return f"<table>{caption}<thead><tr>{heads}</tr></thead><tbody>{rows}{more}</tbody></table>"


def summary(line: str, heads: Iterable[str] = (), rows: Iterable[tuple[object, ...]] = ()) -> Summary:
    """A summary with the first `MOST_ROWS` of the rows."""
    rest = iter(rows)
    shown = tuple(islice(rest, MOST_ROWS))
    return Summary(line, tuple(heads), shown, sum(1 for _ in rest))


def tabled(of: Callable[..., Summary]) -> Callable[[Kind], Kind]:
    """A class decorator: a notebook shows a value as the table of its summary; its `repr` stays as it is."""

    def decorate(kind: Kind) -> Kind:
        setattr(kind, "_repr_html_", lambda self: of(self).html())  # noqa: B010
        return kind

    return decorate


def summarised(of: Callable[..., Summary]) -> Callable[[Kind], Kind]:
    """A class decorator: the `repr` of a value is the line of its summary, and a notebook shows the table."""

    def decorate(kind: Kind) -> Kind:
        setattr(kind, "__repr__", lambda self: f"<{kind.__name__}: {of(self).line}>")  # noqa: B010
        return tabled(of)(kind)

    return decorate


def cpu(cost_us: int) -> str:
    """A cost in microseconds of CPU time for people, exactly: `1.25 s`."""
    whole, part = divmod(abs(cost_us), 1_000_000)
    sign = "-" if cost_us < 0 else ""
    return f"{sign}{whole}{f'.{part:06}'.rstrip('0') if part else ''} s"


def counted(number: int, one: str, many: str | None = None) -> str:
    """A number with its noun: `1 target`, `2 targets`."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def some(names: Iterable[str], most: int = 6) -> str:
    """The first names, and how many more there are."""
    first = list(names)
    more = f" and {len(first) - most} more" if len(first) > most else ""
    return ", ".join(first[:most]) + more
