"""An independent judge: distances by Drake and by triangles, none of the law's code."""
