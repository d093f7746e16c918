"""Many motions through many settings, each simulation judged."""
