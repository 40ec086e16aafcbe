"""Images with exactly known poses."""
