"""What came out of a recording: in numbers, rewards and remarks, and as a line of a table."""
