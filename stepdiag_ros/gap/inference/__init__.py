"""Evidence for sets of effects in parity space, the search among them, and the joint fit."""
