"""Measurements of the strategies outside a renderer's scenes."""
