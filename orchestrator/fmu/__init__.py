"""What an FMU says about itself; nothing of it is loaded.

`archive` opens the file without trust and `description` checks its XML; `fmu` reads it into `variables` and `units`.
`values` fits values of an experiment file to them; `builtin` describes what runs inside orch as if it were an FMU.
"""
