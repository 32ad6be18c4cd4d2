"""A log made ready for inference: stamps put right, stops and dwells, the nominal fit."""
