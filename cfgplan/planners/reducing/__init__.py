"""The problem less what no plan can use, and less the words that can't matter."""
