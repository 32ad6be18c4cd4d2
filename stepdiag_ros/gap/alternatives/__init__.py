"""What competes with the named effects: known physics without a name, and unmodelled structure."""
