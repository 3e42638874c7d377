"""The code inside a child process, and its messages to the supervisor."""
