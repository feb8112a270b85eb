"""The command line: words typed and words printed."""

import gc

gc.set_threshold(100_000)  # what a command imports lives to its end: to look through it again and again took 25 ms
