"""Why a target can't be met: the nearest dead end, in words."""

from __future__ import annotations

import json
import pickle
from copy import deepcopy
from itertools import islice

import msgspec
import networkx as nx
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from cfgplan.domain import Environment, InputPort, OutputPort, Similarity, Target, Transformation
from cfgplan.planning import Plan, Problem, Status
from cfgplan.reasons import Providers, assign_different, startable, unmet_reasons
from cfgplan.unmet import Lack, NeededBy, Reason, read_reason, reason_record, shared_reasons
from cfgplan.validity.startable import different_choices_exist


def make(label: str, needs: str, gives: str, distinct: str | None = None) -> Transformation:
    inputs = tuple(InputPort(f"in{i}", tag, distinct=distinct) for i, tag in enumerate(needs))
    return Transformation(label, inputs, tuple(OutputPort(f"out{i}", tag) for i, tag in enumerate(gives)))


def reason(wanted: str, *library: Transformation) -> str | None:
    environment = Environment((), library, (Target("q", wanted, "/q"),))
    return unmet_reasons(Problem(environment, Similarity({tag: frozenset(tag) for tag in "ABCDE"}), 1)).get("q")


def test_a_target_that_can_be_met_has_no_reason() -> None:
    assert reason("B", make("source", "", "A"), make("filter", "A", "B")) is None


def test_a_tag_that_nothing_matches_is_named() -> None:
    assert reason("B", make("source", "", "A")) == "target q wants B, but no output matches"


def test_the_input_without_a_producer_is_named_through_any_number_of_steps() -> None:
    text = reason("C", make("one", "A", "B"), make("two", "B", "C"), make("other", "B", "C"))
    assert text == "target q wants C, but input in0 of one needs A, and no output matches"


def test_circular_support_is_named() -> None:
    text = reason("A", make("left", "B", "A"), make("right", "A", "B"))
    assert text == "target q wants A, but the transformations that offer it are fed only by each other: left, right"


def test_a_distinct_group_with_too_few_feeders_is_named() -> None:
    text = reason("B", make("source", "", "A"), make("fusion", "AA", "B", distinct="g"))
    assert text is not None
    assert "inputs in0 and in1 of fusion need different transformations, and there are too few" in text


def test_a_distinct_group_whose_feeders_can_not_be_fed_is_named() -> None:
    text = reason("B", make("source", "", "A"), make("relay", "B", "A"), make("fusion", "AA", "B", distinct="g"))
    assert text is not None
    assert "inputs in0 and in1 of fusion need different transformations, and too few can be fed" in text


def test_a_feedback_input_may_be_fed_by_what_it_feeds_but_must_be_fed() -> None:
    tracker = Transformation("tracker", (InputPort("old", "B", feedback=True),), (OutputPort("out", "B"),))
    lonely = Transformation("lonely", (InputPort("old", "C", feedback=True),), (OutputPort("out", "B"),))
    assert reason("B", tracker) is None
    assert reason("B", lonely) == "target q wants B, but input old of lonely needs C, and no output matches"


def test_what_can_be_started_is_found_in_any_order_of_labels() -> None:
    chain = [make(label, needs, gives) for label, needs, gives in (("z", "", "A"), ("y", "A", "B"), ("x", "B", "C"))]
    environment = Environment(library=(*chain, make("w", "CD", "E")))
    providers = Providers(environment.library, Similarity({tag: frozenset(tag) for tag in "ABCDE"}))
    assert startable(environment, providers) == {"x", "y", "z"}


def test_what_waits_for_several_inputs_is_started_when_the_last_of_them_is_fed() -> None:
    last = [make("a", "BCD", "E"), make("b", "DCA", "B"), make("c", "A", "C"), make("d", "AC", "D"), make("e", "", "A")]
    environment = Environment(library=tuple(last))
    providers = Providers(environment.library, Similarity({tag: frozenset(tag) for tag in "ABCDE"}))
    assert startable(environment, providers) == {"a", "b", "c", "d", "e"}
    assert providers.among({"a", "c"}).of("E") == providers.of("E") == ("a",)
    assert providers.among({"a", "c"}).of("A") == ()


