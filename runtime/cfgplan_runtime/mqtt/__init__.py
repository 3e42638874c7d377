"""MQTT: a source that subscribes to topics of a broker, a sink that publishes, and targets of a run that are published.

`source: cfgplan_runtime.mqtt:Subscriber` and `cfgplan_runtime.mqtt:Publisher`; the parameters are those of the classes.
Sessions are of MQTT 5. At `qos` 1 and 2 the broker keeps messages while a connection is down. A subscriber confirms a
message once its element was handed on; at `qos` 1 a message may come twice. `password_env` and `password_file` say
where the password is, since an environment file holds none.
"""

from cfgplan_runtime.mqtt.units import Publisher, Subscriber

__all__ = ["Publisher", "Subscriber"]
