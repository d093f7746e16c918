"""The motions that this project ships, and the script that authors them."""
