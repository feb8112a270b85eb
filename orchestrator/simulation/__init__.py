"""The co-simulation master: runs what a plan describes, step by step, and knows nothing of files.

`system` opens a plan, `initialization` gives it consistent values, `master` steps it by one of the two loops of `loop`
and hands its rows to observers.
"""
