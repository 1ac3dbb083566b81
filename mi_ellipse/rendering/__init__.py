"""Render scenes: load them, render them in passes, and say how a picture was made."""
