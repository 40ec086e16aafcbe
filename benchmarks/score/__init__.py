"""From answers to figures: errors, intervals, shares."""
