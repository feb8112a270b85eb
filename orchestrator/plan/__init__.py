"""What will run: an experiment fitted to its FMUs, every name resolved.  Nothing is loaded."""
