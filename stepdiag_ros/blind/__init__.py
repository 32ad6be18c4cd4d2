"""The blind check: a sealed world that the diagnosis has not seen, its answers, their score."""
