"""Lower bounds on a plan's cost by landmarks: sets of labels of which every plan has one, or several.

`landmarks` finds them, `bounds` charges them with their members' costs, `tightening` decides when to stop. `chains` is
a quick bound, `branching` a search that branches over landmarks on plain lists (`ways`), `rivals` asks whether a plan
is the only one at its cost.
"""
