"""Carrying out change sets and noticing faults; nothing here knows that units are processes."""