def test_fusions_that_rest_on_each_other_are_started_when_both_feeders_of_one_are_there() -> None:
    library = (
        make("one", "", "A"),
        make("two", "", "A"),
        make("near", "AA", "B", distinct="g"),
        make("relay", "B", "B"),
        make("far", "BB", "C", distinct="g"),
        make("never", "CC", "D", distinct="g"),
    )
    environment = Environment(library=library)
    providers = Providers(environment.library, Similarity({tag: frozenset(tag) for tag in "ABCDE"}))
    assert startable(environment, providers) == {"one", "two", "near", "relay", "far"}


@given(st.dictionaries(st.sampled_from("pqrstu"), st.lists(st.sampled_from("abcdef"), unique=True)))
def test_feeders_are_assigned_where_a_matching_covers_all_ports(choices: dict[str, list[str]]) -> None:
    edges = [(port, label) for port, labels in choices.items() for label in labels]
    graph = nx.Graph(edges)
    graph.add_nodes_from(choices)
    covered = nx.bipartite.hopcroft_karp_matching(graph, top_nodes=choices)
    found = assign_different(choices)
    assert (found is not None) == all(port in covered for port in choices)
    assert different_choices_exist({port: set(labels) for port, labels in choices.items()}) == (found is not None)
    if found is not None:
        assert len(set(found.values())) == len(found)
        assert all(found[port] in labels for port, labels in choices.items())


def test_an_input_keeps_its_feeder_while_another_one_has_a_free_choice() -> None:
    choices = {"p": ["a", "b"], "q": ["a", "b", "c"], "r": ["a"]}
    assert assign_different(dict(islice(choices.items(), 2))) == {"p": "a", "q": "b"}
    assert assign_different(choices) == {"p": "b", "q": "c", "r": "a"}


def test_thousands_of_inputs_may_have_to_be_fed_anew() -> None:
    number = 5_000
    choices = {f"p{n}": [f"f{n}", f"f{n + 1}"] for n in range(number)}
    choices["last"] = ["f0"]
    expected = {"last": "f0", **{f"p{n}": f"f{n + 1}" for n in range(number)}}
    assert assign_different(choices) == expected
    assert different_choices_exist({port: set(labels) for port, labels in choices.items()})


def omitting(wanted: str, omitted: dict[str, str], *library: Transformation) -> Reason | None:
    environment = Environment((), library, (Target("q", wanted, "/q"),)).omitting(omitted)
    return unmet_reasons(Problem(environment, Similarity({tag: frozenset(tag) for tag in "ABCDE"}), 1)).get("q")


def test_a_reason_names_the_omitted_transformations_that_a_target_lacks_and_why() -> None:
    night, murky = "night is true", "visibility is 1 m"
    library = make("eye", "", "A"), make("sonar", "", "A"), make("map", "A", "B"), make("drive", "B", "C")
    left_out = "but needs transformations that are left out for now:"
    assert omitting("C", {"eye": night}, *library) is None
    both = omitting("C", {"eye": night, "sonar": murky}, *library)
    assert both == f"target q wants C, {left_out} eye ({night}), sonar ({murky})"
    assert omitting("A", {"eye": night}, library[0]) == f"target q wants A, {left_out} eye ({night})"
    assert omitting("C", {"eye": night, "drive": murky}, *library) == f"target q wants C, {left_out} drive ({murky})"


def test_transformations_that_were_omitted_before_are_named_too() -> None:
    environment = Environment((), (make("eye", "", "A"), make("sonar", "", "A")), (Target("q", "A", "/q"),))
    environment = environment.omitting({"eye": "it is night"}).omitting({"sonar": "it is murky"})
    (text,) = unmet_reasons(Problem(environment, Similarity({"A": frozenset("A")}), 1)).values()
    assert text.endswith("left out for now: eye (it is night), sonar (it is murky)")


