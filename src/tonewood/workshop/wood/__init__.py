"""Constants of a wood from the size, mass and taps of a free board or stick.

rectangle.py (frequencies of a free board for any constants) · board.py (its constants, with intervals) · stick.py (a
brace stick) · thickness.py (of a top with a wanted stiffness) · peaks.py (tables of peaks)
"""
