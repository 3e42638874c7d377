"""YAML text to plain data, straight from the parser's events.

Five times as fast as PyYAML's own construction, exact for numbers, and strict where YAML is lax: repeated
keys, several documents and aliases that blow up are faults, not surprises.
"""

from __future__ import annotations

from typing import Any

import yaml
from yaml import events

from cfgplan.canonical import normal
from cfgplan.errors import Fault, InputError
from cfgplan.formats.garbage import no_garbage_collection
from cfgplan.formats.places import DEEPEST_NESTING, Path, Source, Spot, has_no_dollar
from cfgplan.formats.scalars import FIRST_OF_NON_TEXT, resolve
from cfgplan.formats.yaml_faults import TOO_DEEP, syntax_fault

MOST_ALIASED_VALUES = 1_000_000
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_NO_KEY = object()
_LARGE = 20_000
"""Characters from which the reader of plain block style saves more time than its import takes."""


def read_yaml(text: str, file: str) -> Source:
    """Read one YAML document; its data is None if the text is empty. Raises InputError if it can't be read to
    the end.
    """
    with no_garbage_collection():
        if len(text) >= _LARGE:
            from cfgplan.formats.block_yaml import read_block_yaml

            if (plain := read_block_yaml(text)) is not None:
                return Source(file, plain, _YamlLocator(text), is_plain=has_no_dollar(text))
        try:
            data, faults = _YamlReading(text, file).document()
        except yaml.YAMLError as error:
            raise InputError([syntax_fault(error, text, file)]) from None
    return Source(file, data, _YamlLocator(text), tuple(faults), has_no_dollar(text))


