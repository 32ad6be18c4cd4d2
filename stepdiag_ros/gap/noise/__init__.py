"""What the log itself shows of its noise: scatter, dwell spectra, lines, mode hops."""
