"""Bound and plan brought together where landmarks alone leave a gap.

`gap` takes turns: fractions of labels that hit all landmarks known (`program`, with rows from `feeding` for those
`alike`), landmarks that these fractions miss (`separation`), plans torn and repaired at their prices (`repairing`).
"""
