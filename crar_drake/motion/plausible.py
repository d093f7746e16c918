"""How tall people are, by which a recording's unit is known or doubted."""

# The skeletons of 13 CMU performers are 1.48 to 1.63 m tall, to the end of the head's
# bone and without soles: a tenth less than the performers. Children and giants are
# within these bounds; lengths in another unit are mostly not.
HEIGHTS = (0.8, 2.3)  # [m]
USUAL_HEIGHT = 1.6  # [m]
