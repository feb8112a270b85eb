"""Turns a model's definition into an FMU.  Run by `orch build`; nothing of it goes into the FMU but `bundle.py`."""
