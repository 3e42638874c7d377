"""What runs, what should, and how the one becomes the other: no process is known here."""
