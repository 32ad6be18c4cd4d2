"""The further run that separates what a log leaves open."""
