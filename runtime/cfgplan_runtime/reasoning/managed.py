"""Subscriptions through the manager of this process, or through the control socket of another process's run."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

from cfgplan.amounts import span
from cfgplan.domain import Target
from cfgplan.errors import Fault, InputError
from cfgplan_runtime.lifecycle.changes import Add, Change, Remove
from cfgplan_runtime.lifecycle.kinds import Level, level, sentence
from cfgplan_runtime.lifecycle.reports import Decision, Report, Review, Reviewed, Snapshot, UnitEvent
from cfgplan_runtime.lifecycle.review_sentences import decision, target_reason
from cfgplan_runtime.reasoning.features import DeclaredFeatures, Feature
from cfgplan_runtime.streams.subscription import SubscriptionToTopic, subscribe

if TYPE_CHECKING:
    from concurrent.futures import Future

    from cfgplan_runtime.operating.control_client import Control

_PATIENCE_S = 60.0
_SUBSCRIPTION_LOOK_S = 0.2
_SETTLE_S = 5.0


class Managing(Protocol):
    """The methods of a manager that a query uses."""

    def request(self, change: Change) -> Future[Review | None]: ...

    def snapshot(self) -> Snapshot: ...

    def settle(self, timeout_s: float | None = None) -> bool: ...

    def listen(self, listener: Callable[[Report], None]) -> None: ...


class ManagedSubscriptions:
    """Subscriptions through a manager in this process, whose runtime is `run`."""

    def __init__(self, manager: Managing, run: str) -> None:
        self._manager = manager
        self._run = run

    def add(self, targets: Sequence[Target]) -> None:
        with suppress(FutureTimeoutError):
            self._manager.request(Add(targets=tuple(targets))).result(_PATIENCE_S)
        if self.unmet([target.label for target in targets]):
            self._manager.settle(_SETTLE_S)

    def unmet(self, labels: Sequence[str]) -> Mapping[str, str]:
        targets = self._manager.snapshot().targets
        return {each.label: each.reason for each in targets if each.label in labels and not each.is_met}

    def remove(self, labels: Sequence[str]) -> None:
        with suppress(FutureTimeoutError):
            self._manager.request(Remove(targets=tuple(labels))).result(_PATIENCE_S)

    def samples(self, topic: str, wait_s: float) -> SubscriptionToTopic:
        return subscribe(topic, run=self._run, wait_s=wait_s, timeout_s=_SUBSCRIPTION_LOOK_S)

    def listen(self, tell: Callable[[str], None]) -> None:
        def hear(report: Report) -> None:
            text = _told(report)
            if text:
                tell(text)

        self._manager.listen(hear)


class RemoteSubscriptions:
    """Subscriptions through a run of another process."""

    def __init__(self, control: Control, subscribe: Callable[..., SubscriptionToTopic] = subscribe) -> None:
        self._control = control
        self._subscribe = subscribe
        self._names: dict[str, str] = {}

    def declared(self) -> DeclaredFeatures:
        """The targets of the run, as features."""
        targets = self._control.call("state", timeout_s=_PATIENCE_S)["targets"]
        wanted = [Feature(each["label"], each["tag"], each["topic"]) for each in targets if each["topic"] is not None]
        return DeclaredFeatures({feature.name: feature for feature in wanted})

    def add(self, targets: Sequence[Target]) -> None:
        name = targets[0].label.rpartition(" ")[0]
        document = [{"label": each.label, "topic": each.topic, "tag": each.tag} for each in targets]
        self._call("add", name=name, text=json.dumps({"targets": document}), while_connected=True)
        self._names.update(dict.fromkeys((target.label for target in targets), name))

    def unmet(self, labels: Sequence[str]) -> Mapping[str, str]:
        targets = {each["label"]: each for each in self._call("state")["targets"]}
        reasons = {
            label: target_reason(targets[label]) if label in targets else "it is unknown to the run" for label in labels
        }
        return {label: reason for label, reason in reasons.items() if not targets.get(label, {}).get("met")}

    def remove(self, labels: Sequence[str]) -> None:
        for name in {self._names.pop(label) for label in labels if label in self._names}:
            self._call("withdraw", name=name)

    def samples(self, topic: str, wait_s: float) -> SubscriptionToTopic:
        return self._subscribe(topic, run=self._control.system.run, wait_s=wait_s, timeout_s=_SUBSCRIPTION_LOOK_S)

    def listen(self, tell: Callable[[str], None]) -> None:
        """Report nothing: the operator of the other process gets its events."""

    def _call(self, method: str, **params: Any) -> Any:
        from cfgplan_runtime.operating.protocol import RefusedError

        try:
            return self._control.call(method, timeout_s=2 * _PATIENCE_S, **params)
        except RefusedError as error:
            raise InputError(error.faults or [Fault(error.message, mend=error.mend)]) from None


def _told(report: Report) -> str | None:
    """The sentence about a report for the query's user; None if it does not concern them."""
    match report:
        case UnitEvent() if level(report) is not Level.INFORMATION:
            return sentence(report)
        case Reviewed(review) if review.decision is Decision.APPLIED and review.change_set:
            return f"{decision(review)} ({span(sum(review.seconds.values()))})"
        case Reviewed(review) if review.decision is Decision.FAILED:
            return decision(review)
    return None
