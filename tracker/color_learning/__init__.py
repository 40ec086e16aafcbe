"""Colours learned from recordings without labels: poses say what is a face, and faces what is a colour."""