def test_omitted_transformations_that_could_not_be_fed_either_are_no_reason() -> None:
    text = omitting("B", {"map": "night is true"}, make("map", "A", "B"), make("other", "D", "B"))
    assert text == "target q wants B, but input in0 of map needs A, and no output matches"


def test_omitted_members_of_a_distinct_group_are_named() -> None:
    fusion = make("fusion", "AA", "B", distinct="g")
    text = omitting("B", {"eye": "night is true"}, make("eye", "", "A"), make("sonar", "", "A"), fusion)
    assert text == "target q wants B, but needs transformations that are left out for now: eye (night is true)"


def test_an_omitted_transformation_that_a_target_wants_to_run_is_named() -> None:
    environment = Environment((), (make("eye", "", "A"),), (Target("q", run="eye"),)).omitting({"eye": "it is night"})
    (text,) = unmet_reasons(Problem(environment, Similarity({}), 1)).values()
    assert text.endswith("but needs transformations that are left out for now: eye (it is night)")


@given(st.sets(st.sampled_from("abcdef"), min_size=1), st.lists(st.sampled_from(["", "A", "B", "AB"]), min_size=6))
def test_with_the_named_transformations_nothing_or_other_ones_are_lacking(gone: set[str], needs: list[str]) -> None:
    library = [make(label, need, give) for label, need, give in zip("abcdef", needs, "ABABCC", strict=False)]
    reason = omitting("C", dict.fromkeys(gone, "now"), *library)
    if reason is not None and reason.lack.left_out:
        named = {label for label, _ in reason.lack.left_out}
        assert named <= gone
        assert named
        assert omitting("C", dict.fromkeys(gone - named, "now"), *library) != reason
    elif reason is not None:
        assert omitting("C", {}, *library) == reason


def texts(reasons: dict[str, str], most: int = 9) -> list[str]:
    return [shared.text for shared in shared_reasons(reasons, most)]


def reasons_of(library: list[Transformation], omitted: dict[str, str], wanted: str) -> dict[str, str]:
    targets = tuple(Target(f"t{number}", tag, f"/{number}") for number, tag in enumerate(wanted))
    environment = Environment((), tuple(library), targets).omitting(omitted)
    return unmet_reasons(Problem(environment, Similarity({tag: frozenset(tag) for tag in "ABCDE"}), 1))


def test_a_tag_that_nothing_matches_is_told_once_with_all_inputs_and_targets() -> None:
    library = [make("one", "A", "B"), make("two", "A", "C"), make("three", "C", "D")]
    unmatched, wanted = texts(reasons_of(library, {}, "BBCDEE"))
    leads, inputs = "targets t0, t1 want B, target t2 wants C, target t3 wants D", "input in0 of one, input in0 of two"
    assert unmatched == f"{leads}, but {inputs} need A, and no output matches"
    assert wanted == "targets t4, t5 want E, but no output matches"


def test_a_cause_of_omitted_transformations_is_told_once_with_all_of_them() -> None:
    library = [make("eye", "", "A"), make("ear", "", "B"), make("nose", "", "C"), make("both", "AB", "D")]
    night = "env.py:1:8: it imports night, which is not there"
    found = reasons_of(library, {"eye": night, "ear": night, "nose": "it is cold"}, "ABCD")
    assert found["t3"].endswith(f"left out for now: ear, eye ({night})")
    assert texts({label: found[label] for label in ("t0", "t1", "t2")}) == [
        f"target t0 wants A, target t1 wants B, but need transformations that are left out for now: eye, ear ({night})",
        "target t2 wants C, but needs transformations that are left out for now: nose (it is cold)",
    ]


def test_a_name_with_the_words_of_a_reason_is_told_as_it_is() -> None:
    """The target `who wants A` was told as `who`, which wants something else."""
    labels = ("who wants A", "b")
    (told,) = shared_reasons({label: Reason(Lack("time ran out"), label, "B") for label in labels})
    assert (told.labels, told.text) == (labels, "targets who wants A, b want B, but time ran out")


