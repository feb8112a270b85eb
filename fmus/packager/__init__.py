"""Makes an FMU of a model.  Run by `orch build`; of all this, only `bundle.py` goes into the FMU."""
