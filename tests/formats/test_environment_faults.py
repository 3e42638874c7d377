"""Environment files that don't load: the exact place and the mend, as a user sees them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from loading import faults_of, load, only_fault, place_of

from cfgplan.errors import InputError
from cfgplan.formats import files
from cfgplan.formats.document import read_document
from cfgplan.formats.fields import EnvironmentPart
from cfgplan.formats.models import json_schema

HEAD = "format: cfgplan/1\n"
A = "transformations:\n  - {label: a, inputs: {i: T}, outputs: {o: T, p: T}}\n"
TARGET = "targets: [{label: t, topic: /t, tag: T}]\n"


@pytest.mark.parametrize(
    ("text", "place", "message", "mend"),
    [
        ("upkep: 3\n", (2, 1), "unknown key `upkep`", None),
        (
            "transformations:\n  - {label: a, upkep: 3}\n",
            (3, 16),
            "unknown key `upkep`",
            "did you mean `upkeep`?",
        ),
        ("defaults: {labour: 3}\n", (2, 12), "unknown key `labour`", "did you mean `labor`?"),
        (
            "horizon: '600'\n",
            (2, 10),
            "this must be a whole number, but is the text '600'",
            "write a whole number of seconds, such as 600",
        ),
        ("horizon: 600.5\n", (2, 10), "this must be a whole number, but is the number 600.5", None),
        ("horizon: -1\n", (2, 10), "the number -1 is out of range", "at least 0"),
        ("horizon: 1000000000000\n", (2, 10), "out of range", "at most 1000000000"),
        ("horizon: true\n", (2, 10), "this must be a whole number, but is true", None),
        ("horizon: 1.5s\n", (2, 10), "this must be a whole number, but is the text '1.5s'", None),
        (
            "transformations: [{label: a, outputs: [A]}]\n",
            (2, 39),
            "must be a mapping",
            "write each port as `name: tag`",
        ),
        ("links: [{between: [r1]}]\n", (2, 19), "this must be a list of at least 2 entries, but has 1", None),
        ("max_cost: -0.5\n", (2, 11), "-0.5 is negative", "write a number of 0 or more"),
        ("max_cost: .inf\n", (2, 11), "Infinity is not a finite number of seconds", None),
        ("max_cost: .nan\n", (2, 11), "NaN is not a finite number of seconds", None),
        ("max_cost: 0.0000001\n", (2, 11), "1E-7 is finer than a microsecond", "write at most six decimals"),
        ("max_cost: 1e999999\n", (2, 11), "too large", None),
        ("max_cost: 1" + "0" * 5000 + "\n", (2, 11), "too large", None),
        ("max_cost: '1'\n", (2, 11), "a number of CPU seconds, but is the text '1'", "without quotes"),
        ("max_cost: yes\n", (2, 11), "a number of CPU seconds, but is the text 'yes'", None),
        ("max_cost: true\n", (2, 11), "a number of CPU seconds, but is true", None),
        ("max_cost: [1]\n", (2, 11), "a number of CPU seconds, but is a list", None),
        (
            "transformations: {label: a}\n",
            (2, 18),
            "this must be a list, but is a mapping",
            "begin each entry with `- `",
        ),
        ("transformations: [a]\n", (2, 19), "a mapping of keys to values, but is the text 'a'", None),
        ("transformations: [{}]\n", (2, 19), "the key `label` is missing", "add `label:` here"),
        ("transformations: [{label: 1.0}]\n", (2, 27), "text, but is the number 1.0", 'in quotes: "1.0"'),
        ("transformations: [{label: 0x10}]\n", (2, 27), "text, but is the number 16", 'in quotes: "0x10"'),
        ("transformations: [{label: true}]\n", (2, 27), "text, but is true", 'in quotes: "true"'),
        ("transformations: [{label: }]\n", (2, 27), "text, but is empty", "write a text, or remove the key"),
        ("transformations: [{label: ''}]\n", (2, 27), "the name is empty", None),
        ('transformations: [{label: "a\\nb"}]\n', (2, 27), "'a\\nb' is no name", "no line breaks"),
        ("transformations: [{label: a, inputs: {i: }}]\n", (2, 42), "text, but is empty", None),
        ("transformations: [{label: a, inputs: {i: ''}}]\n", (2, 42), "the tag is empty", None),
        ("transformations: [{label: a, inputs: {requires: ''}}]\n", (2, 49), "the tag is empty", None),
        ("transformations: [{label: a, requires: ''}]\n", (2, 40), "the requirement is empty", "such as `night`"),
        ("transformations: [{label: a, on: ''}]\n", (2, 34), "the selector is empty", "a label of hosts"),
        ("transformations: [{label: a, inputs: {a/b: T}}]\n", (2, 39), "'a/b' is no name", "no slashes"),
        ("transformations: [{label: a, inputs: {1: T}}]\n", (2, 39), "the key 1 is not text", 'in quotes: "1"'),
        ("transformations: [{label: a, inputs: {i: T}, outputs: {i: T}}]\n", (2, 56), "name `i` is taken", "rename"),
        ("transformations: [{label: a, pinned: yes}]\n", (2, 38), "true or false, but is the text 'yes'", None),
        ("transformations: [{label: a, params: {x: .inf}}]\n", (2, 38), "Infinity is not a finite number", None),
        ("transformations: [{label: a, params: 3}]\n", (2, 38), "a mapping of keys to values", None),
        ("transformations: [{label: a}, {label: a}]\n", (2, 39), "the transformation label `a` is taken", None),
        ("transformations: [{label: a, label: b}]\n", (2, 30), "the key `label` occurs twice", None),
        ("horizon: 1\nhorizon: 2\n", (3, 1), "the key `horizon` occurs twice", None),
        ("<<: {horizon: 1}\n", (2, 1), "merge keys (`<<`) are not supported", "write out what is merged"),
        ("transformations: [{label: a, <<: {labor: 1}}]\n", (2, 30), "merge keys (`<<`) are not supported", None),
        ("targets:\n- &a {tag: T}\n- {<<: *a}\n- {<<: *a, label: c}\n", (4, 4), "merge keys", "and further on"),
        ("transformations: [{label: a, inputs: {i: A and Bad}}]\n", (2, 48), "unknown name Bad", "did you mean `Bed`?"),
        ("transformations: [{label: a, inputs: {i: 'A Bad'}}]\n", (2, 45), "unknown name Bad", None),
        ('transformations: [{label: a, inputs: {i: "\\x41 Bad"}}]\n', (2, 42), "unknown name Bad", None),
        ("targets:\n- label: t\n  topic: /t\n  tag: >\n    A and\n    Bad\n", (5, 8), "unknown name Bad", None),
        ("targets: [{label: t, topic: /t}]\n", (2, 11), "the key `tag` is missing", "add `tag:` here"),
        ("targets: [{label: t}]\n", (2, 11), "the key `topic` is missing", "or `run:` with the transformation that"),
        (
            "transformations: [{label: a}]\ntargets: [{label: t, run: b}]\n",
            (3, 27),
            "there is no transformation `b`",
            "a transformation",
        ),
        ("transformations: [{label: a}]\ntargets: [{label: t, run: a, topic: /t}]\n", (3, 30), "no `topic`", "remove"),
        ("transformations: [{label: a}]\ntargets: [{label: t, run: a, type: b/C}]\n", (3, 30), "no `type`", "remove"),
        ("targets: [{label: t, topic: /t, tag: T, priority: high}]\n", (2, 51), "a whole number", None),
        (
            "targets: [{label: t, topic: /t, tag: T}, {label: t, topic: /u, tag: T}]\n",
            (2, 50),
            "the target label `t` is taken",
            None,
        ),
        (
            "targets: [{label: t, topic: /t, tag: T}, {label: u, topic: /t, tag: T}]\n",
            (2, 60),
            "the topic `/t` is taken",
            None,
        ),
        ("label: !color red\n", (2, 8), "the YAML tag !color is not supported", None),
        ("include: [nothing.yaml]\n", (2, 11), "nothing.yaml: there is no such file", "check the path"),
        ("include: nothing.yaml\n", (2, 10), "nothing.yaml: there is no such file", "check the path"),
        ("ontology: [1]\n", (2, 12), "text, but is the number 1", None),
        ("ontology: 1\n", (2, 11), "text, but is the number 1", None),
        (f"{A}units: [{{id: u, transformation: b}}]\n", (4, 33), "there is no transformation `b`", "write the label"),
        (f"{A}units: [{{id: u, transformation: a, inputs: {{x: }}}}]\n", (4, 45), "no input `x`", "its inputs are i"),
        (f"{A}units: [{{id: u, transformation: a, inputs: {{i: v/o}}}}]\n", (4, 48), "no unit `v` is running", None),
        (f"{A}units: [{{id: u, transformation: a, inputs: {{i: u}}}}]\n", (4, 48), "'u' is not a stream", "unit/port"),
        (
            "transformations: [{label: a, inputs: {i: {tag: T, worth: 1}}}]\n",
            (2, 58),
            "`worth` is only for optional inputs, and `i` is not optional",
            "add `optional: true`, or remove `worth`",
        ),
        (
            "transformations: [{label: a, inputs: {i: {tag: T, count: some}}}]\n",
            (2, 58),
            "some can't be a number of streams",
            "write a whole number from 1 to 1000, or all",
        ),
        ("x: &y [1]\n*y : 2\n", (2, 1), "unknown key `x`", None),
        (
            f"{A}units: [{{id: u, transformation: a, inputs: {{i: [v/o, v/o]}}}}]\n",
            (4, 54),
            "`v/o` feeds the input twice",
            "name it once",
        ),
        (f"{A}units: [{{id: u, transformation: a, inputs: {{i: u/o}}}}]\n", (4, 48), "unit `u` feeds itself", None),
        (
            f"{A}units: [{{id: u, transformation: a}}, {{id: v, transformation: a, inputs: {{i: u/q}}}}]\n",
            (4, 76),
            "transformation `a` has no output `q`",
            "its outputs are o, p",
        ),
        (
            f"{A}units: [{{id: u, transformation: a}}, {{id: u, transformation: a}}]\n",
            (4, 42),
            "the unit id `u` is taken",
            None,
        ),
        (
            f"{A}{TARGET}units: [{{id: u, transformation: a, topics: {{q: [/t]}}}}]\n",
            (5, 45),
            "transformation `a` has no output `q`",
            None,
        ),
        (
            f"{A}{TARGET}units: [{{id: u, transformation: a, topics: {{o: [/tt]}}}}]\n",
            (5, 49),
            "no target names the topic `/tt`",
            "did you mean `/t`?",
        ),
        (
            f"{A}{TARGET}units: [{{id: u, transformation: a, topics: {{o: [/t], p: [/t]}}}}]\n",
            (5, 58),
            "the unit publishes on `/t` 2 times",
            None,
        ),
    ],
)
def test_a_fault_has_its_place_and_its_mend(
    tmp_path: Path, text: str, place: tuple[int, int], message: str, mend: str | None
) -> None:
    fault = next(f for f in faults_of(tmp_path, HEAD + text) if message in f.message)
    assert place_of(fault) == place
    assert fault.file == str(tmp_path / "env.yaml")
    assert mend is None or (fault.mend is not None and mend in fault.mend)


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("", (None, None), "the file is empty"),
        ("# nothing\n", (None, None), "the file is empty"),
        ("just a text\n", (1, 1), "this is not an environment"),
        ("- a\n- b\n", (1, 1), "this is not an environment"),
        ("a: [1, 2\nb: 3\n", (1, 4), "this is not YAML"),
        ("a: 1\n\tb: 2\n", (2, 1), "this is not YAML"),
        ("a: b: c\n", (1, 5), "this is not YAML"),
        ("a: 'open\n", (1, 4), "this is not YAML: the quote that begins here is never closed"),
        ("a: \x01\n", (1, 4), "this is not YAML"),
        ("format: cfgplan/1\n---\nformat: cfgplan/1\n", (2, 1), "a second document begins"),
        ("a: " + "[" * 100 + "]" * 100, (1, 68), "nested more than 64 deep"),
        ("a: &x [*x]\n", (1, 8), "*x stands inside of &x"),
        ("a: *x\n", (1, 4), "*x refers to an anchor that is not defined before"),
        ("a: &x 1\nb: &x 2\n", (2, 4), "the anchor &x is defined twice"),
        ("? [a, b]\n: c\n", (1, 3), "a key is a list or a mapping"),
        ("a: {{b}: c}\n", (1, 5), "a key is a list or a mapping"),
    ],
)
def test_what_is_no_yaml_document_has_one_fault(
    tmp_path: Path, text: str, place: tuple[int | None, int | None], message: str
) -> None:
    fault = only_fault(tmp_path, text)
    assert (place_of(fault), message in fault.message) == (place, True), fault
    assert fault.mend


@pytest.mark.parametrize("depth", [2000, 100_000])
def test_very_deep_nesting_is_told_as_that_wherever_libyaml_gives_up(tmp_path: Path, depth: int) -> None:
    fault = only_fault(tmp_path, "a: " + "[" * depth)
    assert (place_of(fault)[0], fault.message) == (1, "values are nested more than 64 deep")


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("", (None, None), "the file is empty"),
        # Python names the comma since 3.13, and before what stands behind it.
        ('{"format": "cfgplan/1",}', (1, 23 if sys.version_info >= (3, 13) else 24), "this is not JSON"),
        ('{"format": "cfgplan/1",\n "horizon": 1, "horizon": 2}', (2, 16), "the key `horizon` occurs twice"),
        ('{"format": "cfgplan/1", "max_cost": NaN}', (1, 37), "NaN is not a finite number"),
        ('{"format": "cfgplan/1",\n "max_cost": "1"}', (2, 14), "is the text '1'"),
        ("[" * 100_000, (None, None), "nested more than 64 deep"),
        ("[" * 100 + "]" * 100, (None, None), "nested more than 64 deep"),
        ('{"format": "cfgplan/1", "\\ud800": 1}', (None, None), "half of a surrogate pair"),
        ('{"format": "cfgplan/1",\n "targets": [{"label": "t", "topic": "/t", "tag": "A Bad"}]}', (2, 54), "name Bad"),
    ],
)
def test_what_is_wrong_in_json_has_one_fault(
    tmp_path: Path, text: str, place: tuple[int | None, int | None], message: str
) -> None:
    fault = only_fault(tmp_path, text, "env.json")
    assert (place_of(fault), message in fault.message) == (place, True), fault


@pytest.mark.parametrize("written", ["cfgplan/2", "yaml", "1"])
def test_another_format_is_refused(tmp_path: Path, written: str) -> None:
    fault = only_fault(tmp_path, f"format: {written}\n")
    assert (place_of(fault), fault.mend) == ((1, 9), "this cfgplan reads `format: cfgplan/1`")


def test_a_file_without_its_format_is_refused(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, "horizon: 3\n")
    assert (fault.message, fault.mend) == ("the key `format` is missing", "add `format: cfgplan/1` here")


def test_a_nest_of_aliases_is_refused_before_it_grows(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 40)]
    fault = only_fault(tmp_path, "".join(lines))
    assert fault.message == "aliases repeat more than 1,000,000 values"
    assert fault.line == 6


def test_a_file_that_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "LARGEST_FILE_BYTES", 2**20)
    fault = only_fault(tmp_path, HEAD + "#" * 2**20)
    assert fault.message == "the file is larger than 1 MiB"


def test_a_file_that_never_ends_is_too_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "LARGEST_FILE_BYTES", 2**20)
    with pytest.raises(InputError, match="larger than 1 MiB"):
        read_document("/dev/zero")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"env\.yaml: there is no such file"):
        load(tmp_path / "env.yaml")


def test_a_folder_is_not_a_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="this is a folder"):
        load(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_that_may_not_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_text(HEAD)
    path.chmod(0)
    with pytest.raises(InputError, match="may not be read"):
        load(path)


def test_a_path_that_can_be_no_file_is_refused() -> None:
    for path in ("a\0b", "x" * 5000):
        with pytest.raises(InputError, match="can't be read"):
            load(Path(path))


def test_another_encoding_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_bytes(b"format: cfgplan/1\n# caf\xe9\n")
    with pytest.raises(InputError, match=r"env\.yaml:2:\d+: byte 0xe9 is not UTF-8"):
        load(path)
    path.write_bytes("format: cfgplan/1\n".encode("utf-16"))
    with pytest.raises(InputError, match="the file is in UTF-16"):
        load(path)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "env.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + HEAD.encode() + b"horizon: x\n")
    with pytest.raises(InputError, match=r"env\.yaml:2:10: "):
        load(path)


def test_a_port_with_an_unquoted_nominal_is_told_to_quote_it(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, HEAD + "transformations: [{label: a, outputs: {o: {cam1}}}]\n")
    assert place_of(fault) == (2, 43)
    assert fault.mend == "write it in quotes: a text that begins with { is read as a mapping"


def test_a_nominal_inside_of_a_tag_is_told_to_be_quoted(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, HEAD + "transformations: [{label: a, outputs: {o: r some {cam1}}}]\n")
    assert place_of(fault) == (2, 50)
    assert fault.mend is not None and fault.mend.startswith("quote a text")


def test_a_port_may_be_a_tag_or_a_mapping(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, HEAD + "transformations: [{label: a, outputs: {o: [A]}}]\n")
    mend = "write a tag here, such as `Image`"
    assert (fault.message, fault.mend) == ("this must be a tag or a mapping, but is a list", mend)


def test_every_cycle_of_units_is_named(tmp_path: Path) -> None:
    units = "".join(
        f"  - {{id: {unit}, transformation: a, inputs: {{i: {feeder}/o}}}}\n"
        for unit, feeder in [("u", "v"), ("v", "w"), ("w", "u"), ("x", "y"), ("y", "x")]
    )
    faults = faults_of(tmp_path, f"{HEAD}{A}units:\n{units}")
    assert [fault.message for fault in faults] == [
        "units feed each other in a cycle: u -> w -> v -> u",
        "units feed each other in a cycle: x -> y -> x",
    ]
    assert [place_of(fault) for fault in faults] == [(5, 44), (8, 44)]


def test_a_cycle_through_a_feedback_input_is_none(tmp_path: Path) -> None:
    text = (
        "transformations: [{label: a, inputs: {i: {tag: T, feedback: true}}, outputs: {o: T}}]\n"
        "units: [{id: u, transformation: a, inputs: {i: u/o}}]\n"
    )
    path = tmp_path / "env.yaml"
    path.write_text(HEAD + text)
    assert load(path).environment.unit["u"].feeds["i"][0].unit == "u"


def test_all_faults_of_all_files_and_stages_are_told_at_once_in_order(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text("transformations: [{label: b, labor: -1}]\nhorizon: 3\n")
    (tmp_path / "broken.yaml").write_text("a: [\n")
    text = (
        f"{HEAD}include: [part.yaml, broken.yaml]\n"
        "transformations:\n"
        "  - {label: a, labr: 1, inputs: {i: T}}\n"
        "  - {label: c, inputs: {i: Bad}}\n"
        "  - {label: c, inputs: {i: T}}\n"
        "units:\n"
        "  - {id: u, transformation: c, inputs: {j: u}}\n"
    )
    faults = faults_of(tmp_path, text)
    assert [(Path(str(fault.file)).name, fault.line) for fault in faults] == [
        ("env.yaml", 4),
        ("env.yaml", 5),
        ("env.yaml", 6),
        ("env.yaml", 8),
        ("env.yaml", 8),
        ("part.yaml", 1),
        ("part.yaml", 2),
        ("broken.yaml", 2),
    ]
    assert "move this key to the main file" in str(faults[6])


def test_a_reference_to_a_part_with_faults_is_not_called_dangling(tmp_path: Path) -> None:
    text = f"{HEAD}transformations: [{{label: a, labr: 1}}]\nunits: [{{id: u, transformation: a}}]\n"
    assert only_fault(tmp_path, text).message == "unknown key `labr`"


def test_a_file_that_is_included_twice_is_named_once(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a.yaml").write_text("transformations: [{label: a}]\n")
    fault = only_fault(tmp_path, f"{HEAD}include: [parts, parts/a.yaml]\n")
    assert place_of(fault) == (2, 18)
    assert "is included twice" in fault.message


def test_a_file_that_includes_itself_is_refused(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, f"{HEAD}include: [env.yaml]\n")
    assert ("is this file itself" in fault.message, fault.mend) == (True, "remove this entry")


def test_an_empty_folder_to_include_is_named(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    fault = only_fault(tmp_path, f"{HEAD}include: [parts]\n")
    assert fault.message == "the folder parts has no environment files"


def test_an_empty_file_in_a_folder_to_include_is_named(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a.yaml").write_text("")
    fault = only_fault(tmp_path, f"{HEAD}include: [parts]\n")
    assert (place_of(fault), fault.message) == ((2, 11), "parts/a.yaml: the file is empty")


def test_an_empty_file_in_a_folder_of_xml_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text("")
    with pytest.raises(InputError) as caught:
        load(tmp_path)
    assert [(fault.file, fault.line) for fault in caught.value.faults] == [(str(tmp_path / "a.xml"), None)]


def test_a_number_that_is_too_long_is_shown_cut(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, f"{HEAD}horizon: {'9' * 5000}\n")
    assert (place_of(fault), len(fault.message) < 200) == ((2, 10), True)


def test_a_fault_elsewhere_hides_no_dangling_reference(tmp_path: Path) -> None:
    text = (
        f"{HEAD}max_cost: -1\n"
        "transformations: [{label: a, labor: -1, inputs: {i: A Bad}}, {label: 'b(${NAO})', host: '${'}]\n"
        "units:\n"
        "  - {id: u, transformation: c}\n"
        "  - {id: v, transformation: a}\n"
        "  - {id: w, transformation: b(piff)}\n"
        "targets: [{label: t, topic: /t, tag: Bad, priority: x}]\n"
    )
    assert [fault.message.partition(",")[0] for fault in faults_of(tmp_path, text)] == [
        "-1 is negative",
        "-1 is negative",
        "unknown name Bad",
        "`${` begins no template variable here",
        "there is no transformation `c`",
        "unknown name Bad",
        "this must be a whole number",
    ]


def test_among_many_names_the_close_one_is_found(tmp_path: Path) -> None:
    labels = "".join(f"  - label: step{number}\n" for number in range(1000))
    text = f"{HEAD}transformations:\n{labels}units: [{{id: u, transformation: setp7}}]\n"
    assert only_fault(tmp_path, text).mend == "did you mean `step7`?"


REPEATED = {
    "ontology": ("ontology: [{0}.ttl, {0}.ttl]", "o.ttl"),
    "prefer": ("ontology: {0}.ttl\nprefer: [{0}, {0}]", "o"),
    "include": ("include: [{0}.yaml, {0}.yaml]", "o.yaml"),
    "minimise": ("minimise: [rent, rent]", "rent"),
    "labels of a host": ("hosts: [{{name: h, labels: [{0}, {0}]}}]", "o"),
    "host": ("hosts: [{{name: {0}}}]\ntransformations: [{{label: a, host: [{0}, {0}]}}]", "o"),
    "with": ("transformations: [{{label: a, with: [{0}, {0}]}}]", "o"),
    "conflicts": ("transformations: [{{label: a, conflicts: [{0}, {0}]}}]", "o"),
    "conflicts of the system": ("transformations: [{{label: a, conflicts: {{system: [{0}, {0}]}}}}]", "o"),
    "conflicts of a host": ("transformations: [{{label: a, conflicts: {{host: [{0}, {0}]}}}}]", "o"),
    "topics": (
        "transformations: [{{label: a}}]\nunits: [{{id: a.1, transformation: a, topics: {{x: [{0}, {0}]}}}}]",
        "o",
    ),
}


@pytest.mark.parametrize("text", REPEATED)
def test_a_name_that_is_twice_in_a_list_is_a_fault(text: str, tmp_path: Path) -> None:
    written, name = REPEATED[text]
    faults = faults_of(tmp_path, f"{HEAD}{written.format('o')}\n")
    (fault,) = (fault for fault in faults if "twice" in fault.message)
    assert fault.message == f"`{name}` is written twice in this list"
    assert fault.mend == "remove one of the two"
    assert fault.line == 2 + written.count("\n")


def test_every_list_of_names_has_a_case_above() -> None:
    """A field that is added later and holds a list of texts refuses repeats too, unless it is named here."""
    schema = str(json_schema(EnvironmentPart))
    lists = schema.count("'type': 'array'")
    of_parts = schema.count("'type': 'array'") - schema.count("'uniqueItems': True")
    assert lists - of_parts == len(REPEATED) + 1, "streams that feed an input have words of their own"
    assert of_parts == len(
        {"transformations", "units", "targets", "hosts", "links", "qualities", "between", "points", "point"}
    )


def test_the_two_ends_of_a_link_may_be_the_same(tmp_path: Path) -> None:
    assert faults_of(tmp_path, HEAD + "hosts: [{name: h}, {name: i}]\nlinks: [{between: [h, h]}]\nx: 1\n")[0].key == "x"
