"""What a manager tells, as a structured log: one JSON line per report (the form is in runtime/LOG.md)."""

from __future__ import annotations

from collections.abc import Callable

from cfgplan_runtime.lifecycle.reports import Observed, Report
from cfgplan_runtime.operating.records import report_record
from cfgplan_runtime.supervision.run_log import RunLog


def logging_to(log: RunLog) -> Callable[[Report], None]:
    """A listener for `Manager.listen` that writes every report but the observations of each second."""

    def write(report: Report) -> None:
        if not isinstance(report, Observed):
            says = report_record(report)
            log.write_line(says.pop("kind"), says)

    return write
