"""Colours and light, as measured on the real platforms."""