class _YamlReading:
    """One pass over the events of a text."""

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.faults: list[Fault] = []
        self.next_event = _LOADER(text).get_event
        self.count = 0
        self.aliased = 0
        self.anchors: dict[str, tuple[object, int]] = {}
        self.open_anchors: set[str] = set()

    def document(self) -> tuple[object, list[Fault]]:
        self.next_event()
        if type(self.next_event()) is not events.DocumentStartEvent:
            return None, []
        root = self._values()
        self.next_event()
        event = self.next_event()
        if type(event) is events.DocumentStartEvent:
            self._stop(event, "a second document begins", "keep one document in a file: remove the line `---`")
        return root, self.faults

    def _values(self) -> object:
        holder: list[object] = []
        container: Any = holder
        is_list = True
        key: Any = _NO_KEY
        above: list[tuple[Any, bool, Any, str | None, int]] = []
        next_event = self.next_event
        while True:
            event = next_event()
            kind = type(event)
            if kind is events.ScalarEvent:
                self.count += 1
                value = event.value
                if event.implicit[0]:
                    if not value or value[0] in FIRST_OF_NON_TEXT:
                        value = resolve(value)
                elif event.tag is not None:
                    self._check_yaml_tag(event)
                if event.anchor is not None:
                    self._define(event, event.anchor, value, 1)
                if not is_list and key is _NO_KEY:
                    key = self._key(event, value, container)
                    continue
            elif kind is events.MappingEndEvent or kind is events.SequenceEndEvent:
                done = container
                container, is_list, key, anchor, before = above.pop()
                if anchor is not None:
                    self._define(event, anchor, done, self.count - before)
                    self.open_anchors.discard(anchor)
                if not above:
                    return holder[0]
                continue
            elif kind is events.AliasEvent:
                value = self._aliased(event)
                if not is_list and key is _NO_KEY:
                    key = self._key(event, value, container)
                    continue
            else:
                self.count += 1
                if not is_list and key is _NO_KEY:
                    self._stop(event, "a key is a list or a mapping", 'write it in quotes if it is text, such as "{a}"')
                if len(above) > DEEPEST_NESTING:
                    self._stop(event, *TOO_DEEP)
                if event.tag is not None and not event.implicit:
                    self._check_yaml_tag(event)
                if event.anchor is not None:
                    self.open_anchors.add(event.anchor)
                value = {} if kind is events.MappingStartEvent else []
            if is_list:
                container.append(value)
            else:
                container[key] = value
            if kind is events.MappingStartEvent or kind is events.SequenceStartEvent:
                above.append((container, is_list, _NO_KEY, event.anchor, self.count))
                container, is_list, key = value, kind is events.SequenceStartEvent, _NO_KEY
            elif not above:
                return holder[0]
            else:
                key = _NO_KEY

    def _key(self, event: Any, value: object, mapping: dict[str, object]) -> str:
        if not isinstance(value, str):
            written = getattr(event, "value", "")
            self._note(event, f"the key {written} is not text", f'write it in quotes: "{written}"')
            value = written
        value = normal(str(value))
        if value == "<<" and event.implicit[0]:
            self._stop(event, "merge keys (`<<`) are not supported", "write out what is merged, here and further on")
        elif value in mapping:
            self._note(event, f"the key `{value}` occurs twice", "remove one of the two or rename it")
        return value

    def _define(self, event: Any, anchor: str, value: object, size: int) -> None:
        if anchor in self.anchors:
            self._stop(event, f"the anchor &{anchor} is defined twice", "give each anchor a name of its own")
        self.anchors[anchor] = (value, size)

    def _aliased(self, event: Any) -> object:
        anchor = event.anchor
        if anchor in self.open_anchors:
            self._stop(event, f"*{anchor} stands inside of &{anchor}, which it repeats", "write the value out")
        if anchor not in self.anchors:
            self._stop(event, f"*{anchor} refers to an anchor that is not defined before", f"define &{anchor} first")
        value, size = self.anchors[anchor]
        self.count += size
        self.aliased += size
        if self.aliased > MOST_ALIASED_VALUES:
            self._stop(
                event, f"aliases repeat more than {MOST_ALIASED_VALUES:,} values", "use fewer aliases, or a template"
            )
        return value

    def _check_yaml_tag(self, event: Any) -> None:
        if event.tag not in ("!", "tag:yaml.org,2002:str"):
            shown = event.tag.replace("tag:yaml.org,2002:", "!!")
            self._note(
                event, f"the YAML tag {shown} is not supported", "remove it, or quote the text that begins with !"
            )

    def _note(self, event: Any, message: str, mend: str) -> None:
        mark = event.start_mark
        self.faults.append(Fault(message, self.file, mark.line + 1, mark.column + 1, mend=mend))

    def _stop(self, event: Any, message: str, mend: str) -> None:
        self._note(event, message, mend)
        raise InputError(self.faults)


class _YamlLocator:
    """Finds spots in a YAML text; the tree of positions is made at the first question."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._lines: list[str] | None = None
        self._root: Any = None

    def __call__(self, path: Path, at_key: bool) -> Spot:
        if self._lines is None:
            with no_garbage_collection():
                self._root = yaml.compose(self._text, _LOADER)
            self._lines = self._text.splitlines()
        node = self._root
        if node is None:
            return Spot(1, 1)
        for number, step in enumerate(path, start=1):
            key, value = _child(node, step)
            if value is None:
                break
            node = key if at_key and key is not None and number == len(path) else value
        return self._spot(node, self._lines)

    def _spot(self, node: Any, lines: list[str]) -> Spot:
        line, column = node.start_mark.line, node.start_mark.column
        if not isinstance(node, yaml.ScalarNode):
            return Spot(line + 1, column + 1)
        start = column + (node.style in ("'", '"'))
        literal = line < len(lines) and lines[line].startswith(node.value, start) and node.style not in ("|", ">")
        return Spot(line + 1, column + 1, node.value, start + 1 if literal else None)


def _child(node: Any, step: str | int) -> tuple[Any, Any]:
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        return None, node.value[step]
    if isinstance(node, yaml.MappingNode):
        for key, value in reversed(node.value):
            if isinstance(key, yaml.ScalarNode) and normal(key.value) == step:
                return key, value
    return None, None
