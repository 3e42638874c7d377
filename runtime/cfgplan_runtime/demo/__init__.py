"""The paper's section V as a play: told in the terminal, shown on a page."""
