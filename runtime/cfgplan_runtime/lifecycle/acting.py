"""The acting half of a review: the middleware carries out what was decided; who is to blame if it fails."""

from __future__ import annotations

from cfgplan.domain import ChangeSet, Environment
from cfgplan_runtime.errors import AbandonedError, ApplyError, NoSourceError, RuntimeFaultError, StaleChangeSetError
from cfgplan_runtime.lifecycle.configuration import Running, with_world
from cfgplan_runtime.lifecycle.deliberation import Thought
from cfgplan_runtime.lifecycle.intake import Intake
from cfgplan_runtime.lifecycle.perturbations import UpdateFailed
from cfgplan_runtime.lifecycle.reports import Decision
from cfgplan_runtime.lifecycle.seams import Clock, Middleware


class Acting:
    """Carries updates out by a middleware."""

    def __init__(self, middleware: Middleware, intake: Intake, clock: Clock, postpone_s: float) -> None:
        self._middleware = middleware
        self._intake = intake
        self._clock = clock
        self._postpone_s = postpone_s

    def act(self, thought: Thought) -> UpdateFailed | None:
        """Carry out what was decided; what went wrong, if anything did, be it a fault of the middleware."""
        if thought.change_set is None:
            return UpdateFailed(thought.cause)
        wanted = thought.change_set if thought.decision is Decision.APPLIED else ChangeSet()
        change_set = with_world(wanted, self._intake.living.world.environment, self._middleware.environment)
        if not change_set:
            return None
        with thought.timed("apply"):
            return self._apply(change_set, thought.running)

    def _apply(self, change_set: ChangeSet, basis: Environment) -> UpdateFailed | None:
        units = self._intake.situation.units
        library = self._intake.living.world.environment.transformation
        started = frozenset(unit.id for unit in change_set.started)
        for unit in change_set.started:
            units[unit.id] = Running(library[unit.transformation], self._clock.now())
        self._intake.starting = started
        slow: tuple[str, ...] = ()
        try:
            self._middleware.apply(change_set, basis=basis, keeps_new=True)
        except StaleChangeSetError as error:
            failed = UpdateFailed(str(error), is_stale=True)
        except NoSourceError as error:
            failed = UpdateFailed(str(error), error.transformations)
            for label in error.transformations:
                self._intake.situation.back_offs.refuse(label, error.cause)
                self._intake.tell_back_off(label)
        except AbandonedError as error:
            failed, slow = UpdateFailed(str(error), self._postponed(error)), error.units
        except ApplyError as error:
            failed, slow = UpdateFailed(str(error), self._blamed(error)), error.units
        except RuntimeFaultError:
            raise  # nothing runs any more
        except Exception as error:
            failed = UpdateFailed(f"the middleware failed: {type(error).__name__}: {error}", is_fault=True)
        else:
            for unit_id in change_set.stopped:
                self._intake.situation.forget(unit_id)
            return None
        finally:
            self._intake.starting = frozenset()
        for unit_id in started.union(slow).difference(self._middleware.environment.unit):
            self._intake.situation.forget(unit_id)
        return failed

    def _postponed(self, error: AbandonedError) -> tuple[str, ...]:
        """The transformations whose units were starting when the update was given up for something urgent."""
        labels = {label for unit in error.units if (label := self._intake.situation.label_of(unit)) is not None}
        for label in labels:
            self._intake.situation.back_offs.postpone(label, self._clock.now() + self._postpone_s)
        return tuple(sorted(labels))

    def _blamed(self, error: ApplyError) -> tuple[str, ...]:
        """The transformations whose units did not start; each has been blamed for it."""
        intake = self._intake
        intake.not_started = []
        intake.take_in()
        for unit in error.units:
            label = intake.situation.label_of(unit)
            if label is not None and label not in intake.not_started:  # it was too slow, but has not died
                intake.blame(label, 0.0, str(error), is_costly=True)
                intake.not_started.append(label)
        return tuple(sorted(set(intake.not_started)))
