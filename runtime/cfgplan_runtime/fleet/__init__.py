"""Fleets: units on several computers, connected over Zenoh."""
