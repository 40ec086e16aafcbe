"""Hypotheses from label maps: where the object could be, how turned, and what else looks like it."""
