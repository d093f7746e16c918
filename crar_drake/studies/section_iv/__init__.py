"""Section IV of the paper, reproduced: `crar-drake reproduce`."""
