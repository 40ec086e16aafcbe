"""Many recordings: shared by processes and machines, each done once, in one table."""
