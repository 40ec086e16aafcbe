"""What is judged: scenes and films with exact truth, what is done to them, and recordings."""
