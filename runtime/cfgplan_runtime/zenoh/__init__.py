"""Zenoh: a source that subscribes to key expressions, and a sink that puts its input.

`source: cfgplan_runtime.zenoh:Subscriber` and `cfgplan_runtime.zenoh:Publisher`; the parameters are those of the
classes. A value that is put without a link is lost, since Zenoh keeps nothing.
"""

from cfgplan_runtime.zenoh.units import Publisher, Subscriber

__all__ = ["Publisher", "Subscriber"]
