"""System Structure and Parameterization, SSP 1.0: experiments for other tools, and systems of other tools.

`writing` exports a plan, `archive` and `structure` read a system, `importing` makes an experiment of it.
"""
