"""Planners side by side on families of instances: generators, runner, result rows, tables and plots."""
