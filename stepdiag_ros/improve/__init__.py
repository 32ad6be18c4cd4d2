"""The closed loop: what a control is compensated with after a calibration, and what the next one says of it."""
