"""The control law with its arithmetic compiled by Numba: `controller.arithmetic`.

The equations are those of `crar_drake.equations`, which is where to read them; here
they stand once more, as loops. `tests/compiled` compares the two.
"""