def test_reasons_of_other_kinds_are_shared_as_they_are() -> None:
    late = {label: Reason(Lack("time ran out"), label, "A") for label in "xy"}
    (told,) = shared_reasons(late)
    assert (told.labels, told.text, told.names_them) == (("x", "y"), "targets x, y want A, but time ran out", True)
    (gone,) = shared_reasons(dict.fromkeys("xy", "its host r1 is gone"))
    assert (gone.labels, gone.text, gone.names_them) == (("x", "y"), "its host r1 is gone", False)
    many = {label: Reason(Lack("time ran out"), label, "A") for label in ("t0", "t1", "t2", "t3", "t4")}
    assert texts(many, 2) == ["targets t0, t1 and 3 more want A, but time ran out"]
    failing = {label: Reason(Lack("would have no stream if host r1 fails"), label) for label in "xy"}
    assert texts(failing) == ["targets x, y would have no stream if host r1 fails"]
    slow = {label: Reason(Lack("the best is 7 ms"), label, "delay of at most 5 ms", verb="asks for") for label in "xy"}
    assert texts(slow) == ["targets x, y ask for delay of at most 5 ms, but the best is 7 ms"]


def test_reasons_that_differ_in_any_part_share_no_sentence() -> None:
    late = Lack("time ran out")
    parts = [
        (Reason(late, "x", "A"), Reason(late, "y", "A", verb="asks for")),
        (Reason(late, "x", "A"), Reason(late, "y", "A", noun="feature")),
        (Reason(late, "x", "A"), Reason(late, "y")),
        (Reason(late, "x", "A"), Reason(late, "y", "A").noted(" (left out for now: eye)")),
        (Reason(late, "x", "A"), Reason(late, "x", "A")),
        (Reason(Lack("no", "A", NeededBy("one", "in")), "x"), Reason(Lack("no", "B", NeededBy("one", "in")), "y")),
        (Reason(Lack(left_out=(("eye", "night"),)), "x"), Reason(Lack(left_out=(("eye", "noise"),)), "y")),
    ]
    for first, second in parts:
        assert texts({"x": first, "y": second}) == [str(first), str(second)]


def test_a_text_that_only_looks_like_a_reason_is_told_as_it_is() -> None:
    """Sentences were taken apart: a planner's own words became the parts of another sentence."""
    own = {label: f"target {label} wants A, but input one of two needs B, and no output matches" for label in "xy"}
    assert texts(own) == [*own.values()]


def test_words_of_a_reason_in_tags_and_causes_change_nothing() -> None:
    """Causes and names with these words were cut: `night (left`, and `out)` as another cause."""
    cause = "it needs b, and no output matches (left out for now: c, d"
    library = [make("eye (old)", "", "A"), make("ear, but", "", "B")]
    (told,) = texts(reasons_of(library, dict.fromkeys(("eye (old)", "ear, but"), cause), "AB"))
    lead = "target t0 wants A, target t1 wants B, but need transformations that are left out for now"
    assert told == f"{lead}: eye (old), ear, but ({cause})"


REASONS = [
    Reason(Lack("no output matches", "A", NeededBy("one", "in0")), "q", "B"),
    Reason(Lack(left_out=(("eye", "it is night"), ("ear", "it is loud"))), "q", "B", noun="feature"),
    Reason(Lack("the best is 7 ms", note=" (for now)"), "q", "delay of at most 5 ms", verb="asks for"),
    Reason(Lack("would have no unit"), "q"),
    Reason(Lack("its host r1 is gone")),
]


@pytest.mark.parametrize("whole", REASONS, ids=str)
def test_a_reason_stays_whole_in_plans_copies_other_processes_and_records(whole: Reason) -> None:
    plan = Plan("own", Status.INFEASIBLE, reasons={"q": whole})
    ways = (plan.reasons["q"], pickle.loads(pickle.dumps(plan)).reasons["q"], deepcopy(whole))
    record = json.loads(json.dumps(reason_record(whole)))
    for kept in (*ways, read_reason(record)):
        assert kept == str(whole)
        assert reason_record(kept) == reason_record(whole) == record


