"""Templates in transformations and targets: what they stand for and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from loading import faults_of, load, load_text, only_fault, place_of

from cfgplan.formats.dump import dump_yaml, plain_environment
from cfgplan.formats.templates import escaped, original_column, substitute

HEAD = "format: cfgplan/1\ntransformations:\n"


def test_a_variable_stands_for_every_individual_everywhere_in_a_transformation(tmp_path: Path) -> None:
    text = HEAD + (
        "  - label: cam(${NAO})\n    source: units.py:Cam\n    host: ${NAO}\n    kind: kind-${NAO}\n"
        "    params: {name: '${NAO}', list: [{'${NAO}': 'a ${NAO} b'}]}\n"
        "    inputs: {'in_${NAO}': {tag: 'T ${NAO}', distinct: 'g ${NAO}'}}\n    outputs: {out: 'some {${NAO}}'}\n"
    )
    piff, puff = load_text(tmp_path, text).environment.library
    assert (piff.label, puff.label) == ("cam(piff)", "cam(puff)")
    assert (piff.host, piff.kind) == ("piff", "kind-piff")
    assert piff.params == {"name": "piff", "list": [{"piff": "a piff b"}]}
    (port,) = puff.inputs
    assert (port.name, port.tag, port.distinct) == ("in_puff", "T puff", "g puff")
    assert piff.output["out"].tag == "some {piff}"


def test_several_variables_give_the_product(tmp_path: Path) -> None:
    text = HEAD + "  - label: link(${NAO:a}, ${NAO:b}, ${Room})\n    host: ${NAO:b}\n"
    library = load_text(tmp_path, text).environment.library
    assert len(library) == 2 * 2 * 3
    assert {t.host for t in library if t.label.startswith("link(piff, puff")} == {"puff"}


def test_one_variable_has_one_value_in_a_transformation(tmp_path: Path) -> None:
    text = HEAD + "  - {label: '${NAO} and ${NAO}'}\n"
    assert [t.label for t in load_text(tmp_path, text).environment.library] == ["piff and piff", "puff and puff"]


def test_two_dollars_escape_a_template(tmp_path: Path) -> None:
    text = HEAD + "  - {label: a, params: {path: '$${HOME}/x', price: 5$}}\n"
    assert load_text(tmp_path, text).environment.library[0].params == {"path": "${HOME}/x", "price": "5$"}


def test_a_variable_that_the_label_does_not_mention_is_refused(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, HEAD + "  - label: cam\n    host: ${NAO}\n")
    assert (fault.message, place_of(fault)) == ("the label does not mention ${NAO}", (3, 12))
    assert fault.mend == "add it, such as `label: cam(${NAO})`"


def test_expansions_that_meet_another_label_are_refused(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, HEAD + "  - label: cam(${NAO})\n  - label: cam(puff)\n")
    assert place_of(fault) == (4, 12)
    assert "`cam(puff)` is taken" in fault.message
    assert "line 3" in fault.message


def test_expansions_with_one_label_are_refused(tmp_path: Path) -> None:
    (tmp_path / "env.yaml").write_text(HEAD + "  - label: ${Pair:a}${Pair:b}\n")

    from loading import SmallVocabulary

    from cfgplan.errors import InputError
    from cfgplan.formats.assembly import build
    from cfgplan.formats.document import read_document

    class Ambiguous(SmallVocabulary):
        def instances(self, _class_name: str) -> tuple[str, ...]:
            return ("x", "xx")

    try:
        build(read_document(tmp_path / "env.yaml"), Ambiguous())
    except InputError as error:
        (fault,) = error.faults
        assert fault.message == "several expansions of this template have the label `xxx`"
    else:
        raise AssertionError("x + xx and xx + x are one label")


def test_a_template_over_an_empty_class_is_refused(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, HEAD + "  - label: cam ${Nothing}\n")
    assert (fault.message, place_of(fault)) == ("the class Nothing has no individuals", (3, 16))


def test_a_template_without_expansions_still_has_its_plain_tags_checked(tmp_path: Path) -> None:
    text = HEAD + "  - label: cam ${Nothing}\n    outputs: {a: 'T Bad', b: {tag: '${Nothing} Bad'}}\n"
    assert [place_of(fault) for fault in faults_of(tmp_path, text)] == [(3, 16), (4, 21)]


def test_a_template_over_an_unknown_class_is_refused(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, HEAD + "  - label: cam(${NOA})\n    host: ${NOA}\n")
    assert (fault.message, place_of(fault), fault.mend) == ("no class NOA", (3, 16), "did you mean `NAO`?")


def test_what_begins_no_variable_is_refused_at_its_column(tmp_path: Path) -> None:
    for text in ("a ${NAO", "a ${}", "a ${N O}", "a ${NAO:x:y}", "a ${:x}"):
        fault = only_fault(tmp_path, HEAD + f"  - label: '{text}'\n")
        assert place_of(fault) == (3, 15)
        assert fault.mend == "write ${Class}, ${Class:name}, or $${ for a plain ${"


def test_port_names_that_become_one_are_refused(tmp_path: Path) -> None:
    text = HEAD + "  - label: l(${NAO:a}, ${NAO:b})\n    inputs: {'${NAO:a}': T, '${NAO:b}': T}\n"
    fault = faults_of(tmp_path, text)[0]
    assert place_of(fault) == (4, 29)
    assert "the port name `piff` is taken" in fault.message


def test_a_bad_tag_of_an_expansion_is_named_once_at_its_place_in_the_template(tmp_path: Path) -> None:
    text = HEAD + "  - label: cam(${NAO})\n    outputs: {out: 'some {${NAO}} and Bad'}\n"
    fault = only_fault(tmp_path, text)
    assert place_of(fault) == (4, 21 + len("some {${NAO}} and "))
    assert fault.message == "unknown name Bad, in the expansion 'some {piff} and Bad'"


def test_a_template_that_stands_for_too_many_is_refused(tmp_path: Path) -> None:
    label = "".join(f"${{Room:v{number}}}" for number in range(13))
    fault = only_fault(tmp_path, HEAD + f"  - label: {label}\n")
    assert "1,594,323 transformations" in fault.message


WANTED = "format: cfgplan/1\ntargets:\n"


def test_a_target_with_a_variable_stands_for_one_of_each_individual(tmp_path: Path) -> None:
    text = WANTED + "  - {label: '${NAO} in ${Room}', topic: '/${Room}/${NAO}', tag: 'T and {${NAO}}', priority: 2}\n"
    targets = load_text(tmp_path, text).environment.targets
    assert len(targets) == 6
    assert (targets[0].label, targets[0].topic, targets[0].tag) == ("piff in r1", "/r1/piff", "T and {piff}")
    assert {target.priority for target in targets} == {2}


def test_a_target_may_want_the_transformations_of_a_template_to_run(tmp_path: Path) -> None:
    text = HEAD + "  - label: cam(${NAO})\ntargets:\n  - {label: 'film ${NAO}', run: 'cam(${NAO})'}\n"
    assert [target.run for target in load_text(tmp_path, text).environment.targets] == ["cam(piff)", "cam(puff)"]


def test_what_is_wrong_with_a_template_of_targets_is_told_at_its_place(tmp_path: Path) -> None:
    fault = only_fault(tmp_path, WANTED + "  - {label: a, topic: '/${NAO}', tag: T}\n")
    assert (fault.message, place_of(fault)) == ("the label does not mention ${NAO}", (3, 13))
    fault = only_fault(tmp_path, WANTED + "  - {label: 'a ${NAO}', topic: /a, tag: T}\n")
    assert fault.message == "several expansions of this template have the topic `/a`"
    fault = only_fault(tmp_path, WANTED + "  - {label: 'a ${NAO}', topic: '/${NAO}', tag: '{${NAO}} and Bad'}\n")
    assert fault.message == "unknown name Bad, in the expansion '{piff} and Bad'"
    fault = only_fault(tmp_path, WANTED + "  - {label: 'a ${Nothing}', topic: '/${Nothing}', tag: T}\n")
    assert fault.message == "the class Nothing has no individuals"
    places = [place_of(one) for one in faults_of(tmp_path, WANTED + "  - {label: 'a ${NAO', topic: /a, tag: Bad}\n")]
    assert places == [(3, 16), (3, 40)]


def test_a_target_with_a_dollar_and_a_brace_is_written_so_that_it_is_read_again(tmp_path: Path) -> None:
    environment = load_text(tmp_path, WANTED + "  - {label: 'a $${NAO}', topic: '/$${x', tag: T}\n").environment
    assert (environment.targets[0].label, environment.targets[0].topic) == ("a ${NAO}", "/${x")
    (tmp_path / "again.yaml").write_text(dump_yaml(plain_environment(environment, horizon_s=60)))
    assert load(tmp_path / "again.yaml").environment.targets == environment.targets


@given(st.text(alphabet="${}a:"))
def test_escaping_hides_every_template(text: str) -> None:
    assert substitute(escaped(text), {}) == text


@given(
    st.lists(st.sampled_from(["${A}", "${B:x}", "$${", "x", "yy"])),
    st.text(alphabet="ab", max_size=3),
    st.text(alphabet="ab", max_size=3),
    st.integers(1, 30),
)
def test_a_column_of_an_expansion_leads_back_to_the_same_character(
    segments: list[str], first: str, second: str, column: int
) -> None:
    template = "".join(segments)
    values = {("A", ""): first, ("B", "x"): second}
    expansion = substitute(template, values)
    if column > len(expansion) or expansion[column - 1] not in "xy":
        return
    assert template[original_column(template, values, column) - 1] == expansion[column - 1]
