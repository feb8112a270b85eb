"""How a model is declared, and how it is run as an FMU; the physics lies beside this package.

`declare` has the variables and their layout in memory, `equations` models of CasADi expressions, `python_model` models
in plain Python; `slave` runs either as a Python FMU.
"""
