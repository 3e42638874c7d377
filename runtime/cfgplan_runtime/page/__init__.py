"""A page about a run, served to browsers: the running configuration with its rates, drawn again at each change, and
buttons to steer it.
"""
