"""Lower bounds on a plan's cost by landmarks: sets of labels of which every plan has one, or several.

`landmarks` finds them, `bounds` charges them with their members' costs and decides when to stop. `branching` is a
search that branches over landmarks on plain lists.
"""
