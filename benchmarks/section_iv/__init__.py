"""Section IV of the paper, reproduced."""
