"""Figures of runs and of systems."""
