"""Zenoh: a source that subscribes to key expressions, and a sink that puts what comes to it.

`source: cfgplan_runtime.zenoh:Subscriber` and `cfgplan_runtime.zenoh:Publisher`; the parameters are those of the
classes. A value that is put while nobody is linked is lost: Zenoh keeps nothing.
"""

from cfgplan_runtime.zenoh.units import Publisher, Subscriber

__all__ = ["Publisher", "Subscriber"]
