"""Does `good` mean good: arms with imperfections, what the stages say, and what is
true.
"""
