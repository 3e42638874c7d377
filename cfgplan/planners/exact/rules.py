"""The rules of an update in the constraint model, each a function named by its content.

A rule that a problem does not use adds nothing.
"""

from __future__ import annotations

from typing import Final

from cfgplan.planners.exact import hosts, idle_inputs, inputs, quality, targets, units
from cfgplan.planners.exact.model import ModelRule

RULES: Final[tuple[ModelRule, ...]] = (
    units.a_unit_runs_or_waits_in_one_place,
    units.a_group_runs_if_some_of_its_units_do,
    units.a_kept_unit_stays_or_is_wired_anew,
    inputs.a_staying_unit_keeps_its_feeders,
    inputs.a_wired_unit_is_fed,
    inputs.inputs_of_a_group_are_fed_by_different_transformations,
    inputs.units_that_feed_each_other_come_one_after_the_other,
    inputs.a_demand_is_met_first_by_a_unit_that_does_not_need_it,
    targets.a_target_is_published_by_one_unit,
    targets.a_unit_runs_that_a_target_wants,
    hosts.what_is_made_on_a_host_is_not_carried_there,
    hosts.links_bear_what_is_carried_and_have_their_prices,
    units.pinned_units_run,
    targets.required_transformations_serve_a_target,
    idle_inputs.a_stream_serves_no_more_than_it_may,
    idle_inputs.an_input_that_starts_nothing_is_fed_by_what_is_needed_anyway,
    idle_inputs.an_input_that_starts_nothing_is_fed_where_it_can_be,
    targets.units_that_could_keep_each_other_are_needed,
    hosts.a_host_is_paid_and_counted_while_something_is_there,
    hosts.hosts_bear_their_units,
    units.units_that_conflict_are_not_there_together,
    units.there_are_as_many_units_as_asked_for_and_allowed,
    hosts.no_host_has_more_units_of_a_transformation_than_it_allows,
    hosts.units_that_conflict_are_not_on_one_host,
    hosts.beside_a_running_unit_run_those_that_it_runs_with,
    hosts.hosts_alike_are_taken_in_order,
    units.new_units_come_in_order,
    units.one_of_new_units_alike_is_enough,
    quality.targets_get_the_quality_they_ask_for,
)
"""What a configuration must be, in the order in which the booleans are made."""
PLACED: Final[tuple[ModelRule, ...]] = (
    units.a_unit_runs_or_waits_in_one_place,
    hosts.a_host_is_paid_and_counted_while_something_is_there,
    hosts.hosts_bear_their_units,
    hosts.no_host_has_more_units_of_a_transformation_than_it_allows,
    hosts.units_that_conflict_are_not_on_one_host,
    hosts.beside_a_running_unit_run_those_that_it_runs_with,
    hosts.hosts_alike_are_taken_in_order,
)
"""The rules of units on hosts, which hold whatever the wiring."""
