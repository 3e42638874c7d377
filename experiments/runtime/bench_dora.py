"""One measurement with dora-rs, for `bench.py`: size in bytes, consumers, rate per second (0: flat out).

Run by `dora run`; started with `source` or `sink` as the first argument it is one of the nodes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measured_units import Ages, payload


def source(size: int, rate_hz: float) -> None:
    import pyarrow
    from dora import Node

    node, data, due = Node(), pyarrow.array(memoryview(payload(size)), pyarrow.uint8()), time.monotonic()
    while True:
        node.send_output("n", data, {"made": time.monotonic_ns()})
        if rate_hz:
            due += 1 / rate_hz
            time.sleep(max(0.0, due - time.monotonic()))


def sink(every: int, reports: str) -> None:
    from dora import Node

    ages = Ages(every)
    with Path(reports).open("w", buffering=1) as out:
        for event in Node():
            if event["type"] == "INPUT":
                report = ages([event["metadata"]["made"], event["value"]])
                if report is not None:
                    out.write(json.dumps(report) + "\n")


def dataflow(size: int, consumers: int, rate_hz: float, reports: Path) -> dict[str, object]:
    """Return a dataflow of the source and some consumers; the first consumer writes its reports."""
    node = {"path": sys.executable}
    queue = {"queue_size": 256 if rate_hz else 16, "queue_policy": "drop_oldest" if rate_hz else "backpressure"}
    args = f"{__file__} sink {50 if rate_hz else 200}"
    sinks = [
        {
            "id": f"sink{number}",
            **node,
            "args": f"{args} {os.devnull if number else reports}",
            "inputs": {"x": {"source": "source/n", **queue}},
        }
        for number in range(consumers)
    ]
    source = {"id": "source", **node, "args": f"{__file__} source {size} {rate_hz}", "outputs": ["n"]}
    return {"nodes": [source, *sinks]}


def main(size: int, consumers: int, rate_hz: float) -> None:
    """Print the reports as they come, until killed."""
    with tempfile.TemporaryDirectory() as folder:
        reports, flow = Path(folder, "reports"), Path(folder, "dataflow.yml")
        os.mkfifo(reports)
        flow.write_text(json.dumps(dataflow(size, consumers, rate_hz, reports)))
        dora = Path(sys.executable).with_name("dora")
        subprocess.Popen([dora, "run", flow], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        with reports.open() as lines:
            for line in lines:
                print(line, end="", flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "source":
        source(int(sys.argv[2]), float(sys.argv[3]))
    elif sys.argv[1] == "sink":
        sink(int(sys.argv[2]), sys.argv[3])
    else:
        main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
