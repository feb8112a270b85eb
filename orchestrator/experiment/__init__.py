"""The experiment file: what it may hold, reading it, and what it says as data.  Nothing here knows FMI."""
