"""What runs inside a child process, and how it talks with the supervisor."""
