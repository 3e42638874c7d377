"""A unit of cfgplan in plain Python, without cfgplan: the moving average of the number of bright pixels."""

import collections
import json
import os
import sys

last = collections.deque(maxlen=json.loads(os.environ["CFGPLAN_PARAMS"])["last"])


def say(message):
    print(json.dumps(message), flush=True)


say({"ready": True})
for line in sys.stdin:
    request = json.loads(line)
    last.append(request["inputs"]["bright"])
    say({"step": request["step"], "outputs": {"level": sum(last) / len(last)}})
