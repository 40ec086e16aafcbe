"""Scenes rendered by the platform's own simulation package in a separate environment."""
