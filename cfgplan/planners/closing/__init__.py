"""Bound and plan brought together where landmarks alone leave a gap.

`gap` takes turns: the cheapest fractions of labels that hit all known landmarks (`program`), landmarks that these
fractions miss (`separation`), and repairs of a plan at prices from them.
"""