def test_only_a_reason_with_a_subject_gets_another_one() -> None:
    assert (
        REASONS[0].about("feature", "near")
        == "feature near wants B, but input in0 of one needs A, and no output matches"
    )
    assert REASONS[-1].about("feature", "near") == "its host r1 is gone"


def test_the_fault_of_a_reason_is_a_sentence_by_itself() -> None:
    assert [reason.fault for reason in REASONS] == [
        "input in0 of one needs A, and no output matches",
        str(REASONS[1]),
        "the best is 7 ms (for now)",
        "target q would have no unit",
        "its host r1 is gone",
    ]


def test_words_at_the_end_of_a_reason_follow_each_other() -> None:
    assert Reason(Lack("time ran out"), "q", "A").noted(" (once)").noted(" (twice)").endswith("ran out (once) (twice)")


def test_a_sentence_about_many_targets_names_as_many_left_out_transformations_and_three_causes() -> None:
    labels = [f"eye{n}" for n in range(5)]
    night = {label: Reason(Lack(left_out=((label, "it is night"),)), label, "A") for label in labels}
    (told,) = shared_reasons(night)
    assert (told.text.endswith("eye0, eye1, eye2, eye3, eye4 (it is night)"), told.left_out) == (True, {*labels})
    (one,) = shared_reasons({"q": Reason(Lack(left_out=tuple((label, f"of {label}") for label in labels)), "q", "A")})
    assert one.text.endswith("eye0 (of eye0), eye1 (of eye1), eye2 (of eye2) and 2 more")
    assert one.left_out == {"eye0", "eye1", "eye2"}


def test_a_writer_that_knows_only_plain_texts_takes_the_reasons_of_a_plan_as_such() -> None:
    """msgspec and YAML's safe writer refuse a subclass of str; the page on Python says so."""
    plan = Plan("own", Status.INFEASIBLE, reasons={"q": REASONS[0]})
    written = msgspec.json.decode(msgspec.json.encode(plan, enc_hook=str))
    assert written["reasons"] == {"q": str(REASONS[0])}
    assert yaml.safe_load(yaml.safe_dump({name: str(why) for name, why in plan.reasons.items()})) == plan.reasons


def test_the_left_out_transformations_that_a_sentence_names_are_known() -> None:
    labels = [f"eye{n}" for n in range(5)]
    reasons = reasons_of([make(label, "", "A") for label in labels], dict.fromkeys(labels, "it is night"), "A")
    (told,) = shared_reasons(reasons)
    assert told.text.endswith("eye0, eye1, eye2 and 2 more (it is night)")
    assert told.left_out == {"eye0", "eye1", "eye2"}


@given(
    st.sets(st.sampled_from("abcdef")),
    st.lists(st.sampled_from(["", "A", "B", "AB", "E"]), min_size=6),
    st.text("ABCDE", min_size=1, max_size=8),
)
def test_each_target_is_told_of_once_and_each_fault_too(gone: set[str], needs: list[str], wanted: str) -> None:
    library = [make(label, need, give) for label, need, give in zip("abcdef", needs, "ABABCD", strict=False)]
    reasons = reasons_of(library, dict.fromkeys(sorted(gone), "it is night"), wanted)
    told = shared_reasons(reasons)
    assert sorted(label for shared in told for label in shared.labels) == sorted(reasons)
    assert sum("night" in shared.text for shared in told) <= 1
    for shared in told:
        assert shared.text == reasons[shared.labels[0]] or len(shared.labels) > 1
        assert all(label in shared.text for label in shared.labels)
    unmatched = [shared.text.partition("need")[2] for shared in told if "need" in shared.text]
    missing = [text.lstrip("s ") for text in unmatched if text.endswith(" and no output matches")]
    assert len(missing) == len({*missing})
