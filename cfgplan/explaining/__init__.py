"""Answers that people can act on: why no plan exists, why this plan was chosen, and the alternatives to it.

Every question is put to a planner (`planning.Planner`); the answers are correct with any correct planner.
"""

from cfgplan.explaining.alternatives import Alternatives as Alternatives
from cfgplan.explaining.alternatives import alternatives as alternatives
from cfgplan.explaining.best_effort import BestEffort as BestEffort
from cfgplan.explaining.best_effort import best_effort as best_effort
from cfgplan.explaining.front import Front as Front
from cfgplan.explaining.front import front as front
from cfgplan.explaining.sensitivity import Sensitivity as Sensitivity
from cfgplan.explaining.sensitivity import Span as Span
from cfgplan.explaining.sensitivity import horizon_sensitivity as horizon_sensitivity
from cfgplan.explaining.sensitivity import upkeep_sensitivity as upkeep_sensitivity
from cfgplan.explaining.unfed import Blocked as Blocked
from cfgplan.explaining.unfed import Unfed as Unfed
from cfgplan.explaining.unfed import Unreachable as Unreachable
from cfgplan.explaining.unfed import unreachable as unreachable
from cfgplan.explaining.what_if import running as running
from cfgplan.explaining.why_not import Clash as Clash
from cfgplan.explaining.why_not import Unused as Unused
from cfgplan.explaining.why_not import WhyNot as WhyNot
from cfgplan.explaining.why_not import why_not as why_not
from cfgplan.explaining.why_this import Choice as Choice
from cfgplan.explaining.why_this import Why as Why
from cfgplan.explaining.why_this import why_stream as why_stream
from cfgplan.explaining.why_this import why_transformation as why_transformation
from cfgplan.explaining.why_this import why_unit as why_unit
from cfgplan.explaining.wiring import Suspicion as Suspicion
from cfgplan.explaining.wiring import WiringFault as WiringFault
from cfgplan.explaining.wiring import probable_first as probable_first
from cfgplan.explaining.wiring import wiring_demands as wiring_demands
from cfgplan.explaining.wiring import wiring_faults as wiring_faults
