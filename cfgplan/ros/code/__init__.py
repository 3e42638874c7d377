"""The topics and services that source text of nodes names: read as text in C++ and Python, never run."""
