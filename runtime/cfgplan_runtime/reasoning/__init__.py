"""Stream reasoning: temporal logic over semantic subscriptions (the engine of the paper's Figure 1).

`query` reads a question, and `Engine` answers it over subscriptions. `Monitor` progresses a formula without
subscriptions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cfgplan.exports import exports

if TYPE_CHECKING:
    from cfgplan_runtime.reasoning.conditions import Evaluator as Evaluator
    from cfgplan_runtime.reasoning.engine import Engine as Engine
    from cfgplan_runtime.reasoning.features import DeclaredFeatures as DeclaredFeatures
    from cfgplan_runtime.reasoning.features import Feature as Feature
    from cfgplan_runtime.reasoning.managed import ManagedSubscriptions as ManagedSubscriptions
    from cfgplan_runtime.reasoning.managed import RemoteSubscriptions as RemoteSubscriptions
    from cfgplan_runtime.reasoning.monitor import Monitor as Monitor
    from cfgplan_runtime.reasoning.parser import parse as parse
    from cfgplan_runtime.reasoning.queries import Answer as Answer
    from cfgplan_runtime.reasoning.queries import Query as Query
    from cfgplan_runtime.reasoning.queries import UnmetTargetsError as UnmetTargetsError
    from cfgplan_runtime.reasoning.queries import query as query
    from cfgplan_runtime.reasoning.reader import Vocabulary as Vocabulary
    from cfgplan_runtime.reasoning.regions import Region as Region
    from cfgplan_runtime.reasoning.regions import rcc8 as rcc8
    from cfgplan_runtime.reasoning.regions import region_from as region_from
    from cfgplan_runtime.reasoning.states import Synchroniser as Synchroniser
    from cfgplan_runtime.reasoning.states import Timing as Timing
    from cfgplan_runtime.reasoning.truth import Verdict as Verdict

__all__, __getattr__, __dir__ = exports(
    __name__,
    {
        "engine": "Engine",
        "conditions": "Evaluator",
        "features": "DeclaredFeatures Feature",
        "managed": "ManagedSubscriptions RemoteSubscriptions",
        "monitor": "Monitor",
        "parser": "parse",
        "queries": "Answer Query UnmetTargetsError query",
        "reader": "Vocabulary",
        "regions": "Region rcc8 region_from",
        "states": "Synchroniser Timing",
        "truth": "Verdict",
    },
)
