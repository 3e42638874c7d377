"""No example of a property is timed: other work may share the machine."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile("estimating", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("estimating")
