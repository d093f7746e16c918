"""The lookahead beside PlaCo, Pink, mink and Drake's differential IK."""
