"""`python -m orchestrator.cli`: the command `orch`."""

from .main import main

main()
