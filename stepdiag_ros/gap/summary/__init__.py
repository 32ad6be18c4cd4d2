"""What a diagnosis reports of a fit: place, frequency, size, held-out gap."""
