"""The bytes of the schema, of digests and dumps: what was written by an earlier cfgplan means the same to this one.

`python tests/formats/test_golden_bytes.py` writes them anew, for a change of the format that is meant.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import cfgplan
from cfgplan.errors import InputError, InvalidValueError
from cfgplan.formats.document import read_document
from cfgplan.formats.dump import as_yaml, dump_yaml, plain_document, plain_environment
from cfgplan.formats.fields import EnvironmentPart
from cfgplan.formats.models import json_schema
from cfgplan.formats.xml_dump import dump_xml

HERE = Path(__file__).parent
MODELS = HERE.parent.parent / "models"
RECORD = HERE / "golden.json"
RICH = [HERE / "every_key.yaml", HERE / "every_key_of_xml.yaml"]
"""Worlds that say everything that an environment file can say."""


def worlds() -> dict[str, Path]:
    paths = [path for path in sorted(MODELS.glob("*/*.yaml")) if "format: cfgplan/1" in path.read_text()]
    return {str(path.relative_to(MODELS)): path for path in paths} | {path.name: path for path in RICH}


def hashed(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def xml_of(plain: Mapping[str, Any]) -> str:
    try:
        return hashed(dump_xml(plain))
    except InvalidValueError as error:
        return str(error)


def bytes_of(path: Path) -> dict[str, str]:
    """What a file is as YAML and XML; and its world, unless it is a library for others to include."""
    document = read_document(path)
    found = {"document as YAML": hashed(as_yaml(document)), "document as XML": xml_of(plain_document(document))}
    try:
        world = cfgplan.load(path)
    except InputError:
        return found
    plain = plain_environment(
        world.environment, horizon_s=world.horizon_s, max_cost_us=world.max_cost_us, survive=world.survive
    )
    return {
        **found,
        "digest": world.digest,
        "JSON": hashed(json.dumps(plain, default=str)),
        "YAML": hashed(dump_yaml(plain)),
        "XML": xml_of(plain),
    }


def schema() -> str:
    return hashed(json.dumps(json_schema(EnvironmentPart)))


@pytest.mark.parametrize("name", worlds())
def test_a_world_has_the_digest_and_the_dumps_that_it_had(name: str) -> None:
    assert bytes_of(worlds()[name]) == json.loads(RECORD.read_text())["worlds"][name]


def test_the_schema_is_what_it_was() -> None:
    assert schema() == json.loads(RECORD.read_text())["schema"]


if __name__ == "__main__":
    record = {"schema": schema(), "worlds": {name: bytes_of(path) for name, path in worlds().items()}}
    RECORD.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")
