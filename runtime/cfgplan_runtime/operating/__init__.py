"""A run in operation: the control socket, what is shown of it, and its recording."""
