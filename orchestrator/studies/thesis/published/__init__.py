"""What the thesis published, in numbers and in words, and how our runs compare."""
