"""The first line of the page: whether all is well, why not, and the first unmet target."""

from __future__ import annotations

from collections.abc import Iterator

from cfgplan.amounts import span
from cfgplan.summary import counted, some
from cfgplan_runtime.lifecycle.review_sentences import in_display_order, waiting
from cfgplan_runtime.operating.protocol import Record

QUIET_S = 5.0
"""A met target on whose topic nothing has come for so long is reported."""


def health(state: Record) -> Record:
    """Return `level` (`well`, `warning`, `bad`) and `says`, a sentence, for a state (`cfgplan/manual/control.md`).

    Unmet targets are bad; the first named is the one of the highest priority. Anything else that needs an eye is a
    warning.
    """
    targets = in_display_order(state["targets"])
    unmet = [target for target in targets if not target["met"]]
    if unmet:
        first, many = unmet[0], counted(len(targets), "target")
        is_one = len(unmet) == 1
        lead = f"{len(unmet)} of {many} {'is' if is_one else 'are'} not met"
        name = "It is" if is_one else "The first is"
        reason = first["reason"] or "a review is under way"
        return {"level": "bad", "says": f"{lead}. {name} {first['label']}: {reason}."}
    warnings = list(_warnings(state))
    if warnings:
        more = f" {counted(len(warnings) - 1, 'other warning')}." if len(warnings) > 1 else ""
        return {"level": "warning", "says": f"All targets are met, but {warnings[0]}.{more}"}
    met = "The target is met" if len(targets) == 1 else f"All {len(targets)} targets are met"
    units = counted(sum(not unit.get("standby") for unit in state["units"]), "unit")
    return {"level": "well", "says": f"All is well. {met} by {units}." if targets else "All is well. No target is set."}


def _warnings(state: Record) -> Iterator[str]:
    """The reasons to look closer though all targets are met, the gravest first."""
    if state["lost_hosts"]:
        is_one = len(state["lost_hosts"]) == 1
        yield f"{'host' if is_one else 'hosts'} {some(state['lost_hosts'])} {'is' if is_one else 'are'} gone"
    for target in state["targets"]:
        if (target.get("silent_s") or 0.0) > QUIET_S and not target.get("rate_hz"):
            yield f"nothing has come for {target['label']} for {span(target['silent_s'])}"
    for unit in state["units"]:
        if unit.get("unfed"):
            yield f"nothing feeds {some(unit['unfed'])} of {unit['id']}"
    for each in waiting(state["backing_off"]):
        yield f"{some(each.names)} {'waits' if len(each.names) == 1 else 'wait'} to be started again: {each.cause}"
    if state["faults"]:
        yield f"the file has an error: {state['faults'][0]['message']}"
    for file, units in state["old_code"].items():
        yield f"{some(units)} {'runs' if len(units) == 1 else 'run'} with the code from before {file} changed"
    for unit in state["units"]:
        if unit.get("errors"):
            yield f"{unit['id']} has failed in {counted(unit['errors'], 'step')}"
