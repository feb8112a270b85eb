"""One run in a process of its own, which may crash: python -m orchestrator.runs < JOB > RESULT.json

JOB is a pickled dictionary: "plan", a Plan; "results", the store; "command", the command line that the record names.
RESULT.json holds `run_id`, `file`, `status`, `wall_time`, `metrics`, `warnings` and `error`, or `error` alone where
nothing was started.  Metrics may be NaN and Infinity, as Python's json has them.  The exit code is that of `orch run`.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import sys
from typing import Any

from ..errors import OrchError
from ..instances.isolated_child import end_with_parent
from .runner import execute

EXIT_CODES = {"completed": 0, "failed": 3, "interrupted": 130}


def run(job: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    """Exit code and result of a job."""
    sys.argv = job["command"]
    try:
        result = execute(job["plan"], results=job["results"])
    except OrchError as error:
        return error.exit_code, {"error": str(error)}
    return EXIT_CODES[result.status], {
        "run_id": result.run_id,
        "file": str(result.file),
        "status": result.status,
        "wall_time": result.wall_time,
        "ended_at": result.ended_at,
        "metrics": dict(result.metrics),
        "warnings": list(result.warnings),
        "error": result.error,
    }


if __name__ == "__main__":
    end_with_parent(signal.SIGTERM)
    answer = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what an FMU prints is no part of the result
    code, outcome = run(pickle.load(sys.stdin.buffer))
    json.dump(outcome, answer)
    answer.close()
    sys.stderr.flush()
    os._exit(code)  # an FMU that has failed may crash when it is freed, also by the destructors at exit
