"""Carrying out change sets and noticing faults; no module here depends on units being processes."""
