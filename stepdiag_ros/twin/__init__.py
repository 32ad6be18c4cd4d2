"""The simulator of a log: what it knows already is taken off, what was found it takes over."""
