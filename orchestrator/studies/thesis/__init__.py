"""The thesis that the bench starts from: its cases, its published numbers, its figures, and how ours compare."""
