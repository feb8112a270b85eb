"""A run saved at a time, and runs that go on from there."""
