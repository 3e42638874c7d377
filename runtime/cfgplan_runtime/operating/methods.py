"""The control protocol's methods: reading a manager's state, and requesting changes of it."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, Protocol, TypeVar

import msgspec

from cfgplan import answers
from cfgplan.domain import Stream
from cfgplan.errors import CfgplanError, InputError, did_you_mean
from cfgplan.explaining.why_words import why_lines
from cfgplan.formats.plan_file import read_run_plan
from cfgplan_runtime.children.messages import Flow
from cfgplan_runtime.lifecycle import changes
from cfgplan_runtime.lifecycle.basis import Preview, plan_text, previewed
from cfgplan_runtime.lifecycle.deliberation import Findings
from cfgplan_runtime.lifecycle.reports import Review, Snapshot
from cfgplan_runtime.lifecycle.review_sentences import preview_sentence, supposed_sentence, unmet_says
from cfgplan_runtime.operating.control_server import Method
from cfgplan_runtime.operating.declaration import Declared, declaration
from cfgplan_runtime.operating.flows import Flows
from cfgplan_runtime.operating.moments import MOMENTS_KEPT, Moments
from cfgplan_runtime.operating.past import Past
from cfgplan_runtime.operating.printed import Printed
from cfgplan_runtime.operating.protocol import Record, RefusedError
from cfgplan_runtime.operating.records import change_record, plain, review_record, snapshot_record, wired
from cfgplan_runtime.operating.stream_rates import StreamRates
from cfgplan_runtime.operating.taps import LeasedTaps

REQUEST_PATIENCE_S = 60.0
"""Seconds that a reply waits for the review of a change."""
LONGEST_WAIT_S = 1_000_000
_WHY_S = 10.0
"""Seconds within which the next best plan must be found."""

T = TypeVar("T")


class Controlled(Protocol):
    """A manager, as its operators use it."""

    def request(self, change: changes.Change) -> Future[Review | None]: ...

    def preview(self) -> Future[Preview]: ...

    def suppose(self, change: changes.Change) -> Findings: ...

    def snapshot(self) -> Snapshot: ...


_ONE_NAME: Mapping[str, tuple[str, Callable[[str], changes.Change]]] = MappingProxyType(
    {
        "withdraw": ("name", changes.Withdraw),
        "remove_target": ("label", lambda label: changes.Remove(targets=(label,))),
        "remove_transformation": ("label", lambda label: changes.Remove(transformations=(label,))),
        "remove_individual": ("name", lambda name: changes.Remove(individuals=(name,))),
        "restore": ("name", lambda name: changes.Restore((name,))),
        "kill": ("unit", changes.KillUnit),
        "restart": ("unit", lambda unit: changes.RestartUnits((unit,), "the control socket")),
        "lose_host": ("host", lambda host: changes.LoseHost(host, "told through the control socket")),
        "regain_host": ("host", changes.RegainHost),
    }
)
"""The methods that have one parameter: its key, and the change for its value."""


class Methods:
    """The methods of a manager by name.

    `flows` gives rate and latency by topic, `rates` the rate of each output of a unit, `printed` what units have
    printed, `past` the last events, and `moments` the states after reviews. Without `taps`, only streams that are on
    topics can be looked at.
    """

    def __init__(
        self,
        manager: Controlled,
        flows: Flows | None = None,
        printed: Printed | None = None,
        past: Past | None = None,
        rates: StreamRates | None = None,
        taps: LeasedTaps | None = None,
        moments: Moments | None = None,
    ) -> None:
        self._manager = manager
        self._flows = flows or Flows()
        self._printed = printed or Printed()
        self._past = past or Past()
        self._rates = rates or StreamRates()
        self._taps = taps
        self._moments = moments

    def by_name(self) -> dict[str, Method]:
        """The methods for the control server; `cfgplan/manual/control.md` has their params and results."""
        return {
            "state": self._state,
            "add": self._add,
            "fact": self._fact,
            "review": self._review,
            "plan": self._plan,
            "apply": self._apply,
            "why": self._why,
            "logs": self._logs,
            "events": self._events,
            "topics": self._topics,
            "tap": self._tap,
            "what_if": self._what_if,
            "stop": self._stop,
            **{name: self._changing(key, change) for name, (key, change) in _ONE_NAME.items()},
        }

    def _state(self, params: Mapping[str, Any]) -> Record:
        _only(params, "review")
        if "review" in params:
            return self._state_after(params["review"])
        crossings = self._flows.crossing_records()
        snapshot = self._manager.snapshot()
        flows = self._rates.of_topics(self._flows, snapshot.targets)
        return {**snapshot_record(snapshot, flows), "crossings": crossings}

    def _state_after(self, review: object) -> Record:
        if isinstance(review, bool) or not isinstance(review, int):
            raise RefusedError("bad_params", "`review` is not the number of a review", "give the `number` of one")
        moment = None if self._moments is None else self._moments.after(review)
        if moment is None:
            mend = f"the last {MOMENTS_KEPT} reviews can be seen again"
            raise RefusedError("refused", f"the state after review {review} is not kept", mend)
        return {**snapshot_record(*moment), "crossings": []}

    def _add(self, params: Mapping[str, Any]) -> Record:
        _only(params, "name", "text", "wait_s", "while_connected")
        if not isinstance(params.get("while_connected", False), bool):
            raise RefusedError("bad_params", "`while_connected` is neither true nor false", "write true or false")
        declared = self._declared(params)
        with _placed_in(declared):
            return {"name": declared.change.name, **self._ask(declared.change, params)}

    def _declared(self, params: Mapping[str, Any]) -> Declared:
        try:
            return declaration(_text(params, "name", self._free_name()), _text(params, "text"))
        except InputError as error:
            raise _refusal(error) from None

    def _free_name(self) -> str:
        taken = self._manager.snapshot().declared
        return next(name for number in itertools.count(1) if (name := f"addition-{number}") not in taken)

    def _fact(self, params: Mapping[str, Any]) -> Record:
        _only(params, "name", "value", "wait_s")
        return self._ask(changes.SetFact(_text(params, "name"), _text(params, "value")), params)

    def _review(self, params: Mapping[str, Any]) -> Record:
        _only(params, "wait_s")
        return self._ask(changes.ReviewNow("the control socket"), params)

    def _plan(self, params: Mapping[str, Any]) -> Record:
        _only(params, "wait_s")
        try:
            preview = _waited_for(self._manager.preview(), params)
        except FutureTimeoutError:
            mend = "wait longer, or ask again when the reviews are over"
            raise RefusedError("busy", "no plan was made in time", mend) from None
        findings = preview.findings
        return {
            "plan": json.loads(plan_text(preview)),
            "says": preview_sentence(findings),
            "unmet": plain(findings.unmet),
            "unmet_says": unmet_says(findings.unmet),
            "running": [wired(unit) for unit in findings.running.units],
        }

    def _why(self, params: Mapping[str, Any]) -> Record:
        _only(params, "unit", "wait_s")
        unit = _text(params, "unit")
        try:
            preview = _waited_for(self._manager.preview(), params)
        except FutureTimeoutError:
            raise RefusedError("busy", "no plan was made in time", "ask again when the reviews are over") from None
        if preview.findings.change_set is None:
            raise RefusedError("refused", f"there is no plan to ask about: {preview.findings.cause}")
        try:
            why = answers.why(preview.problem, previewed(preview), "unit", unit, time_limit_s=_WHY_S)
        except CfgplanError as error:
            raise _refusal(error) from None
        return {"says": list(why_lines(why))}

    def _logs(self, params: Mapping[str, Any]) -> Record:
        _only(params, "unit", "after")
        name, after = _text(params, "unit"), params.get("after", 0)
        if isinstance(after, bool) or not isinstance(after, int) or after < 0:
            raise RefusedError(
                "bad_params", "`after` is not the number of a line", "give the `number` of the last one, or 0"
            )
        lines = self._printed.lines(name, after)
        if not lines and not after:
            known = sorted(
                {text for unit in self._manager.snapshot().units for text in (unit.unit.id, unit.unit.transformation)}
            )
            if name not in known:
                listed = f"there is {', '.join(known)}" if known else "none runs"
                raise RefusedError("refused", f"no unit {name!r} runs, and none has printed anything", listed)
        return {"lines": [line.record() for line in lines]}

    def _events(self, params: Mapping[str, Any]) -> Record:
        _only(params, "last", "since_s")
        last, since_s = params.get("last"), params.get("since_s")
        if last is not None and (isinstance(last, bool) or not isinstance(last, int) or last < 0):
            raise RefusedError("bad_params", "`last` is not a number of events", "give a whole number, or none")
        if since_s is not None and (isinstance(since_s, bool) or not isinstance(since_s, int | float) or since_s < 0):
            raise RefusedError("bad_params", "`since_s` is not a number of seconds", "give a number from 0 on, or none")
        return {"events": self._past.events(last, since_s)}

    def _topics(self, params: Mapping[str, Any]) -> Record:
        _only(params)
        targets = self._manager.snapshot().targets
        flows = self._rates.of_topics(self._flows, targets)
        by_topic = {target.topic: target for target in targets if target.topic}
        topics = [
            {
                "topic": topic,
                "target": target.label,
                "stream": None if target.stream is None else str(target.stream),
                **flows.get(topic, msgspec.structs.asdict(Flow())),
            }
            for topic, target in sorted(by_topic.items())
        ]
        return {"topics": topics, "streams": self._rates.records()}

    def _tap(self, params: Mapping[str, Any]) -> Record:
        _only(params, "stream")
        text, snapshot = _text(params, "stream"), self._manager.snapshot()
        by_topic = {target.topic: target for target in snapshot.targets if target.topic}
        if text in by_topic:
            if self._taps is None or self._taps.is_shown(text):
                return {"topic": text}
            stream = by_topic[text].stream
            if stream is None:
                raise RefusedError("refused", f"nothing feeds {text}", by_topic[text].reason or None)
            text = str(stream)
        elif text.startswith("/"):
            raise RefusedError("refused", f"nothing publishes topic {text!r}", did_you_mean(text, by_topic))
        running = [view.unit for view in snapshot.units if not view.unit.standby]
        library = snapshot.environment.transformation
        given = {
            str(Stream(unit.id, port.name))
            for unit in running
            if unit.transformation in library
            for port in library[unit.transformation].outputs
        }
        topics = {str(Stream(unit.id, one.port)): one.topic for unit in running for one in unit.publications}
        if text in topics and (self._taps is None or self._taps.is_shown(topics[text])):
            return {"topic": topics[text]}
        if text not in given:
            mend = did_you_mean(text, {*given, *by_topic})
            raise RefusedError("refused", f"no unit that runs gives {text!r}", mend)
        if self._taps is None:
            mend = "give it a target, whose topic can be looked at"
            raise RefusedError("refused", f"{text} is on no topic, and this run has no taps", mend)
        return {"topic": self._taps.renew(Stream.parse(text))}

    def _what_if(self, params: Mapping[str, Any]) -> Record:
        _only(params, "change", "params")
        method, asked = _text(params, "change"), params.get("params")
        if not isinstance(asked, Mapping):
            raise RefusedError("bad_params", "`params` is missing or no mapping", "give the params of the method")
        if method == "add":
            _only(asked, "name", "text")
            declared = self._declared(asked)
            with _placed_in(declared):
                return self._supposed(declared.change)
        if method not in _ONE_NAME:
            known = ", ".join(sorted({"add", *_ONE_NAME}))
            raise RefusedError(
                "bad_params", f"there is no change {method!r} that can be supposed", f"give one of {known}"
            )
        key, change = _ONE_NAME[method]
        _only(asked, key)
        return self._supposed(change(_text(asked, key)))

    def _supposed(self, change: changes.Change) -> Record:
        snapshot = self._manager.snapshot()
        try:
            findings = self._manager.suppose(change)
        except CfgplanError as error:
            raise _refusal(error) from None
        met = {target.label for target in snapshot.targets if target.is_met}
        return {
            "says": supposed_sentence(findings, snapshot),
            "cost_us": findings.cost_us,
            "cost_now_us": snapshot.cost_us,
            "bound_us": findings.bound_us,
            "is_proven": findings.is_proven,
            "change_set": None if findings.change_set is None else change_record(findings.change_set),
            "unmet": plain(findings.unmet),
            "unmet_says": unmet_says(findings.unmet),
            "newly_unmet": sorted(met & findings.unmet.keys()),
        }

    def _apply(self, params: Mapping[str, Any]) -> Record:
        _only(params, "text", "name", "wait_s")
        name = _text(params, "name", "the plan")
        try:
            plan, basis = read_run_plan(_text(params, "text"), name)
            if plan.change_set is None:
                raise InputError.of(f"this plan has no update: it is {plan.status}", file=name)
            if not basis:
                mend = "`cfgplan ctl plan --out` makes one for what runs"
                raise InputError.of("this plan was not made for a run", file=name, mend=mend)
        except InputError as error:
            raise _refusal(error) from None
        return self._ask(changes.ApplyPlan(plan.change_set, basis, name), params)

    def _stop(self, params: Mapping[str, Any]) -> Record:
        _only(params)
        self._manager.request(changes.Stop())
        return {}

    def _changing(self, key: str, change: Callable[[str], changes.Change]) -> Method:
        def method(params: Mapping[str, Any]) -> Record:
            _only(params, key, "wait_s")
            return self._ask(change(_text(params, key)), params)

        return method

    def _ask(self, change: changes.Change, params: Mapping[str, Any]) -> Record:
        """Request a change. Returns its review, or that this is still waited for."""
        try:
            review = _waited_for(self._manager.request(change), params)
        except FutureTimeoutError:
            return {"review": None, "is_waiting": True}
        return {"review": None if review is None else review_record(review), "is_waiting": False}


@contextmanager
def _placed_in(declared: Declared) -> Iterator[None]:
    """Give the faults of a refusal their places in the declaration."""
    try:
        yield
    except RefusedError as error:
        faults = sorted(map(declared.placed, error.faults), key=lambda fault: (fault.line or 0, fault.column or 0))
        raise RefusedError(error.code, error.message, error.mend, faults) from None


def _waited_for(future: Future[T], params: Mapping[str, Any]) -> T:
    """Wait for a future's result, at most `wait_s` of the params. Raises RefusedError, and FutureTimeoutError when that
    time is over.
    """
    wait_s = params.get("wait_s", REQUEST_PATIENCE_S)
    if isinstance(wait_s, bool) or not isinstance(wait_s, int | float) or not 0 <= wait_s <= LONGEST_WAIT_S:
        mend = f"write a number from 0 to {LONGEST_WAIT_S}"
        raise RefusedError("bad_params", "`wait_s` is not a number of seconds that a request may wait", mend)
    try:
        return future.result(wait_s)
    except CancelledError:
        raise RefusedError("ended", "the run has ended") from None
    except CfgplanError as error:
        raise _refusal(error) from None


def _refusal(error: CfgplanError) -> RefusedError:
    faults = error.faults if isinstance(error, InputError) else ()
    return RefusedError("refused", str(error), faults[0].mend if faults else None, faults)


def _only(params: Mapping[str, Any], *known: str) -> None:
    for key in params:
        if key not in known:
            mend = f"it takes {', '.join(known)}" if known else "it takes none"
            raise RefusedError("bad_params", f"there is no parameter `{key}`", mend)


def _text(params: Mapping[str, Any], key: str, default: str | None = None) -> str:
    value = params.get(key, default)
    if not isinstance(value, str) or not value:
        raise RefusedError("bad_params", f"`{key}` is missing or no text", f'give "{key}": "..."')
    return value
