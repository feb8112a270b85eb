"""What an experiment file may hold, declared once: for the reader, the reference page and the JSON Schema."""
