"""The names in formulas: features are semantic subscriptions, regions are parts of the plane.

A features file:

    features:
      ball: Position and hasSource some Ball      # or {tag: ..., hold: 0.5}: for how many seconds a value counts
    regions:
      opponent_half: {box: [0, -3, 4.5, 3]}       # or {polygon: [[x, y], ...]}, {circle: [x, y], radius: r}
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from cfgplan.domain import Environment
from cfgplan.errors import Fault, InputError, did_you_mean
from cfgplan.formats.files import read_source
from cfgplan.formats.places import Source
from cfgplan.formats.yaml_text import read_yaml
from cfgplan_runtime.reasoning.regions import NotARegionError, Region, region_from

FILE_BESIDE = "features.yaml"
"""The name of the features file beside an environment file."""
_FEATURE_NAME = re.compile(r"[^\W\d]\w*")
_RESERVED = frozenset({"always", "eventually", "until", "and", "or", "not", "in", "true", "false", "inf"})
_FEATURES_FORM = "write `features:` and `regions:`, each a mapping of names"
_KEYS = ("features", "regions")
_FEATURE_KEYS = ("tag", "hold")


@dataclass(frozen=True, slots=True)
class Feature:
    """A name for a semantic subscription.

    `topic` is the topic of an existing target of the environment; without one, the engine adds a target. A sample
    counts as the value for `hold_ns` nanoseconds; None means the query's default.
    """

    name: str
    tag: str
    topic: str | None = None
    hold_ns: int | None = None
    origin: Fault | None = None
    """The place of its declaration, for messages."""


@dataclass(frozen=True)
class DeclaredFeatures:
    """The features and regions that formulas may name."""

    features: Mapping[str, Feature] = field(default_factory=dict)
    regions: Mapping[str, Region] = field(default_factory=dict)

    def with_more(self, other: DeclaredFeatures) -> DeclaredFeatures:
        """These features and regions with those of `other`, which has priority if both have a name."""
        return DeclaredFeatures({**self.features, **other.features}, {**self.regions, **other.regions})


def of_targets(environment: Environment) -> DeclaredFeatures:
    """The targets of an environment whose labels can be names in a formula."""
    return DeclaredFeatures(
        {
            target.label: Feature(target.label, target.tag, target.topic)
            for target in environment.stream_targets
            if _FEATURE_NAME.fullmatch(target.label) and target.label not in _RESERVED
        }
    )


def of_file(path: str | os.PathLike[str]) -> DeclaredFeatures:
    """Read a features file. Raises InputError with every fault."""
    source = read_source(Path(path))
    faults = list(source.faults)
    data = source.data
    if data is None:
        raise InputError.of("the file is empty", file=source.file, mend=f"{_FEATURES_FORM}, or remove the file")
    if not isinstance(data, Mapping):
        raise InputError([*faults, source.fault((), "this is not a features file", _FEATURES_FORM)])
    for key in data:
        if key not in _KEYS:
            mend = did_you_mean(str(key), _KEYS, "the keys here are features and regions")
            faults.append(source.fault((key,), f"unknown key `{key}`", mend, at_key=True))
    features, regions = {}, {}
    for name, written in _members(source, "features", faults):
        feature = _feature(source, name, written, faults)
        if feature is not None:
            features[name] = feature
    for name, written in _members(source, "regions", faults):
        if name in features:
            faults.append(
                source.fault(
                    ("regions", name), f"`{name}` is declared as a feature and as a region", "rename one", at_key=True
                )
            )
        try:
            regions[name] = region_from(_plain(written))
        except NotARegionError as error:
            faults.append(source.fault(("regions", name), str(error), error.mend))
    if faults:
        raise InputError(faults)
    return DeclaredFeatures(features, regions)


def of_options(features: list[str], regions: list[str]) -> DeclaredFeatures:
    """Features written as `NAME=TAG` and regions as `NAME=REGION`. Raises InputError with every fault."""
    found: dict[str, Feature] = {}
    shapes: dict[str, Region] = {}
    faults: list[Fault] = []
    for option, texts, example in (
        ("--feature", features, "ball='Position and hasSource some Ball'"),
        ("--region", regions, "goal='{box: [4, -1, 5, 1]}'"),
    ):
        for text in texts:
            name, equals, value = (part.strip() for part in text.partition("="))
            if not (equals and value):
                faults.append(Fault(f"{text!r} is not NAME=VALUE", option, mend=f"write {option} {example}"))
            elif _bad_name(name):
                faults.append(Fault(f"{name!r} can't be a name: {_bad_name(name)}", option))
            elif option == "--feature":
                found[name] = Feature(name, value, origin=Fault("", option))
            else:
                try:
                    shapes[name] = region_from(_plain(read_yaml(value, option).data))
                except NotARegionError as error:
                    faults.append(Fault(str(error), option, key=name, mend=error.mend))
                except InputError as error:
                    faults.extend(error.faults)
    if faults:
        raise InputError(faults)
    return DeclaredFeatures(found, shapes)


def _members(source: Source, key: str, faults: list[Fault]) -> list[tuple[str, Any]]:
    data = source.data
    assert isinstance(data, Mapping)
    members = data.get(key) or {}
    if not isinstance(members, Mapping):
        faults.append(source.fault((key,), f"`{key}` is not a mapping of names", f"write {key}: {{name: ...}}"))
        return []
    found = []
    for name, written in members.items():
        if _bad_name(name):
            faults.append(source.fault((key, name), f"{name!r} can't be a name: {_bad_name(name)}", at_key=True))
        else:
            found.append((name, written))
    return found


def _feature(source: Source, name: str, written: Any, faults: list[Fault]) -> Feature | None:
    parts = written if isinstance(written, Mapping) else {"tag": written}
    path = ("features", name)
    before = len(faults)
    for key in parts:
        if key not in _FEATURE_KEYS:
            mend = did_you_mean(str(key), _FEATURE_KEYS, "a feature has tag and hold")
            faults.append(source.fault((*path, key), f"unknown key `{key}`", mend, at_key=True))
    tag, hold = parts.get("tag"), parts.get("hold")
    if not isinstance(tag, str) or not tag.strip():
        mend = f"write {name}: Position and hasSource some Ball"
        faults.append(source.fault(path, "a feature has a tag, which is text", mend))
    if hold is not None and (
        isinstance(hold, (str, bool)) or not isinstance(hold, (int, Decimal)) or not 0 <= hold < 1e9
    ):
        faults.append(source.fault((*path, "hold"), "hold is a number of seconds", "write hold: 0.5"))
    if len(faults) > before:
        return None
    place = source.fault((*path, "tag") if isinstance(written, Mapping) else path, "")
    return Feature(name, str(tag), None, None if hold is None else round(hold * 1_000_000_000), place)


def _bad_name(name: object) -> str | None:
    if not isinstance(name, str) or not _FEATURE_NAME.fullmatch(name):
        return "a name has letters, digits and _, and begins with a letter"
    return "it is a word of the formula language" if name in _RESERVED else None


def _plain(value: Any) -> Any:
    """A value of a file, with its numbers as floats."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return float(value) if isinstance(value, Decimal) else value
