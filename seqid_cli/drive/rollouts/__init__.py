"""Controllers by whole windows of a simulated joint, where rows alone say too little.

`course` holds what a joint sees in windows of its logs besides its own law, `loop`
simulates it there for many sets of unknowns at once, `unknowns` says what these are and
what is known of them before, `solver` is Gauss-Newton, and `terms` keeps what a part of
the logs that was not fitted speaks for.
"""
