"""The settings of a manager."""

from __future__ import annotations

from dataclasses import dataclass, field

from cfgplan_runtime.lifecycle.back_off import BackOffRules


@dataclass(frozen=True, slots=True)
class Policy:
    """How a manager reviews. Times are in seconds.

    Planning may take `time_limit_s`. Matching a world may take `match_limit_s`, and so may all questions of its reviews
    to the reasoner that leave a pair open. Units are observed every `observe_every_s`. Perturbations within `gather_s`
    of the first belong to the same review. A lost subscription waits up to `explain_s` for the death that explains it;
    one that is lost in a row waits `retry_s`, then twice that, up to `most_loss_s`. A unit is given up after
    `failing_steps` errors over `failing_s` without a good step. Further perturbations restart planning at most
    `interruptions` times. They also abandon an update that waits for new units; the update is repeated `postpone_s`
    later. A review that failed is repeated after `retry_s`, then twice that, up to `most_retry_s`. With `hosts_s`,
    plans use a host once it has joined, and the first review waits up to `hosts_s` until it knows of each whether it
    has joined; None: they are used until they are lost. With `refuses_hosts`, a world with hosts is refused, because
    the middleware can't place units. A transformation that may be better than the ones that run, and was not observed
    for `look_every_s`, is run by a look for some seconds; if the look finds nothing new, the next one comes after twice
    the time. None: no looks. A manager remembers its last `reviews_kept` reviews. `reasoner` is a name in
    `cfgplan.matching.REASONERS`, or `auto`. `back_off` says how long a transformation waits after failures.
    """

    time_limit_s: float | None = 10.0
    match_limit_s: float | None = 30.0
    reasoner: str = "auto"
    observe_every_s: float = 1.0
    gather_s: float = 0.001
    explain_s: float = 0.02
    failing_steps: int = 5
    failing_s: float = 3.0
    interruptions: int = 3
    postpone_s: float = 0.5
    retry_s: float = 0.1
    most_retry_s: float = 30.0
    most_loss_s: float = 5.0
    reviews_kept: int = 100
    hosts_s: float | None = None
    refuses_hosts: bool = False
    look_every_s: float | None = 60.0
    back_off: BackOffRules = field(default_factory=BackOffRules)
