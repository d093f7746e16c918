"""What users run on many motions: sweeps, and the paper's Section IV."""
