"""What a plan costs at least, by landmarks: sets of labels of which every plan has one, or several.

`landmarks` finds them, `bounds` charges them for what their members cost,
`tightening` knows when to stop. `chains` is a quick bound, `branching` a search that branches over landmarks, on plain
lists (`ways`), `rivals` whether a plan is the only one at its cost.
"""
