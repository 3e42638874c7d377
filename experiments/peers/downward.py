"""The peer Fast Downward, by A* with LM-cut: starting a unit is an action, whose effects are the fed demands.

The task is written in Fast Downward's own input format, so that its translator takes no time. Fast Downward is a
program inside the package `up-fast-downward` (GPL), which is never imported.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from math import gcd
from pathlib import Path
from threading import Timer

from cfgplan.errors import InputError
from cfgplan.planning import Plan, Problem, Progress, Status
from cfgplan.reasons import unmet_reasons
from experiments.peers.selection import Selection

WHO = "fast-downward"
OUT_OF_MEMORY = 22
"""Its exit code for that."""
LARGEST_COST = 2**31 - 2
PROGRAM = "downward/builds/release/bin/downward"


def plan(
    problem: Problem, *, time_limit_s: float | None = None, report: Callable[[Progress], None] | None = None
) -> Plan:
    """Return the cheapest update. Raises InputError for feedback inputs and distinct groups, ImportError if not
    installed.
    """
    began = time.monotonic()
    program = _program()
    selection = Selection(problem, WHO)
    if not all(map(selection.feeders, selection.wanted)):
        return Plan(WHO, Status.INFEASIBLE, reasons=unmet_reasons(problem))
    ports = [port for candidate in selection.candidates for port in candidate.transformation.inputs]
    if any(port.feedback or port.distinct is not None for port in ports):
        raise InputError.of(f"{WHO} does not support feedback inputs and distinct groups")
    scale = gcd(*(candidate.cost_us for candidate in selection.candidates)) or 1
    if selection.cost_us(range(len(selection.candidates))) // scale > LARGEST_COST:
        raise InputError.of(f"{WHO} counts in 32 bits, and the costs are too large for it")
    with tempfile.TemporaryDirectory() as folder:
        task, answer = Path(folder, "task.sas"), Path(folder, "plan")
        task.write_text(_task(selection, scale))
        built_s = time.monotonic() - began
        bound_us, expanded = 0, 0
        with task.open() as stdin:
            process = subprocess.Popen(
                [program, "--search", "astar(lmcut())", "--internal-plan-file", answer],
                stdin=stdin,
                stdout=subprocess.PIPE,
                text=True,
            )
        clock = Timer(10**6 if time_limit_s is None else max(0.0, time_limit_s - built_s), process.kill)
        clock.daemon = True
        clock.start()
        assert process.stdout is not None
        for line in process.stdout:
            if found := re.search(r" f = (\d+),|Initial heuristic value for .*: (\d+)", line):
                bound_us = max(bound_us, int(found[1] or found[2]) * scale)
                if report is not None:
                    report(Progress(time.monotonic() - began, None, bound_us))
            if found := re.search(r"Expanded (\d+) state", line):
                expanded = int(found[1])
        process.wait()
        clock.cancel()
        chosen = _chosen(answer.read_text()) if answer.exists() else None
    if process.returncode == OUT_OF_MEMORY:
        raise MemoryError
    if chosen is None and process.returncode > 0:
        raise RuntimeError(f"{PROGRAM} ended with exit code {process.returncode}")
    if chosen is not None:
        bound_us = selection.cost_us(chosen)
    seconds = {"build": built_s, "search": time.monotonic() - began - built_s}
    return selection.answer(chosen, bound_us, seconds=seconds, counts={"expanded": expanded})


def _program() -> str:
    spec = find_spec("up_fast_downward")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("No module named 'up_fast_downward'")
    program = Path(spec.submodule_search_locations[0], PROGRAM)
    if not program.exists():
        raise ImportError(f"up_fast_downward has no program at {PROGRAM} on this platform")
    return str(program)


def _task(selection: Selection, scale: int) -> str:
    """The planning task: a variable for each demanded tag (fed: 0, not yet: 1), and for each kept unit."""
    needed = [port.tag for candidate in selection.candidates for port in candidate.transformation.inputs]
    facts = {tag: fact for fact, tag in enumerate(dict.fromkeys((*selection.wanted, *needed)))}
    kept = {i: fact for fact, i in enumerate(sorted(selection.kept), len(facts))}
    gives: list[list[int]] = [[kept[i]] if i in kept else [] for i in range(len(selection.candidates))]
    for tag, fact in facts.items():
        for i in selection.feeders(tag):
            gives[i].append(fact)
    count = len(facts) + len(kept)
    lines = ["begin_version", "3", "end_version", "begin_metric", "1", "end_metric", str(count)]
    for fact in range(count):
        names = [f"Atom f{fact}()", f"NegatedAtom f{fact}()"]
        lines += ["begin_variable", f"var{fact}", "-1", "2", *names, "end_variable"]
    goals = [*(facts[tag] for tag in selection.wanted), *kept.values()]
    lines += ["0", "begin_state", *["1"] * count, "end_state"]
    lines += ["begin_goal", str(len(goals)), *(f"{goal} 0" for goal in goals), "end_goal"]
    operators = 0
    actions: list[str] = []
    for i, candidate in enumerate(selection.candidates):
        needs = sorted({facts[port.tag] for port in candidate.transformation.inputs})
        effects = sorted(set(gives[i]) - set(needs))
        if effects:
            operators += 1
            actions += ["begin_operator", f"run {i}", str(len(needs)), *(f"{need} 0" for need in needs)]
            actions += [str(len(effects)), *(f"0 {effect} -1 0" for effect in effects)]
            actions += [str(candidate.cost_us // scale), "end_operator"]
    return "\n".join([*lines, str(operators), *actions, "0", ""])


def _chosen(plan_text: str) -> list[int]:
    return [int(number) for number in re.findall(r"^\(run (\d+)\)", plan_text, re.MULTILINE)]
