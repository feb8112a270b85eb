"""What several records say together, and the vehicles of one; `settings` says which module compares what."""
