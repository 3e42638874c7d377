"""Readers and models are made of the same forms: a reader takes what the model accepts, and makes the same of it."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError
from test_schema_and_loader import VALUES, places, with_value

from cfgplan.domain import InputPort, OutputPort, Transformation
from cfgplan.formats import fields as file_fields
from cfgplan.formats.fields import EnvironmentPart, Key, Part
from cfgplan.formats.forms import Reader, RefusedError
from cfgplan.formats.models import model_of
from cfgplan.formats.yaml_text import read_yaml
from cfgplan.transformations import transformation_of

ODD = (
    *VALUES,
    Decimal("2.0"),
    Decimal("0.3"),
    Decimal("NaN"),
    Decimal("1e400"),
    "a\n",
    " a",
    "e\u0301",
    "\ud800",
    ["a", "a"],
)


def plain(value: object) -> Any:
    """The values of a part or a model, and of those in it, as mappings."""
    if isinstance(value, BaseModel):
        return {key: plain(getattr(value, key)) for key in value.model_fields_set}
    if isinstance(value, Part):
        return {key: plain(each) for key, each in vars(value).items()}
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, list) else value


def read(data: Any) -> Any:
    """The values that the reader makes of data; None if it refuses it."""
    try:
        return plain(EnvironmentPart.reader()(data))
    except RefusedError:
        return None


def accepted(data: Any) -> Any:
    """The values that the model makes of data; None if it refuses it."""
    try:
        return plain(model_of(EnvironmentPart).model_validate(data))
    except ValidationError:
        return None


@pytest.mark.parametrize("value", ODD, ids=repr)
def test_a_reader_takes_what_the_model_accepts(value: object) -> None:
    differ = [way for alone, way in places() if read(data := with_value(alone, way, value)) != accepted(data)]
    assert not differ


def test_a_reader_makes_of_every_key_what_the_model_does() -> None:
    data = read_yaml((Path(__file__).parent / "every_key.yaml").read_text(), "").data
    assert read(data) == accepted(data) is not None


@pytest.mark.parametrize("extra", [{"unknown": 1}, {"units": [{"id": "u"}]}, {"units": {}}, {"transformations": [1]}])
def test_a_reader_refuses_unknown_and_missing_keys_as_the_model_does(extra: Any) -> None:
    assert read({"format": "cfgplan/1", **extra}) is accepted({"format": "cfgplan/1", **extra}) is None


def test_no_key_hides_what_every_part_has() -> None:
    def below(part: type[Part]) -> set[type[Part]]:
        return {part}.union(*map(below, part.__subclasses__()))

    assert not {key for part in below(Part) - {Part} for key in part.all_keys()} & vars(Part).keys()


def test_a_transformation_of_read_fields_is_as_the_constructor_makes_it() -> None:
    said: dict[str, Any] = {
        "label": "t",
        "inputs": (InputPort("a", "A"), InputPort("b", "B")),
        "outputs": (OutputPort("c", "C"),),
        "labor_us": 3,
        "params": {"x": 1},
    }
    for fields in (said, {**said, "needs": {"memory": 3, "arm": 1}}, {"label": "t"}):
        assert transformation_of(fields) == Transformation(**fields)
        assert repr(transformation_of(fields)) == repr(Transformation(**fields))
    assert json.dumps(transformation_of({"label": "t"}).takes | {}) == json.dumps(Transformation("t").takes | {})


def test_a_key_gets_its_reader_when_it_first_occurs(monkeypatch: pytest.MonkeyPatch) -> None:
    class Two(Part):
        one: str = file_fields.row("a text", ...)
        other: str = file_fields.row("a text")

    made, reader_of_key = [], file_fields._reader_of_key

    def noted(key: Key) -> Reader:
        made.append(key.default)
        return reader_of_key(key)

    monkeypatch.setattr(file_fields, "_reader_of_key", noted)
    read = Two.reader()
    assert [read({"one": "x"}).one, read({"one": "y"}).one] == ["x", "y"]
    assert made == [...]
    assert read({"one": "x", "other": "z"}).other == "z"
    assert made == [..., None]
    with pytest.raises(RefusedError):
        read({"one": "x", "third": "z"})
