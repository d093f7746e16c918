"""What a run leaves behind, what shows it, and who judges it."""

# The files that a run writes into its folder.
RECORDING, LOG, SUMMARY, PLOT = "recording.html", "log.npz", "summary.json", "plot.png"
