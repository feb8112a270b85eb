"""The version of this project, which pyproject.toml and CITATION.cff agree with."""

__version__ = "0.1.0"
