"""The commands of `orch`, by what they are about.  Each imports what it needs when it runs."""
