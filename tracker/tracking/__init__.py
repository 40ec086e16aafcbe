"""The object over time: its motion, what is believed of it, what is remembered."""
