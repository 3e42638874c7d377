"""From samples to verdicts, without processes: `python experiments/reasoning/pipeline.py`."""

from __future__ import annotations

import argparse
import math
import time

from cfgplan_runtime.reasoning.conditions import Evaluator
from cfgplan_runtime.reasoning.monitor import Monitor
from cfgplan_runtime.reasoning.parser import parse
from cfgplan_runtime.reasoning.program import compiled
from cfgplan_runtime.reasoning.reader import Vocabulary
from cfgplan_runtime.reasoning.regions import region_from
from cfgplan_runtime.reasoning.states import Synchroniser, Timing

REGIONS = {
    "opponent_half": region_from({"box": [0, -3, 4.5, 3]}),
    "goal": region_from({"circle": [4.5, 0], "radius": 1}),
    "field": region_from({"polygon": [[-4.5, -3], [4.5, -3], [4.5, 3], [-4.5, 3]]}),
}
FORMULAS = (
    "always (ball.x < 0 -> eventually[0,10s] ball.x >= 0)",
    "always (not in(ball, opponent_half) -> eventually[0,10s] in(ball, opponent_half))",
    "always (distance(ball, robot) > 1 or in(ball, goal) -> eventually[2s,5s] robot.x > ball.x)",
    "always (ntpp(robot.hull, field) or eventually[0,2s] not ec(robot.hull, goal))",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=50_000)
    options = parser.parse_args()
    print("| formula | streams | states/s |")
    print("|---|---|---|")
    for text in FORMULAS:
        names = [name for name in ("ball", "robot") if name in text]
        print(f"| `{text}` | {len(names)} | {_measure(text, names, options.states):,.0f} |")


def _measure(text: str, names: list[str], count: int) -> float:
    program = compiled(parse(text, Vocabulary(names, REGIONS)))
    monitor, evaluator = Monitor(program), Evaluator(program, REGIONS, print)
    streams = Synchroniser(dict.fromkeys(names), Timing(), begin_ns=0)
    period = 33_000_000
    samples = []
    for number in range(count):
        x = 4 * math.sin(number / 20)
        hull = [[x - 0.2, -0.2], [x + 0.2, -0.2], [x + 0.2, 0.2], [x - 0.2, 0.2]]
        values = {"ball": {"x": x, "y": 0.1}, "robot": {"x": x + 0.5, "y": 0.0, "hull": hull}}
        samples.append([(name, number * period, values[name]) for name in names])
    begin = time.process_time()
    for sample in samples:
        for name, time_ns, value in sample:
            streams.push(name, time_ns, value)
        for state in streams.ready(sample[-1][1]):
            monitor.step(state.time_ns, evaluator.truths(state.values))
    took = time.process_time() - begin
    if monitor.states != count:
        raise SystemExit(f"{text}: {monitor.verdict} after {monitor.states} states")
    return count / took


if __name__ == "__main__":
    main()
