"""From what each format holds to the one performer."""
