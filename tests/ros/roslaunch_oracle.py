"""What roslaunch itself makes of launch files: each line of input names one with its arguments, and is answered."""

from __future__ import annotations

import json
import sys

import roslaunch.config

for line in sys.stdin:
    file, *arguments = json.loads(line)
    config = roslaunch.config.load_config_default([(file, arguments)], None, assign_machines=False)
    nodes = [
        {
            "name": f"{node.namespace}{node.name}",
            "package": node.package,
            "type": node.type,
            "args": node.args,
            "remaps": [list(pair) for pair in node.remap_args],
        }
        for node in config.nodes
    ]
    json.dump({"nodes": nodes, "params": {name: each.value for name, each in config.params.items()}}, sys.stdout)
    sys.stdout.write("\n")
    sys.stdout.flush()
