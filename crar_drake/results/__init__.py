"""What a run leaves behind, what shows it, and who judges it."""
