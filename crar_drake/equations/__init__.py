"""The mathematics of the paper, one module per section: NumPy in, NumPy out.

    tasks                   Eqs. (4)-(8), (11)
    references              Eqs. (9), (14)
    joint_limits            Eqs. (17), (18)
    collisions              Eqs. (19)-(26)
    composite_weight        Eqs. (27), (28)
    weighted_inverse        Eqs. (16), (34)
    resolved_acceleration   Eqs. (10), (12), (13), (15), (30)-(35)
    capsule_distances       the minimum distances that Eqs. (19)-(26) start from
    lookahead               constraints that act where the robot would come to rest
    blending                the way from the measured pose onto the targets

Nothing here imports Drake.
"""
