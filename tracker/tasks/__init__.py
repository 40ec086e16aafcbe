"""The platform's tasks: how far a state is from its goal."""
