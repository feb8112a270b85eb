"""The command `orch` as tests call it, and waiting for what it does."""

import json
import shutil
import sysconfig
import time
from dataclasses import dataclass

ORCH = shutil.which("orch", path=sysconfig.get_path("scripts")) or "orch"
DEADLINE = 60  # s, for what takes half a second on an idle machine


@dataclass(frozen=True)
class Answer:
    """What a command answered.  `json`: its standard output, decoded."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


def poll(condition, process=None):
    """Wait until the condition holds; fails after DEADLINE, or when the process has ended before."""
    end = time.monotonic() + DEADLINE
    while not (result := condition()):
        assert time.monotonic() < end, "nothing came of it"
        assert process is None or process.poll() is None or condition(), "the process has ended"
        time.sleep(0.005)
    return result
