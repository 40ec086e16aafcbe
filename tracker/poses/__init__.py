"""The poses that were found in a recording: collected, kept, compared and exported."""
