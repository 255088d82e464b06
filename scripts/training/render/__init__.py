"""People of the index rendered as photographs: bodies, rooms, furniture, light and a camera.

World axes are those of the body (x to the person's left, y up, z forward, metres); camera axes are
x right, y down, z forward. Colours are linear RGB until the picture is developed.
"""
