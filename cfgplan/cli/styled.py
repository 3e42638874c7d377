"""Text with styles, independent of rich, which is imported only if a terminal shows the text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import rich.text

_DROPPED = dict.fromkeys((7, 8, 11, 12, 13))
"""Bell, backspace, vertical tab, form feed and carriage return: rich prints none of them."""


class Text:
    """A text in parts, each with a style of rich that is added to the style of the whole text."""

    def __init__(self, text: str = "", style: str = "") -> None:
        self._pieces: list[tuple[str | Text, str]] = [(text, "")] if text else []
        self._style = style

    def append(self, text: str, style: str = "") -> Text:
        """Add text at the end, and return this object."""
        self._pieces.append((text, style))
        return self

    def join(self, texts: Iterable[Text]) -> Text:
        """Return texts joined by this one."""
        joined = Text()
        for number, text in enumerate(texts):
            joined._pieces += [(self, ""), (text, "")] if number else [(text, "")]
        return joined

    @property
    def plain(self) -> str:
        """The characters that are printed without a terminal."""
        whole = "".join(piece if isinstance(piece, str) else piece.plain for piece, _ in self._pieces)
        return whole.translate(_DROPPED).expandtabs()

    def __str__(self) -> str:
        return self.plain

    def __rich__(self) -> rich.text.Text:
        from rich.text import Text as RichText

        shown = RichText(style=self._style)
        for piece, style in self._pieces:
            if isinstance(piece, str):
                shown.append(piece, style=style)
            else:
                shown.append(piece.__rich__())
        return shown
