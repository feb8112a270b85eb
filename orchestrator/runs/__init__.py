"""One run, from the path of an experiment to its record."""
