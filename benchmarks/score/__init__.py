"""From answers to figures: errors, bounds, shares."""
