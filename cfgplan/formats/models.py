"""The pydantic models of the parts of environment files: they say why a value is refused, and give the JSON Schema.

They are made of the same forms as the readers, and only when something is refused: most files need none of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import or_
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PlainValidator,
    Tag,
    ValidationError,
    WithJsonSchema,
    create_model,
)
from pydantic_core import PydanticCustomError

from cfgplan.formats.fields import Key, Part
from cfgplan.formats.forms import (
    After,
    Before,
    Choice,
    Described,
    Form,
    Instead,
    Limits,
    MoreSchema,
    RefusedError,
    Schema,
)

_IN_SCHEMA = {"ge": "minimum", "le": "maximum"}
"""The limits of a number that pydantic forgets in the schema, where a validator of ours comes first."""


def model_of(part: type[Part]) -> type[BaseModel]:
    """The model of a part; it accepts what the part's reader takes."""
    if part not in _MODELS:
        _MODELS[part] = _made_of(part)
    return _MODELS[part]


_MODELS: dict[type[Part], type[BaseModel]] = {}


def _made_of(part: type[Part]) -> type[BaseModel]:
    config = ConfigDict(extra="forbid", strict=True, defer_build=True)
    if part.schema is not None:
        config["json_schema_extra"] = dict(part.schema)
    if part.title is not None:
        config["title"] = part.title
    fields: dict[str, Any] = {key: (_annotation(each.form), _field(each)) for key, each in part.all_keys().items()}
    return create_model(part.__name__, __config__=config, __doc__=part.__doc__, __module__=part.__module__, **fields)


def refusals(part: type[Part], data: Any) -> list[Any]:
    """Pydantic's errors of data that a part's reader refuses."""
    try:
        model_of(part).model_validate(data)
    except ValidationError as error:
        return error.errors(include_url=False)
    raise AssertionError(f"the reader of {part.__name__} refuses what its model accepts: {data!r:.200}")


def _field(key: Key) -> Any:
    in_schema: Any = {_IN_SCHEMA[name]: limit for name, limit in key.limits.items() if name in _IN_SCHEMA}
    more = {"json_schema_extra": in_schema} if in_schema else {}
    return Field(default=key.default, description=key.meaning, **more, **key.limits)


def _annotation(form: Any) -> Any:
    """A form in the words of pydantic."""
    origin, inner = get_origin(form), get_args(form)
    if origin is Annotated:
        notes = [_WORDS[type(note)](note.told) for note in inner[1:] if type(note) in _WORDS]
        return Annotated[(_annotation(inner[0]), *notes)]
    if origin in (Union, UnionType):
        return reduce(or_, map(_annotation, inner))
    if origin in (list, dict):
        return origin[tuple(map(_annotation, inner))]
    return model_of(form) if isinstance(form, type) and issubclass(form, Part) else form


def _told(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a validator that says a refusal to pydantic."""

    def validator(value: Any) -> Any:
        try:
            return function(value)
        except RefusedError as refused:
            if refused.mend is None:
                raise PydanticCustomError(refused.kind, refused.text) from None
            told = {"text": refused.text, "mend": refused.mend}
            raise PydanticCustomError(refused.kind, "{text}", told) from None

    return validator


_WORDS: dict[type, Callable[[Any], Any]] = {
    Before: lambda function: BeforeValidator(_told(function)),
    After: lambda function: AfterValidator(_told(function)),
    Instead: lambda function: PlainValidator(_told(function)),
    Schema: WithJsonSchema,
    MoreSchema: lambda more: Field(json_schema_extra=more),
    Described: lambda meaning: Field(description=meaning),
    Form: Tag,
    Choice: Discriminator,
    Limits: lambda limits: Field(**limits),
}


def json_schema(part: type[Part]) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a definition, strict about the names of ports too."""
    schema = model_of(part).model_json_schema()
    _bar_other_names(schema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _bar_other_names(schema: Any) -> None:
    if isinstance(schema, dict):
        if "patternProperties" in schema:
            schema["additionalProperties"] = False
        for inner in schema.values():
            _bar_other_names(inner)
    elif isinstance(schema, list):
        for inner in schema:
            _bar_other_names(inner)
